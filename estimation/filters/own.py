"""A vehicle's Kalman filter for its own motion: the identified plant is the process model, the setpoint is its input.

State [p v c s q] along each axis (axial.py). Wind and model error act as an acceleration w = c + s: c is a random walk,
s an oscillator at the ring's rate with q as its second state. In steady motion about a target the error of a wrong
plant consists of these two. Off the ring s is zero, and its last value is added to c.

Innovation consistency of a filter (normalised innovation squared, NIS), and the control authority derived from it.

If the model is right, the squared innovation, normalised by its covariance, averages 1 per degree of freedom.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable
from functools import lru_cache, partial
from math import cos, exp, hypot, inf, sin
from typing import Final
from weakref import WeakValueDictionary

import msgspec
import numpy as np

from estimation.filters.axial import (
    Axes,
    AxialStep,
    AxisCovariance,
    AxisEstimate,
    Rotation,
    predicted_axes,
    predicted_mean,
    updated_axes,
)
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.settings import OwnFilterSettings
from estimation.state import STEP_DIGITS, AxisSpread, OwnEstimate, Telemetry, Vector
from estimation.vectors import rounded

RISE_S: Final = 1.0
FALL_S: Final = 6.0
"""Time constants of the average: it rises fast and falls slowly."""
FULL_UP_TO: Final = 4.0
LEAST_FROM: Final = 16.0
"""Averages up to which a filter has full authority, and from which it has the least. Because the average rises faster
than it falls, it is 1.7 for a consistent filter: the bounds are errors 1.5 times and 3 times as large as expected.
"""
AUTHORITY_LEAST: Final = 0.1


class Consistency:
    """A running average of normalised squared innovations, and the authority derived from it.

    A model that does not match its vehicle lowers the authority, in (0, 1]: the share of feedback and compensation in
    the setpoint. The rest is the model's feed-forward, which a wrong model cannot destabilise.
    """

    def __init__(self) -> None:
        self._mean = 1.0

    @property
    def innovation(self) -> float:
        """The averaged normalised squared innovation per degree of freedom; 1 is expected."""
        return self._mean

    @property
    def authority(self) -> float:
        """The share of feedback and disturbance compensation in the setpoint."""
        share = (LEAST_FROM - self._mean) / (LEAST_FROM - FULL_UP_TO)
        return min(max(share, AUTHORITY_LEAST), 1.0)

    def see(self, squared: float, step_s: float, most: float) -> None:
        """Add one normalised squared innovation, per degree of freedom, `step_s` after the previous one.

        Outliers are clipped to `most`.
        """
        squared = squared if squared < most else most  # also NaN
        over_s = RISE_S if squared > self._mean else FALL_S
        self._mean += (1.0 - exp(-step_s / over_s)) * (squared - self._mean)


_HISTORY_S: Final = 2.0
_MEASURED: Final = 4
PRIOR_M_S2: Final = 0.3
"""Prior standard deviation of each part of the disturbance."""
OSCILLATOR_WALK_SHARE: Final = 0.5
"""Random walk of the oscillating part relative to the steady one: plant errors change less than the wind."""
JUMP_M: Final = 1.0
ACCELERATION_MAX_M_S2: Final = 10.0
"""A position has jumped if it moves between two samples by more than this beyond what velocity and thrust allow."""

_Pair = tuple[float, float]


class OwnFilter:
    """Estimates one vehicle's position, velocity and disturbance from its telemetry and its own setpoints.

    `refused` counts rejected samples, `resets` all restarts, `jumps` the restarts after a position jump.
    """

    def __init__(self, plant: Plant, settings: OwnFilterSettings) -> None:
        self._noise = settings.position_noise_m**2, settings.velocity_noise_m_s**2
        self._gate_squared = settings.gate_sigma**2 * _MEASURED
        # Read in every tick: as a machine number each costs a tenth of a setting.
        self._outlier_squared, self._gate_timeout_s = settings.gate_sigma**2, settings.gate_timeout_s
        self._disturbance_max_m_s2 = settings.disturbance_max_m_s2
        self._steps = _shared_steps(plant, settings)
        self._inputs = _InputHistory(plant.delay_s)
        self._plant_delay_s = plant.delay_s
        self._axes: Axes | None = None
        self._time_s = -inf
        self._consistency = Consistency()
        self._turning_rad_s = 0.0
        self._prior_m_s2 = min(settings.disturbance_max_m_s2 / 2.0, PRIOR_M_S2)
        self._refused_since_s = inf
        self._before: Telemetry | None = None
        self._jumped = False
        self._risen_m, self._risen_s = 0.0, inf
        self.refused = 0
        self.resets = 0
        self.jumps = 0

    def command(self, time_s: float, aim_m: Vector) -> None:
        """Store the aim (2,) sent at `time_s`: the setpoint, unless it has a velocity."""
        self._inputs.add(time_s, aim_m)

    def delay_by(self, link_s: float) -> None:
        """Add the link's round-trip delay to the plant's delay from now on."""
        self._inputs.delay_s = self._plant_delay_s + link_s

    def turn_disturbance(self, rate_rad_s: float) -> None:
        """Estimate a disturbance oscillating at this rate from now on, in addition to the steady one; 0: none."""
        if rate_rad_s == self._turning_rad_s:
            return
        if self._axes is not None and 0.0 in (rate_rad_s, self._turning_rad_s):
            self._axes = _with_oscillator(self._axes, self._prior_m_s2 if rate_rad_s else 0.0)
        self._turning_rad_s = rate_rad_s

    def measure(self, telemetry: Telemetry) -> None:
        """Process a telemetry sample; reject one from the past or an outlier, and restart when outliers persist."""
        time_s, (x_m, y_m, _), (x_rate, y_rate, _) = telemetry.time_s, telemetry.position_m, telemetry.velocity_m_s
        before, self._before = self._before, telemetry
        if self._axes is None:
            self._reset(telemetry)
            return
        if time_s < self._time_s:
            self.refused += 1
            return
        jump = None if before is None else jump_m(before, telemetry)
        self._see_height(time_s, 0.0 if jump is None else jump[2])
        step_s = time_s - self._time_s
        prior = self._axes_at(time_s)
        axes, squared = updated_axes(prior, (x_m, y_m), (x_rate, y_rate), self._noise)
        self._consistency.see(squared / _MEASURED, step_s, self._outlier_squared)
        self._time_s = time_s
        if squared <= self._gate_squared:  # false for NaN
            self._accept(axes)
            self._refused_since_s = inf
            return
        self._accept(prior)
        self.refused += 1
        if self._refused_since_s == inf:
            self._refused_since_s = time_s
            self._jumped = jump is not None
        if time_s - self._refused_since_s > self._gate_timeout_s:
            # The estimate is invalid: the autopilot's estimator has jumped, or the plant is wrong.
            self.resets += 1
            self.jumps += self._jumped
            self._reset(telemetry)

    def _see_height(self, time_s: float, jump_m: float) -> None:
        """Count a jump of the height, which is not estimated here, once it has lasted for `gate_timeout_s`."""
        if jump_m:
            self._risen_m, self._risen_s = self._risen_m + jump_m, time_s
        if time_s - self._risen_s > self._gate_timeout_s:
            self.jumps += abs(self._risen_m) > JUMP_M
            self._risen_m, self._risen_s = 0.0, inf

    def accept_jump(self) -> None:
        """Restart at the newest sample: it is known that the position has jumped, and the setpoints sent with it."""
        newest = self._before
        if self._axes is None or newest is None:
            return
        (x, *_), (y, *_) = (axis.mean for axis in self._axes_at(newest.time_s))
        self._inputs.shift(newest.position_m[0] - x, newest.position_m[1] - y)
        self.resets += 1
        self.jumps += 1
        self._reset(newest)

    def shift(self, x_m: float, y_m: float) -> None:
        """Shift estimate, setpoints sent and past telemetry by (x, y), after a shift of the frame's origin."""
        self._inputs.shift(x_m, y_m)
        if self._axes is not None:
            x, y = self._axes
            self._axes = _shifted(x, x_m), _shifted(y, y_m)
        if self._before is not None:
            x_before, y_before, z_before = self._before.position_m
            place = x_before + x_m, y_before + y_m, z_before
            self._before = msgspec.structs.replace(self._before, position_m=place)

    def estimate(self, now_s: float) -> OwnEstimate | None:
        """Return the estimate at `now_s`, or None before any telemetry."""
        if self._axes is None:
            return None
        time_s = max(now_s, self._time_s)
        x, y = self._axes_at(time_s)
        (x_m, x_rate, x_c, x_s, _), (y_m, y_rate, y_c, y_s, _) = x.mean, y.mean
        w_x, w_y = self._disturbance(x_c + x_s, y_c + y_s)
        spread_x = _spread(x.covariance)
        spread_y = spread_x if y.covariance is x.covariance else _spread(y.covariance)
        return OwnEstimate(time_s, np.array((x_m, y_m, x_rate, y_rate, w_x, w_y)), (spread_x, spread_y))

    def predicted(self, at_s: float, unsent_s: float) -> Vector:
        """Return the mean (6,) at `at_s` under the setpoints already sent: the state at which the next one acts.

        During the last `unsent_s`, half of the time a setpoint is held, the next setpoint already acts; it is assumed
        to be ahead of the last one by the distance that the vehicle flies in this time. Requires telemetry.
        """
        assert self._axes is not None
        step_s = rounded(at_s - self._time_s, STEP_DIGITS)
        steps, rotation = self._steps(self._is_oscillating, step_s), self._rotation(step_s)
        unsent = self._steps(self._is_oscillating, unsent_s)
        means_m, slopes_m_s = self._inputs.ramp(self._time_s, at_s)
        x, x_rate, x_disturbed = _predicted_on_ramp(
            self._axes[0], steps[0], rotation, means_m[0], slopes_m_s[0], unsent[0], unsent_s
        )
        y, y_rate, y_disturbed = _predicted_on_ramp(
            self._axes[1], steps[1], rotation, means_m[1], slopes_m_s[1], unsent[1], unsent_s
        )
        return np.array((x, y, x_rate, y_rate, *self._disturbance(x_disturbed, y_disturbed)))

    @property
    def authority(self) -> float:
        """The share, in (0, 1], of feedback and disturbance compensation that the filter's consistency permits."""
        return self._consistency.authority

    @property
    def received_s(self) -> float | None:
        """Time of the newest telemetry [s]; None before any."""
        return None if self._axes is None else self._time_s

    def mean_aim_m(self, from_s: float, to_s: float) -> tuple[float, float]:
        """Return the mean (x, y) of the aims that acted from one time to another, within the last two seconds [m]."""
        return self._inputs.mean(from_s, to_s)

    def _axes_at(self, to_s: float) -> Axes:
        assert self._axes is not None
        step_s = rounded(to_s - self._time_s, STEP_DIGITS)
        if step_s <= 0.0:
            return self._axes
        steps, rotation = self._steps(self._is_oscillating, step_s), self._rotation(step_s)
        return predicted_axes(self._axes, steps, rotation, self._inputs.mean(self._time_s, to_s))

    @property
    def _is_oscillating(self) -> bool:
        return self._turning_rad_s != 0.0

    def _rotation(self, step_s: float) -> Rotation:
        angle_rad = self._turning_rad_s * step_s
        return cos(angle_rad), sin(angle_rad)

    def _reset(self, telemetry: Telemetry) -> None:
        (x, y, _), (x_rate, y_rate, _) = telemetry.position_m, telemetry.velocity_m_s
        position_m2, rate_m2_s2 = self._noise
        prior = self._prior_m_s2**2
        is_oscillating = prior if self._turning_rad_s else 0.0
        covariance = _covariance((position_m2, 0.0, 0.0, rate_m2_s2, 0.0, prior), is_oscillating)
        self._axes = (
            AxisEstimate((x, x_rate, 0.0, 0.0, 0.0), covariance),
            AxisEstimate((y, y_rate, 0.0, 0.0, 0.0), covariance),
        )
        self._time_s = telemetry.time_s
        self._refused_since_s = inf
        self._inputs.start(telemetry.time_s, (x, y))

    def _accept(self, axes: Axes) -> None:
        """Limit each part of the disturbance to the bound (anti-windup), the largest value that is compensated."""
        limit = self._disturbance_max_m_s2
        self._axes = _bounded(axes[0], limit), _bounded(axes[1], limit)

    def _disturbance(self, x_m_s2: float, y_m_s2: float) -> _Pair:
        """Return the sum of the disturbance's parts, limited to the bound."""
        limit = self._disturbance_max_m_s2
        return min(max(x_m_s2, -limit), limit), min(max(y_m_s2, -limit), limit)


