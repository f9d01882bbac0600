"""A vehicle's Kalman filter for its own motion: the identified plant is the process model, the setpoint its input.

State [p v c s q] along each axis (axial.py). What the plant does not explain is an acceleration w = c + s
(wind, model error; mathematics.md sections 1 and 8): c stands still but for a random walk, s swings with the ring. A
wrong plant that circles a target in steady motion errs by just these two, on each axis by its own share: s is an
oscillator at the ring's rate, q its other half. Off the ring s is no more, and what it was is part of c.
"""

from bisect import bisect_right
from collections.abc import Iterable
from functools import lru_cache, partial
from math import cos, hypot, inf, sin

import msgspec
import numpy as np

from estimation.filters.axial import (
    Along,
    Spread,
    Step,
    Turn,
    carried,
    corrected,
    moved,
)
from estimation.filters.consistency import Consistency
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.settings import OwnFilterSettings
from estimation.state import (
    STEP_DIGITS,
    OwnEstimate,
    Telemetry,
    Vector,
)

_HISTORY_S = 2.0
_MEASURED = 4
_NO_SPREAD = Spread(*[0.0] * 15)
PRIOR_M_S2 = 0.3
"""How large each part of the disturbance may be before anything is known of it (standard deviation)."""
SWING_SHARE = 0.5
"""How fast the swinging part changes, relative to the steady one: a plant changes less than the wind."""
JUMP_M, ACCELERATION_MAX_M_S2 = 1.0, 10.0
"""Between two samples a position that moves by more than this, beyond what its velocity and any thrust allow, jumps."""

_Pair = tuple[float, float]
_Belief = tuple[Along, Along]


class OwnFilter:
    """Estimates one vehicle's position, velocity and disturbance from its telemetry and its own setpoints.

    `refused` counts samples, `resets` how often it began anew, `jumps` how often it did because the position jumped.
    """

    def __init__(self, plant: Plant, settings: OwnFilterSettings) -> None:
        self._settings = settings
        self._noise = settings.position_noise_m**2, settings.velocity_noise_m_s**2
        self._gate_squared = settings.gate_sigma**2 * _MEASURED
        self._steps = lru_cache(maxsize=1024)(partial(_steps, plant, settings))
        self._inputs = _InputHistory(plant.delay_s)
        self._belief: _Belief | None = None
        self._time_s = -inf
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
        if rate_rad_s == self._turning_rad_s:
            return
        if self._belief is not None and 0.0 in (rate_rad_s, self._turning_rad_s):
            x, y = self._belief
            swings_m_s2 = self._prior_m_s2 if rate_rad_s else 0.0
            self._belief = _swinging(x, swings_m_s2), _swinging(y, swings_m_s2)
        self._turning_rad_s = rate_rad_s

    def measure(self, telemetry: Telemetry) -> None:
        """Take in a telemetry sample; one from the past is refused, and so is an outlier unless they go on."""
        time_s, (x_m, y_m, _), (x_rate, y_rate, _) = telemetry.time_s, telemetry.position_m, telemetry.velocity_m_s
        before, self._before = self._before, telemetry
        if self._belief is None:
            self._reset(telemetry)
            return
        if time_s < self._time_s:
            self.refused += 1
            return
        step_s = time_s - self._time_s
        prior_x, prior_y = self._carried(time_s)
        x, x_squared = corrected(prior_x, x_m, x_rate, self._noise)
        y, y_squared = corrected(prior_y, y_m, y_rate, self._noise)
        squared = x_squared + y_squared
        self._consistency.see(squared / _MEASURED, step_s, self._settings.gate_sigma**2)
        self._time_s = time_s
        if squared <= self._gate_squared:  # NaN is no innovation
            self._believe(x, y)
            self._doubted_s = inf
            return
        self._believe(prior_x, prior_y)
        self.refused += 1
        if self._doubted_s == inf:
            self._doubted_s = time_s
            self._leapt = before is not None and _leaps(before, telemetry)
        if time_s - self._doubted_s > self._settings.gate_timeout_s:
            # What was believed is of no use any more: the autopilot's estimator has moved, or the plant is another.
            self.resets += 1
            self.jumps += self._leapt
            self._reset(telemetry)

    def estimate(self, now_s: float) -> OwnEstimate | None:
        """Return the estimate at `now_s`, or None before any telemetry."""
        if self._belief is None:
            return None
        time_s = max(now_s, self._time_s)
        x, y = self._carried(time_s)
        w_x, w_y = self._disturbance(x.c + x.s, y.c + y.s)
        return OwnEstimate(time_s, np.array((x.p, y.p, x.v, y.v, w_x, w_y)), _covariance(x.spread, y.spread))

    def predicted(self, at_s: float, unsent_s: float) -> Vector:
        """Return the mean (6,) at `at_s` under the setpoints already sent: where the next one finds the vehicle.

        For the last `unsent_s`, half of the time a setpoint is held, the next one acts itself: it will be as far
        ahead of the last one as the vehicle flies meanwhile. Only after there was telemetry.
        """
        assert self._belief is not None
        step_s = round(at_s - self._time_s, STEP_DIGITS)
        steps, turn = self._steps(self._swings, step_s), self._turn(step_s)
        unsent = self._steps(self._swings, unsent_s)
        means_m, slopes_m_s = self._inputs.ramp(self._time_s, at_s)
        x, x_rate, x_disturbed = _predicted(
            self._belief[0], steps[0], turn, means_m[0], slopes_m_s[0], unsent[0], unsent_s
        )
        y, y_rate, y_disturbed = _predicted(
            self._belief[1], steps[1], turn, means_m[1], slopes_m_s[1], unsent[1], unsent_s
        )
        return np.array((x, y, x_rate, y_rate, *self._disturbance(x_disturbed, y_disturbed)))

    @property
    def authority(self) -> float:
        """The share, in (0, 1], of feedback and compensation that control may take from this filter's estimates."""
        return self._consistency.authority

    @property
    def heard_s(self) -> float | None:
        """Time of the newest telemetry."""
        return None if self._belief is None else self._time_s

    def _carried(self, to_s: float) -> _Belief:
        assert self._belief is not None
        step_s = round(to_s - self._time_s, STEP_DIGITS)
        if step_s <= 0.0:
            return self._belief
        (x_step, y_step), turn = self._steps(self._swings, step_s), self._turn(step_s)
        aim_x, aim_y = self._inputs.mean(self._time_s, to_s)
        x, y = self._belief
        return carried(x, x_step, turn, aim_x), carried(y, y_step, turn, aim_y)

    @property
    def _swings(self) -> bool:
        return self._turning_rad_s != 0.0

    def _turn(self, step_s: float) -> Turn:
        angle_rad = self._turning_rad_s * step_s
        return cos(angle_rad), sin(angle_rad)

    def _reset(self, telemetry: Telemetry) -> None:
        (x, y, _), (x_rate, y_rate, _) = telemetry.position_m, telemetry.velocity_m_s
        position_m2, rate_m2_s2 = self._noise
        prior = self._prior_m_s2**2
        swings = prior if self._turning_rad_s else 0.0
        spread = msgspec.structs.replace(_NO_SPREAD, pp=position_m2, vv=rate_m2_s2, cc=prior, ss=swings, qq=swings)
        self._belief = Along(x, x_rate, 0.0, 0.0, 0.0, spread), Along(y, y_rate, 0.0, 0.0, 0.0, spread)
        self._time_s = telemetry.time_s
        self._doubted_s = inf
        self._inputs.start(telemetry.time_s, (x, y))

    def _believe(self, x: Along, y: Along) -> None:
        """Keep each part of the disturbance within the bound: what cannot be compensated is not wound up either."""
        limit = self._settings.disturbance_max_m_s2
        self._belief = _bounded(x, limit), _bounded(y, limit)

    def _disturbance(self, x_m_s2: float, y_m_s2: float) -> _Pair:
        """Return the disturbance, its parts added up, within the bound."""
        limit = self._settings.disturbance_max_m_s2
        return min(max(x_m_s2, -limit), limit), min(max(y_m_s2, -limit), limit)


