"""Detection of speed and acceleration limits of an autopilot, which a linear plant does not model.

The simulation follows both PX4 and ArduPilot: the distance to the setpoint determines a speed, which is bounded; the
speed error determines an acceleration, which is bounded too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares

from estimation.identification.excerpts import GRID_S, Excerpt
from estimation.identification.output_error import Fit
from estimation.identification.response import AxisInput, SetpointSteps
from estimation.state import Vector

_SAMPLES_MAX = 3000


@dataclass(frozen=True, slots=True)
class Shaping:
    """The bounds that explain the flights best: speed [m/s], acceleration [m/s2], and the share of time at each.

    `error_ratio` is the ratio of the errors with bounds to those without; near 1 the bounds do not matter.
    """

    speed_max_m_s: float
    speed_share: float
    acceleration_max_m_s2: float
    acceleration_share: float
    error_ratio: float

    @property
    def matters(self) -> bool:
        """Whether the bounds explain the flights markedly better."""
        return self.error_ratio < 0.85


UNSHAPED = Shaping(np.inf, 0.0, np.inf, 0.0, 1.0)
"""No bounds."""


def shaping_of(excerpts: Sequence[Excerpt], linear: Fit) -> Shaping:
    """Fit bounds of speed and acceleration together with the plant, from the plant without them and from a quick one.

    Where the bounds were met all the time, the plant without them is so slow that a fit from there finds none.
    """
    problem = _Bounded(excerpts, linear)
    parameters, (speed, acceleration) = linear.parameters[:5], problem.greatest
    unbounded = problem.errors(np.clip(np.append(parameters, _LOG_MAX + np.zeros(2)), *_BOUNDS))
    best, least = None, np.inf
    for plant in (parameters[:4], np.log(_QUICK)):
        for share, multiple in ((0.8, 0.8), (0.9, 3.0)):
            bounds = np.log((share * speed, multiple * acceleration))
            start = np.clip(np.concatenate((plant, parameters[4:], bounds)), *_BOUNDS)
            solution = least_squares(
                problem.errors, start, jac=problem.jacobian, bounds=_BOUNDS, x_scale=0.1, max_nfev=15
            )
            if solution.cost < least:
                best, least = solution.x, solution.cost
    assert best is not None
    errors = problem.errors(best)
    shares = problem.shares(best)
    ratio = float(np.sqrt((errors @ errors) / max(float(unbounded @ unbounded), 1e-12)))
    return Shaping(float(np.exp(best[5])), shares[0], float(np.exp(best[6])), shares[1], min(ratio, 1.0))


_NUDGE, _HALF_S = 1e-3, GRID_S / 2.0
_QUICK = (2.0, 2.5) * 2
_LOG_MIN, _LOG_MAX = np.log(0.02), np.log(60.0)
_BOUNDS = (
    np.array([_LOG_MIN] * 4 + [-0.05, np.log(0.05), np.log(0.05)]),
    np.array([_LOG_MAX] * 4 + [0.65, np.log(60.0), np.log(60.0)]),
)


class _Bounded:
    """The least-squares problem; all perturbed parameter sets are simulated in parallel."""

    def __init__(self, excerpts: Sequence[Excerpt], linear: Fit) -> None:
        # One set takes nearly as long to simulate as all those that the derivatives at the same place need next.
        self._errors_around = lru_cache(1)(self._simulated)
        self._flights = []
        self._leads_s = linear.model.leads_s(linear.parameters)
        left = _SAMPLES_MAX
        for excerpt in sorted(excerpts, key=lambda each: -each.duration_s):
            count = min(left, excerpt.position_m.shape[0])
            left -= count
            if count > 1.0 / GRID_S:
                # The linear plant has a constant disturbance: a steady wind, or an estimator that is off, is no limit.
                offset_m = (excerpt.position_m - excerpt.setpoint_m()).mean(axis=0)
                position_m = excerpt.position_m[:count] - offset_m
                self._flights.append((excerpt.begin_s, position_m, excerpt.inputs(linear.model.between)))
        filtered = [_smoothed_speed(position_m) for _, position_m, _ in self._flights]
        speed = max(float(np.quantile(np.abs(each), 0.98)) for each in filtered)
        change = max(float(np.quantile(np.abs(np.diff(each, axis=0)), 0.98)) / GRID_S for each in filtered)
        self.greatest = max(speed, 0.1), max(change, 0.1)

    def errors(self, parameters: Vector) -> Vector:
        """Return measured minus simulated positions of all flights, each without its mean."""
        here, *_ = self._errors_around(tuple(parameters.tolist()))
        return here

    def jacobian(self, parameters: Vector) -> Vector:
        _, above, below = self._errors_around(tuple(parameters.tolist()))
        return np.asarray((above - below).T / (2.0 * _NUDGE), dtype=np.float64)

    def _simulated(self, parameters: tuple[float, ...]) -> tuple[Vector, Vector, Vector]:
        """Return the errors at parameters (N,), and above and below them along each, (7, N)."""
        here = np.array(parameters)
        nudges = _NUDGE * np.eye(here.size)
        errors = self._errors(np.vstack((here, here + nudges, here - nudges)))
        return errors[0], errors[1 : 1 + here.size], errors[1 + here.size :]

    def shares(self, parameters: Vector) -> tuple[float, float]:
        """Return the shares of the time at the bounds of speed and of acceleration."""
        held = np.concatenate([_flown(parameters[None, :], self._leads_s, *flight)[1] for flight in self._flights])
        return float(held[:, 0].mean()), float(held[:, 1].mean())

    def _errors(self, rows: Vector) -> Vector:
        parts = []
        for begin_s, position_m, inputs in self._flights:
            path_m, _ = _flown(rows, self._leads_s, begin_s, position_m, inputs)
            apart = position_m.T[None, :, :] - path_m
            parts.append((apart - apart.mean(axis=2, keepdims=True)).reshape(rows.shape[0], -1))
        return np.concatenate(parts, axis=1)


def _smoothed_speed(position_m: Vector) -> Vector:
    return np.asarray((position_m[4:] - position_m[:-4]) / (4.0 * GRID_S), dtype=np.float64)


def _flown(
    rows: Vector, leads_s: tuple[float, float], begin_s: float, position_m: Vector, parts: tuple[AxisInput, AxisInput]
) -> tuple[Vector, Vector]:
    """Simulate K parameter sets (K, 7) in parallel; feed-forward velocities lead the aims by `leads_s`.

    Returns positions (K, 2, T), and of the first set whether speed and acceleration were bounded (T, 2), as 0 or 1.
    """
    count = position_m.shape[0]
    a0, a1 = np.exp(rows[:, [0, 2]]), np.exp(rows[:, [1, 3]])
    speed_max, force_max = np.exp(rows[:, 5:6]), np.exp(rows[:, 6:7])
    inputs = mean_inputs(rows[:, 4], begin_s, count, [part.position for part in parts])
    velocities = [part.velocity for part in parts if part.velocity is not None]
    if velocities and leads_s != (0.0, 0.0):
        inputs += leads_s * mean_inputs(rows[:, 4], begin_s, count, velocities)
    ratio, taken = a0 / a1, 1.0 - np.exp(-a1 * GRID_S)
    change_max = force_max * GRID_S
    speed_min, change_min = -speed_max, -change_max
    position = np.repeat(position_m[None, 0], rows.shape[0], axis=0)
    velocity = np.repeat((position_m[5] - position_m[0])[None] / (5.0 * GRID_S), rows.shape[0], axis=0)
    paths = np.empty((count, rows.shape[0], 2))
    speeds = np.empty((count, 2))
    for at in range(count):
        paths[at], speeds[at] = position, velocity[0]
        wanted = np.minimum(np.maximum(ratio * (inputs[at] - position - velocity * _HALF_S), speed_min), speed_max)
        change = np.minimum(np.maximum((wanted - velocity) * taken, change_min), change_max)
        position = position + (velocity + change / 2.0) * GRID_S
        velocity = velocity + change
    unlimited = ratio[0] * (inputs[:, 0] - paths[:, 0] - speeds * _HALF_S)
    change = (np.clip(unlimited, speed_min[0], speed_max[0]) - speeds) * taken[0]
    held = (np.abs(unlimited) > speed_max[0]).any(axis=1), (np.abs(change) > change_max[0]).any(axis=1)
    return paths.transpose(1, 2, 0), np.column_stack(held).astype(np.float64)


def mean_inputs(delays_s: Vector, begin_s: float, count: int, steps: Sequence[SetpointSteps]) -> Vector:
    """Return the mean of each axis' setpoint over each step, for K delays: (T, K, 2)."""
    edges_s = begin_s + np.arange(count + 1) * GRID_S
    inputs = np.empty((count, delays_s.size, 2))
    for axis, each in enumerate(steps):
        # The integral of the setpoint between its knots is exact for steps, and nearly so for ramps.
        knots_s = np.concatenate(([min(begin_s - 2.0, each.time_s.min(initial=begin_s) - 1.0)], each.time_s))
        if each.ramps:
            knots_s = np.union1d(knots_s, edges_s)
        levels = _levels(each, knots_s)
        knots_s = np.append(knots_s, knots_s[-1] + 1e6)
        total = np.concatenate(([0.0], np.cumsum(levels * np.diff(knots_s))))
        for column, delay_s in enumerate(delays_s):
            inputs[:, column, axis] = np.diff(np.interp(edges_s - delay_s, knots_s, total)) / GRID_S
    return inputs


def _levels(steps: SetpointSteps, knots_s: Vector) -> Vector:
    index = np.searchsorted(steps.time_s, knots_s, side="right")
    sums = np.concatenate(([0.0], np.cumsum(steps.size)))
    if not steps.ramps:
        return np.asarray(steps.before_m + sums[index], dtype=np.float64)
    moments = np.concatenate(([0.0], np.cumsum(steps.size * steps.time_s)))
    return np.asarray(steps.before_m + sums[index] * knots_s - moments[index], dtype=np.float64)