def _predicted_on_ramp(
    axis: AxisEstimate,
    step: AxialStep,
    rotation: Rotation,
    aim_m: float,
    slope_m_s: float,
    unsent: AxialStep,
    unsent_s: float,
) -> tuple[float, float, float]:
    """Return position, velocity and disturbance after a step under a ramp of aims, extrapolated for `unsent_s`."""
    p, v, c, s, _ = predicted_mean(axis, step, rotation, aim_m)
    p, v = p + step.ramp_p * slope_m_s, v + step.ramp_v * slope_m_s
    ahead_m = v * 2.0 * unsent_s
    return p + unsent.aimed_p * ahead_m, v + unsent.aimed_v * ahead_m, c + s


def _shifted(axis: AxisEstimate, by_m: float) -> AxisEstimate:
    p, v, c, s, q = axis.mean
    return AxisEstimate((p + by_m, v, c, s, q), axis.covariance)


def _bounded(axis: AxisEstimate, limit: float) -> AxisEstimate:
    p, v, c, s, q = axis.mean
    if -limit <= c <= limit and -limit <= s <= limit and -limit <= q <= limit:
        return axis
    c, s, q = [min(max(part, -limit), limit) for part in (c, s, q)]
    return AxisEstimate((p, v, c, s, q), axis.covariance)


