"""A vehicle's Kalman filter for its own motion: the identified plant is the process model, the setpoint its input.

State [x y x' y' c_x c_y s_x s_y q_x q_y]. What the plant does not explain is an acceleration w = c + s (wind, model
error; mathematics.md sections 1 and 8): c stands still but for a random walk, s swings with the ring. A wrong plant
that circles a target in steady motion errs by just these two, on each axis by its own share: s is an oscillator at the
ring's rate, q its other half. Off the ring s is no more, and what it was is part of c.
"""

from bisect import bisect_right
from collections.abc import Iterable
from functools import lru_cache, partial
from math import cos, hypot, inf, sin

import numpy as np

from estimation.consistency import Consistency
from estimation.kalman import STEP_DIGITS, Belief, correct, predict
from estimation.plant import Plant, exact_step
from estimation.settings import OwnFilterSettings
from estimation.state import DISTURBANCE, MOTION, POSITION, VELOCITY, OwnEstimate, Telemetry, Vector

_HISTORY_S = 2.0
_STEADY, _SWINGING, _OSCILLATOR = slice(4, 6), slice(6, 8), slice(6, 10)
_SIZE = 10
_SEEN = np.eye(6, _SIZE)
_SEEN[DISTURBANCE, _SWINGING] = np.eye(2)
PRIOR_M_S2 = 0.3
"""How large each part of the disturbance may be before anything is known of it (standard deviation)."""
SWING_SHARE = 0.5
"""How fast the swinging part changes, relative to the steady one: a plant changes less than the wind."""
JUMP_M, ACCELERATION_MAX_M_S2 = 1.0, 10.0
"""Between two samples a position that moves by more than this, beyond what its velocity and any thrust allow, jumps."""


