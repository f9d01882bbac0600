"""A vehicle's Kalman filter for its own motion: the identified plant is the process model, the setpoint its input.

State [x y x' y' w_x w_y]: `w` is the acceleration that the plant does not explain (wind, model error), a bounded random
walk (mathematics.md sections 1 and 8) that may turn at a known rate.
"""

from bisect import bisect_right
from functools import lru_cache, partial
from math import cos, hypot, inf, sin

import numpy as np

from estimation.kalman import STEP_DIGITS, Belief, correct, predict
from estimation.plant import Plant, exact_step
from estimation.settings import OwnFilterSettings
from estimation.state import DISTURBANCE, MOTION, POSITION, VELOCITY, OwnEstimate, Telemetry, Vector

_HISTORY_S = 2.0
JUMP_M, ACCELERATION_MAX_M_S2 = 1.0, 10.0
"""Between two samples a position that moves by more than this, beyond what its velocity and any thrust allow, jumps."""


class OwnFilter:
    """Estimates one vehicle's position, velocity and disturbance from its telemetry and its own setpoints.

    `refused` counts samples, `resets` how often it began anew, `jumps` how often it did because the position jumped.
    """

    def __init__(self, plant: Plant, settings: OwnFilterSettings) -> None:
        self._plant = plant
        self._settings = settings
        self._noise = np.diag([settings.position_noise_m**2] * 2 + [settings.velocity_noise_m_s**2] * 2)
        self._process = lru_cache(maxsize=1024)(partial(_process, plant, settings))
        self._inputs = _InputHistory(plant.delay_s)
        self._belief: Belief | None = None
        self._turning_rad_s = 0.0
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
        """Expect the disturbance to turn at this rate from now on, counter-clockwise."""
        self._turning_rad_s = rate_rad_s

    def measure(self, telemetry: Telemetry) -> None:
        """Take in a telemetry sample; one from the past is refused, and so is an outlier unless they go on."""
        measured = np.array([*telemetry.position_m[:2], *telemetry.velocity_m_s[:2]])
        before, self._before = self._before, telemetry
        if self._belief is None:
            self._reset(telemetry.time_s, measured)
            return
        if telemetry.time_s < self._belief.time_s:
            self.refused += 1
            return
        prior = self._carried(self._belief, telemetry.time_s)
        result = correct(prior, measured, self._noise, self._settings.gate_sigma)
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
        return OwnEstimate(belief.time_s, belief.mean, belief.covariance)

    def predicted_motion(self, estimate: OwnEstimate, at_s: float) -> Vector:
        """Return the motion (4,) at `at_s` under the setpoints already sent: where the next one finds the vehicle."""
        step_s = round(at_s - estimate.time_s, STEP_DIGITS)
        setpoint = self._inputs.mean(estimate.time_s, at_s)
        step = exact_step(self._plant, step_s)
        return step.advance(estimate.mean[MOTION], setpoint, estimate.mean[DISTURBANCE])

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
        mean = np.concatenate([measured, np.zeros(2)])
        spread = np.concatenate([np.diag(self._noise), np.full(2, self._settings.disturbance_max_m_s2**2 / 4.0)])
        self._belief = Belief(time_s, mean, np.diag(spread))
        self._doubted_s = inf
        self._inputs.start(time_s, measured[POSITION])

    def _bounded(self, belief: Belief) -> Belief:
        limit = self._settings.disturbance_max_m_s2
        w_x, w_y = belief.mean[DISTURBANCE].tolist()
        if abs(w_x) <= limit and abs(w_y) <= limit:
            return belief
        mean = belief.mean.copy()
        np.clip(mean[DISTURBANCE], -limit, limit, out=mean[DISTURBANCE])
        return Belief(belief.time_s, mean, belief.covariance)


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
        self._setpoint_m: list[Vector] = []

    def start(self, time_s: float, position_m: Vector) -> None:
        """Before the first setpoint a vehicle stays where it is."""
        if not self._from_s:
            self._from_s.append(time_s)
            self._setpoint_m.append(position_m)

    def add(self, time_s: float, setpoint_m: Vector) -> None:
        self._from_s.append(time_s + self._delay_s)
        self._setpoint_m.append(setpoint_m)
        oldest = bisect_right(self._from_s, time_s - _HISTORY_S) - 1
        if oldest > 0:
            del self._from_s[:oldest], self._setpoint_m[:oldest]

    def mean(self, from_s: float, to_s: float) -> Vector:
        """Return the mean setpoint (2,) acting over an interval: over one loop period as good as the pieces."""
        first = max(bisect_right(self._from_s, from_s) - 1, 0)
        last = max(bisect_right(self._from_s, to_s) - 1, 0)
        if first == last or to_s <= from_s:
            return self._setpoint_m[last]
        edges = [from_s, *self._from_s[first + 1 : last + 1], to_s]
        pieces = self._setpoint_m[first : last + 1]
        total = sum((end - begin) * piece for begin, end, piece in zip(edges, edges[1:], pieces, strict=False))
        return np.asarray(total / (to_s - from_s), dtype=np.float64)


def _process(
    plant: Plant, settings: OwnFilterSettings, turning_rad_s: float, step_s: float
) -> tuple[Vector, Vector, Vector]:
    """Return transition (6, 6), process noise (6, 6) and setpoint gain (6, 2) over one step."""
    step = exact_step(plant, step_s)
    transition = np.eye(6)
    transition[MOTION, MOTION] = step.transition
    transition[MOTION, DISTURBANCE] = step.disturbance_gain
    cosine, sine = cos(turning_rad_s * step_s), sin(turning_rad_s * step_s)
    transition[DISTURBANCE, DISTURBANCE] = [[cosine, -sine], [sine, cosine]]
    gain = np.zeros((6, 2))
    gain[MOTION] = step.input_gain
    noise = np.zeros((6, 6))
    density = settings.acceleration_noise_m_s2**2
    noise[POSITION, POSITION] = np.eye(2) * density * step_s**3 / 3.0
    noise[POSITION, VELOCITY] = noise[VELOCITY, POSITION] = np.eye(2) * density * step_s**2 / 2.0
    noise[VELOCITY, VELOCITY] = np.eye(2) * density * step_s
    noise[DISTURBANCE, DISTURBANCE] = np.eye(2) * settings.disturbance_noise_m_s2**2 * step_s
    return transition, noise, gain