def _with_oscillator(axes: Axes, prior_m_s2: float) -> Axes:
    """Return the estimates with the whole disturbance in its steady part and the oscillator at its prior."""
    x, y = axes
    spread_x = _covariance(_spread(x.covariance), prior_m_s2**2)
    spread_y = spread_x if y.covariance is x.covariance else _covariance(_spread(y.covariance), prior_m_s2**2)
    return _without_oscillation(x, spread_x), _without_oscillation(y, spread_y)


def _without_oscillation(axis: AxisEstimate, covariance: AxisCovariance) -> AxisEstimate:
    p, v, c, s, _ = axis.mean
    return AxisEstimate((p, v, c + s, 0.0, 0.0), covariance)


def _covariance(steady: AxisSpread, oscillating_m2_s4: float) -> AxisCovariance:
    """Return the covariance of [p v c s q] with that of [p v c], and this variance of the oscillator's states."""
    pp, pv, pc, vv, vc, cc = steady
    variance = oscillating_m2_s4
    return AxisCovariance((pp, pv, pc, 0.0, 0.0, vv, vc, 0.0, 0.0, cc, 0.0, 0.0, variance, 0.0, variance))


def _spread(covariance: AxisCovariance) -> AxisSpread:
    """Return the covariance of [p v w], where w is the sum of the disturbance's parts."""
    pp, pv, pc, ps, _, vv, vc, vs, _, cc, cs, _, ss, _, _ = covariance.upper
    return pp, pv, pc + ps, vv, vc + vs, cc + 2.0 * cs + ss