class OwnFilter:
    """Estimates one vehicle's position, velocity and disturbance from its telemetry and its own setpoints.

    `refused` counts samples, `resets` how often it began anew, `jumps` how often it did because the position jumped.
    """

    def __init__(self, plant: Plant, settings: OwnFilterSettings) -> None:
        self._settings = settings
        self._noise = np.diag([settings.position_noise_m**2] * 2 + [settings.velocity_noise_m_s**2] * 2)
        self._process = lru_cache(maxsize=1024)(partial(_process, plant, settings))
        self._ramp_gain = lru_cache(maxsize=1024)(partial(_ramp_gain, plant))
        self._step = lru_cache(maxsize=8)(partial(exact_step, plant))
        self._inputs = _InputHistory(plant.delay_s)
        self._belief: Belief | None = None
        self._consistency = Consistency()
        self._turning_rad_s = 0.0
        self._prior_m_s2 = min(settings.disturbance_max_m_s2 / 2.0, PRIOR_M_S2)
        self._doubted_s = inf
        self._before: Telemetry | None = None
        self._leapt = False
        self.refused = 0
        self.resets = 0
        self.jumps = 0

    def command(self, time_s: float, aim_m: Vector) -> None:
        """Remember the aim (2,) of what was sent at `time_s`: the setpoint itself unless a velocity goes with it."""
        self._inputs.add(time_s, aim_m)

    def turn_disturbance(self, rate_rad_s: float) -> None:
        """Look for a disturbance that swings at this rate from now on, besides the steady one; 0: for none."""
        belief = self._belief
        if belief is not None and rate_rad_s != 0.0 and self._turning_rad_s == 0.0:
            covariance = belief.covariance.copy()
            covariance[_OSCILLATOR, _OSCILLATOR] = np.eye(4) * self._prior_m_s2**2
            self._belief = Belief(belief.time_s, belief.mean, covariance)
        self._turning_rad_s = rate_rad_s

    def measure(self, telemetry: Telemetry) -> None:
        """Take in a telemetry sample; one from the past is refused, and so is an outlier unless they go on."""
        (x, y, _), (x_rate, y_rate, _) = telemetry.position_m, telemetry.velocity_m_s
        measured = np.array((x, y, x_rate, y_rate))
        before, self._before = self._before, telemetry
        if self._belief is None:
            self._reset(telemetry.time_s, measured)
            return
        if telemetry.time_s < self._belief.time_s:
            self.refused += 1
            return
        prior = self._carried(self._belief, telemetry.time_s)
        result = correct(prior, measured, self._noise, self._settings.gate_sigma)
        step_s = telemetry.time_s - self._belief.time_s
        self._consistency.see(result.innovation_squared / 4.0, step_s, self._settings.gate_sigma**2)
        self._belief = self._bounded(result.belief)
        if result.accepted:
            self._doubted_s = inf
            return
        self.refused += 1
        if self._doubted_s == inf:
            self._doubted_s = telemetry.time_s
            self._leapt = before is not None and _leaps(before, telemetry)
        if telemetry.time_s - self._doubted_s > self._settings.gate_timeout_s:
            # What was believed is of no use any more: the autopilot's estimator has moved, or the plant is another.
            self.resets += 1
            self.jumps += self._leapt
            self._reset(telemetry.time_s, measured)

    def estimate(self, now_s: float) -> OwnEstimate | None:
        """Return the estimate at `now_s`, or None before any telemetry."""
        if self._belief is None:
            return None
        belief = self._carried(self._belief, max(now_s, self._belief.time_s))
        return OwnEstimate(belief.time_s, self._seen(belief.mean), _SEEN.dot(belief.covariance).dot(_SEEN.T))

    def predicted(self, at_s: float, unsent_s: float) -> Vector:
        """Return the mean (6,) at `at_s` under the setpoints already sent: where the next one finds the vehicle.

        For the last `unsent_s`, half of the time a setpoint is held, the next one acts itself: it will be as far
        ahead of the last one as the vehicle flies meanwhile. Only after there was telemetry.
        """
        assert self._belief is not None
        belief = self._belief
        step_s = round(at_s - belief.time_s, STEP_DIGITS)
        transition, _, gain = self._process(self._turning_rad_s, step_s)
        setpoint, slope = self._inputs.ramp(belief.time_s, at_s)
        mean = self._seen(transition.dot(belief.mean) + gain.dot(setpoint))
        mean[MOTION] += self._ramp_gain(step_s).dot(slope)
        mean[MOTION] += self._step(unsent_s).input_gain.dot(mean[VELOCITY] * (2.0 * unsent_s))
        return mean

    @property
    def authority(self) -> float:
        """The share, in (0, 1], of feedback and compensation that control may take from this filter's estimates."""
        return self._consistency.authority

    @property
    def heard_s(self) -> float | None:
        """Time of the newest telemetry."""
        return None if self._belief is None else self._belief.time_s

    def _carried(self, belief: Belief, to_s: float) -> Belief:
        step_s = round(to_s - belief.time_s, STEP_DIGITS)
        if step_s <= 0.0:
            return belief
        transition, noise, gain = self._process(self._turning_rad_s, step_s)
        return predict(belief, to_s, transition, noise, gain, self._inputs.mean(belief.time_s, to_s))

    def _reset(self, time_s: float, measured: Vector) -> None:
        mean = np.concatenate([measured, np.zeros(_SIZE - 4)])
        swings = 1.0 if self._turning_rad_s else 0.0
        prior = self._prior_m_s2**2 * np.array([1.0] * 2 + [swings] * 4)
        spread = np.concatenate([np.diag(self._noise), prior])
        self._belief = Belief(time_s, mean, np.diag(spread))
        self._doubted_s = inf
        self._inputs.start(time_s, measured[POSITION])

    def _bounded(self, belief: Belief) -> Belief:
        """Keep each part of the disturbance within the bound: what cannot be compensated is not wound up either."""
        limit = self._settings.disturbance_max_m_s2
        parts = belief.mean[4:].tolist()
        if max(parts) <= limit and min(parts) >= -limit:
            return belief
        mean = belief.mean.copy()
        np.clip(mean[4:], -limit, limit, out=mean[4:])
        return Belief(belief.time_s, mean, belief.covariance)

    def _seen(self, mean: Vector) -> Vector:
        """Return motion and disturbance (6,), the parts of the disturbance added up and bounded, of a mean (10,)."""
        seen = _SEEN.dot(mean)
        w_x, w_y = seen[DISTURBANCE].tolist()
        limit = self._settings.disturbance_max_m_s2
        if abs(w_x) > limit or abs(w_y) > limit:
            np.clip(seen[DISTURBANCE], -limit, limit, out=seen[DISTURBANCE])
        return np.asarray(seen, dtype=np.float64)


def _leaps(before: Telemetry, after: Telemetry) -> bool:
    """Return whether a position is not where the one before it and its velocity lead to: no vehicle flies like that."""
    step_s = after.time_s - before.time_s
    moved_m = [
        there - here - rate * step_s
        for here, there, rate in zip(before.position_m[:2], after.position_m[:2], before.velocity_m_s[:2], strict=True)
    ]
    return hypot(*moved_m) > JUMP_M + ACCELERATION_MAX_M_S2 / 2.0 * step_s**2