def _predicted(
    along: Along, step: Step, turn: Turn, aim_m: float, slope_m_s: float, unsent: Step, unsent_s: float
) -> tuple[float, float, float]:
    """Return position, velocity and disturbance after a step under a ramp of aims, the last `unsent_s` without one."""
    p, v, c, s, _ = moved(along, step, turn, aim_m)
    p, v = p + step.ramp_p * slope_m_s, v + step.ramp_v * slope_m_s
    ahead_m = v * 2.0 * unsent_s
    return p + unsent.aimed_p * ahead_m, v + unsent.aimed_v * ahead_m, c + s


def _bounded(along: Along, limit: float) -> Along:
    c, s, q = along.c, along.s, along.q
    if -limit <= c <= limit and -limit <= s <= limit and -limit <= q <= limit:
        return along
    c, s, q = (min(max(part, -limit), limit) for part in (c, s, q))
    return msgspec.structs.replace(along, c=c, s=s, q=q)


def _swinging(along: Along, prior_m_s2: float) -> Along:
    """Return the belief with all disturbance in its steady part, and a swing of which nothing is known but its size."""
    spread, prior = along.spread, prior_m_s2**2
    spread = msgspec.structs.replace(
        _NO_SPREAD,
        pp=spread.pp,
        pv=spread.pv,
        pc=spread.pc + spread.ps,
        vv=spread.vv,
        vc=spread.vc + spread.vs,
        cc=spread.cc + 2.0 * spread.cs + spread.ss,
        ss=prior,
        qq=prior,
    )
    return Along(along.p, along.v, along.c + along.s, 0.0, 0.0, spread)