def jump_m(before: Telemetry, after: Telemetry) -> tuple[float, float, float] | None:
    """Return how far a position (x, y, z) is from where the previous one and its velocity lead.

    None if a vehicle can fly that far in this time.
    """
    step_s = after.time_s - before.time_s
    (x, y, z), (to_x, to_y, to_z), (x_rate, y_rate, climb) = before.position_m, after.position_m, before.velocity_m_s
    off_x, off_y, off_z = to_x - x - x_rate * step_s, to_y - y - y_rate * step_s, to_z - z - climb * step_s
    is_jump = hypot(off_x, off_y, off_z) > JUMP_M + ACCELERATION_MAX_M_S2 / 2.0 * step_s**2
    return (off_x, off_y, off_z) if is_jump else None


class _InputHistory:
    """The setpoints sent, by the time from which they act."""

    def __init__(self, delay_s: float) -> None:
        self.delay_s = delay_s
        self._from_s: list[float] = []
        self._setpoint_m: list[_Pair] = []

    def start(self, time_s: float, position_m: _Pair) -> None:
        """Take the vehicle's position as the setpoint before the first one."""
        if not self._from_s:
            self._from_s.append(time_s)
            self._setpoint_m.append(position_m)

    def add(self, time_s: float, setpoint_m: Vector) -> None:
        # If the delay has become shorter, a setpoint still does not act before its predecessor.
        self._from_s.append(max(time_s + self.delay_s, self._from_s[-1] if self._from_s else -inf))
        self._setpoint_m.append((setpoint_m.item(0), setpoint_m.item(1)))
        oldest = bisect_right(self._from_s, time_s - _HISTORY_S) - 1
        if oldest > 0:
            del self._from_s[:oldest], self._setpoint_m[:oldest]

    def shift(self, x_m: float, y_m: float) -> None:
        self._setpoint_m = [(x + x_m, y + y_m) for x, y in self._setpoint_m]

    def ramp(self, from_s: float, to_s: float) -> tuple[_Pair, _Pair]:
        """Return the mean and the slope, along both axes, of the line nearest to the setpoints over an interval."""
        span_s = to_s - from_s
        if span_s <= 0.0:  # telemetry ahead of the clock
            return next(iter(self._pieces(from_s, from_s)))[2], (0.0, 0.0)
        x = y = x_moment = y_moment = 0.0
        for begin_s, end_s, (x_m, y_m) in self._pieces(from_s, to_s):
            duration_s = end_s - begin_s
            lever_s = (begin_s + end_s - from_s - to_s) / 2.0 * duration_s
            x, y = x + duration_s * x_m, y + duration_s * y_m
            x_moment, y_moment = x_moment + lever_s * x_m, y_moment + lever_s * y_m
        slope_gain = 12.0 / span_s**3
        return (x / span_s, y / span_s), (x_moment * slope_gain, y_moment * slope_gain)

    def mean(self, from_s: float, to_s: float) -> _Pair:
        """Return the mean setpoint over an interval; exact enough over one loop period."""
        x = y = 0.0
        for begin_s, end_s, (x_m, y_m) in self._pieces(from_s, to_s):
            x, y = x + (end_s - begin_s) * x_m, y + (end_s - begin_s) * y_m
        return x / (to_s - from_s), y / (to_s - from_s)

    def _pieces(self, from_s: float, to_s: float) -> Iterable[tuple[float, float, _Pair]]:
        """Return the pieces of an interval with a constant setpoint: begin, end and setpoint."""
        first = max(bisect_right(self._from_s, from_s) - 1, 0)
        last = max(bisect_right(self._from_s, to_s) - 1, 0)
        if first == last:
            return ((from_s, to_s, self._setpoint_m[last]),)
        edges = [from_s, *self._from_s[first + 1 : last + 1], to_s]
        return zip(edges, edges[1:], self._setpoint_m[first : last + 1], strict=False)