class _InputHistory:
    """The setpoints that were sent, by the time from which they act."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._from_s: list[float] = []
        self._setpoint_m: list[tuple[float, float]] = []

    def start(self, time_s: float, position_m: Vector) -> None:
        """Before the first setpoint a vehicle stays where it is."""
        if not self._from_s:
            self._from_s.append(time_s)
            self._setpoint_m.append((position_m.item(0), position_m.item(1)))

    def add(self, time_s: float, setpoint_m: Vector) -> None:
        self._from_s.append(time_s + self._delay_s)
        self._setpoint_m.append((setpoint_m.item(0), setpoint_m.item(1)))
        oldest = bisect_right(self._from_s, time_s - _HISTORY_S) - 1
        if oldest > 0:
            del self._from_s[:oldest], self._setpoint_m[:oldest]

    def ramp(self, from_s: float, to_s: float) -> tuple[Vector, Vector]:
        """Return the mean (2,) and the slope (2,) of the straight line nearest to the setpoints over an interval."""
        span_s = to_s - from_s
        if span_s <= 0.0:  # telemetry from ahead of the clock
            return np.array(next(iter(self._pieces(from_s, from_s)))[2]), np.zeros(2)
        x = y = x_moment = y_moment = 0.0
        for begin_s, end_s, (x_m, y_m) in self._pieces(from_s, to_s):
            lasts_s = end_s - begin_s
            off_s = (begin_s + end_s - from_s - to_s) / 2.0 * lasts_s
            x, y = x + lasts_s * x_m, y + lasts_s * y_m
            x_moment, y_moment = x_moment + off_s * x_m, y_moment + off_s * y_m
        steep = 12.0 / span_s**3
        return np.array((x / span_s, y / span_s)), np.array((x_moment * steep, y_moment * steep))

    def mean(self, from_s: float, to_s: float) -> Vector:
        """Return the mean setpoint (2,) acting over an interval: over one loop period as good as the pieces."""
        x = y = 0.0
        for begin_s, end_s, (x_m, y_m) in self._pieces(from_s, to_s):
            x, y = x + (end_s - begin_s) * x_m, y + (end_s - begin_s) * y_m
        return np.array((x / (to_s - from_s), y / (to_s - from_s)))

    def _pieces(self, from_s: float, to_s: float) -> Iterable[tuple[float, float, tuple[float, float]]]:
        """Return what acts over an interval, piece by piece: from when, until when, and the setpoint."""
        first = max(bisect_right(self._from_s, from_s) - 1, 0)
        last = max(bisect_right(self._from_s, to_s) - 1, 0)
        if first == last:
            return ((from_s, to_s, self._setpoint_m[last]),)
        edges = [from_s, *self._from_s[first + 1 : last + 1], to_s]
        return zip(edges, edges[1:], self._setpoint_m[first : last + 1], strict=False)


def _ramp_gain(plant: Plant, step_s: float) -> Vector:
    """Return what a setpoint's slope about its mean over a step adds to the motion (4, 2)."""
    flow = np.zeros((4, 4))
    flow[POSITION, VELOCITY] = np.eye(2)
    flow[VELOCITY, POSITION], flow[VELOCITY, VELOCITY] = -np.diag(plant.a0_per_s2), -np.diag(plant.a1_per_s)
    entry = np.zeros((4, 2))
    entry[VELOCITY] = np.diag(plant.a0_per_s2)
    steady = exact_step(plant, step_s).input_gain
    # The answer to a ramp is the integral of the answer to a step.
    return np.asarray(np.linalg.solve(flow, steady - entry * step_s) - steady * step_s / 2.0)


def _process(
    plant: Plant, settings: OwnFilterSettings, turning_rad_s: float, step_s: float
) -> tuple[Vector, Vector, Vector]:
    """Return transition (10, 10), process noise (10, 10) and setpoint gain (10, 2) over one step."""
    step = exact_step(plant, step_s)
    transition = np.eye(_SIZE)
    transition[MOTION, MOTION] = step.transition
    transition[MOTION, _STEADY] = transition[MOTION, _SWINGING] = step.disturbance_gain
    gain = np.zeros((_SIZE, 2))
    gain[MOTION] = step.input_gain
    noise = np.zeros((_SIZE, _SIZE))
    density = settings.acceleration_noise_m_s2**2
    noise[POSITION, POSITION] = np.eye(2) * density * step_s**3 / 3.0
    noise[POSITION, VELOCITY] = noise[VELOCITY, POSITION] = np.eye(2) * density * step_s**2 / 2.0
    noise[VELOCITY, VELOCITY] = np.eye(2) * density * step_s
    walk = settings.disturbance_noise_m_s2**2 * step_s
    noise[_STEADY, _STEADY] = np.eye(2) * walk
    if turning_rad_s == 0.0:
        transition[_OSCILLATOR, _OSCILLATOR] = 0.0
        transition[_STEADY, _SWINGING] = np.eye(2)
        return transition, noise, gain
    cosine, sine = cos(turning_rad_s * step_s), sin(turning_rad_s * step_s)
    transition[_OSCILLATOR, _OSCILLATOR] = np.kron([[cosine, -sine], [sine, cosine]], np.eye(2))
    noise[_OSCILLATOR, _OSCILLATOR] = np.eye(4) * SWING_SHARE**2 * walk
    return transition, noise, gain