def _covariance(x: Spread, y: Spread) -> Vector:
    """Return the covariance (6, 6) of [x y x' y' w_x w_y], the disturbance's parts added up."""
    x_w, x_vw, x_ww = x.pc + x.ps, x.vc + x.vs, x.cc + 2.0 * x.cs + x.ss
    y_w, y_vw, y_ww = y.pc + y.ps, y.vc + y.vs, y.cc + 2.0 * y.cs + y.ss
    rows = (
        (x.pp, 0.0, x.pv, 0.0, x_w, 0.0),
        (0.0, y.pp, 0.0, y.pv, 0.0, y_w),
        (x.pv, 0.0, x.vv, 0.0, x_vw, 0.0),
        (0.0, y.pv, 0.0, y.vv, 0.0, y_vw),
        (x_w, 0.0, x_vw, 0.0, x_ww, 0.0),
        (0.0, y_w, 0.0, y_vw, 0.0, y_ww),
    )
    return np.array(rows)


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
        self._setpoint_m: list[_Pair] = []

    def start(self, time_s: float, position_m: _Pair) -> None:
        """Before the first setpoint a vehicle stays where it is."""
        if not self._from_s:
            self._from_s.append(time_s)
            self._setpoint_m.append(position_m)

    def add(self, time_s: float, setpoint_m: Vector) -> None:
        self._from_s.append(time_s + self._delay_s)
        self._setpoint_m.append((setpoint_m.item(0), setpoint_m.item(1)))
        oldest = bisect_right(self._from_s, time_s - _HISTORY_S) - 1
        if oldest > 0:
            del self._from_s[:oldest], self._setpoint_m[:oldest]

    def ramp(self, from_s: float, to_s: float) -> tuple[_Pair, _Pair]:
        """Return the mean and the slope, along both axes, of the line nearest to the setpoints over an interval."""
        span_s = to_s - from_s
        if span_s <= 0.0:  # telemetry from ahead of the clock
            return next(iter(self._pieces(from_s, from_s)))[2], (0.0, 0.0)
        x = y = x_moment = y_moment = 0.0
        for begin_s, end_s, (x_m, y_m) in self._pieces(from_s, to_s):
            lasts_s = end_s - begin_s
            off_s = (begin_s + end_s - from_s - to_s) / 2.0 * lasts_s
            x, y = x + lasts_s * x_m, y + lasts_s * y_m
            x_moment, y_moment = x_moment + off_s * x_m, y_moment + off_s * y_m
        steep = 12.0 / span_s**3
        return (x / span_s, y / span_s), (x_moment * steep, y_moment * steep)

    def mean(self, from_s: float, to_s: float) -> _Pair:
        """Return the mean setpoint acting over an interval: over one loop period as good as the pieces."""
        x = y = 0.0
        for begin_s, end_s, (x_m, y_m) in self._pieces(from_s, to_s):
            x, y = x + (end_s - begin_s) * x_m, y + (end_s - begin_s) * y_m
        return x / (to_s - from_s), y / (to_s - from_s)

    def _pieces(self, from_s: float, to_s: float) -> Iterable[tuple[float, float, _Pair]]:
        """Return what acts over an interval, piece by piece: from when, until when, and the setpoint."""
        first = max(bisect_right(self._from_s, from_s) - 1, 0)
        last = max(bisect_right(self._from_s, to_s) - 1, 0)
        if first == last:
            return ((from_s, to_s, self._setpoint_m[last]),)
        edges = [from_s, *self._from_s[first + 1 : last + 1], to_s]
        return zip(edges, edges[1:], self._setpoint_m[first : last + 1], strict=False)


def _steps(plant: Plant, settings: OwnFilterSettings, swings: bool, step_s: float) -> tuple[Step, Step]:
    """Return one step along x and along y."""
    exact = exact_step(plant, step_s)
    density, walk = settings.acceleration_noise_m_s2**2, settings.disturbance_noise_m_s2**2 * step_s

    def along(axis: PlantAxis, p: int, v: int) -> Step:
        aimed_p, aimed_v = exact.input_gain.item(p, p), exact.input_gain.item(v, p)
        ramp_p, ramp_v = _ramp_gain(axis, aimed_p, aimed_v, step_s)
        return Step(
            pp=exact.transition.item(p, p),
            pv=exact.transition.item(p, v),
            vp=exact.transition.item(v, p),
            vv=exact.transition.item(v, v),
            disturbed_p=exact.disturbance_gain.item(p, p),
            disturbed_v=exact.disturbance_gain.item(v, p),
            aimed_p=aimed_p,
            aimed_v=aimed_v,
            ramp_p=ramp_p,
            ramp_v=ramp_v,
            noise_pp=density * step_s**3 / 3.0,
            noise_pv=density * step_s**2 / 2.0,
            noise_vv=density * step_s,
            walk_c=walk,
            walk_s=SWING_SHARE**2 * walk if swings else 0.0,
        )

    return along(plant.x, 0, 2), along(plant.y, 1, 3)


def _ramp_gain(axis: PlantAxis, aimed_p: float, aimed_v: float, step_s: float) -> _Pair:
    """Return what a slope of the aim about its mean over a step adds to position and velocity, from what an aim does.

    The answer to a ramp is the integral of the answer to a step: with the flow A and the entry B of the axis that is
    A^-1 (answer - B step), and of that the mean of the ramp is what the aim has done already.
    """
    followed_m = step_s - (aimed_v + axis.a1_per_s * aimed_p) / axis.a0_per_s2
    return followed_m - aimed_p * step_s / 2.0, aimed_p - aimed_v * step_s / 2.0