_Steps = Callable[[bool, float], tuple[AxialStep, AxialStep]]
_STEPS: "WeakValueDictionary[tuple[Plant, OwnFilterSettings], _Steps]" = WeakValueDictionary()


def _shared_steps(plant: Plant, settings: OwnFilterSettings) -> _Steps:
    """Return the steps of a plant, of which the latest are kept, for all filters of this process that have it.

    A step takes a kilobyte. Telemetry in flight comes at uneven times, and there are hundreds of steps.
    """
    key = plant, settings
    known = _STEPS.get(key)
    if known is None:
        known = _STEPS[key] = lru_cache(maxsize=4096)(partial(_steps, plant, settings))
    return known


def _steps(
    plant: Plant, settings: OwnFilterSettings, is_oscillating: bool, step_s: float
) -> tuple[AxialStep, AxialStep]:
    """Return one step along x and along y: the same object if both axes have the same plant."""
    exact = exact_step(plant, step_s)
    density, walk = settings.acceleration_noise_m_s2**2, settings.disturbance_noise_m_s2**2 * step_s

    def along(axis: PlantAxis, p: int, v: int) -> AxialStep:
        aimed_p, aimed_v = exact.input_gain.item(p, p), exact.input_gain.item(v, p)
        ramp_p, ramp_v = _ramp_gain(axis, aimed_p, aimed_v, step_s)
        return AxialStep(
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
            walk_s=OSCILLATOR_WALK_SHARE**2 * walk if is_oscillating else 0.0,
        )

    x = along(plant.x, 0, 2)
    return x, x if plant.y == plant.x else along(plant.y, 1, 3)


def _ramp_gain(axis: PlantAxis, aimed_p: float, aimed_v: float, step_s: float) -> _Pair:
    """Return the gains from the slope of the aim about its mean to position and velocity, given those of the aim.

    The ramp response is the integral of the step response: A^-1 (step response - B step) with the axis' system matrix A
    and input matrix B. The share of the ramp's mean is subtracted, since the aim's gain covers it.
    """
    followed_m = step_s - (aimed_v + axis.a1_per_s * aimed_p) / axis.a0_per_s2
    return followed_m - aimed_p * step_s / 2.0, aimed_p - aimed_v * step_s / 2.0
