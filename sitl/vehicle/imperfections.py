"""The imperfections of one simulated vehicle besides its plant; a mission or a random draw sets them."""

from collections import deque
from dataclasses import dataclass
from math import cos, exp, inf, pi, sin, sqrt
from typing import Final

import numpy as np

from sitl.draws import AHEAD, normals
from sitl.vehicle.shaping import ShapeLimits

_REMEMBERED: Final = 512
"""The number of stored errors: five seconds, the largest delay of a sensor, at 100 Hz."""


@dataclass(frozen=True, slots=True)
class EstimatorDriftModel:
    """The error's standard deviation per axis, its correlation time, and the mean interval and size of its jumps.

    Each axis is a first-order Gauss-Markov process. A jump, such as after a reset of the estimator, decays with the
    error.
    """

    sigma_m: float
    correlation_s: float = 20.0
    jumps_every_s: float = inf
    jump_m: float = 1.0


class EstimatorDrift:
    """The estimation error of one vehicle over time."""

    def __init__(self, model: EstimatorDriftModel, random: np.random.Generator) -> None:
        """Start at time 0 with an error of the stationary distribution."""
        self._model = model
        self._random = random
        # Times and directions of jumps are drawn from the same generator.
        self._normals = normals(random, AHEAD if model.jumps_every_s == inf else 1)
        self._error_m = model.sigma_m * next(self._normals), model.sigma_m * next(self._normals)
        self._time_s = 0.0
        self._jumps_s = self._next_jump_s(0.0)
        self._past: deque[tuple[float, tuple[float, float]]] = deque(maxlen=_REMEMBERED)

    def error_m(self, time_s: float) -> tuple[float, float]:
        """Return the error (x, y) of the estimate [m]; times must not decrease from call to call."""
        if time_s > self._time_s:
            self._past.append((self._time_s, self._error_m))
            kept = exp((self._time_s - time_s) / self._model.correlation_s)
            push_m = self._model.sigma_m * sqrt(1.0 - kept**2)
            x, y = self._error_m
            self._error_m = kept * x + push_m * next(self._normals), kept * y + push_m * next(self._normals)
            self._time_s = time_s
        while self._jumps_s <= time_s:
            self._jump()
        return self._error_m

    def earlier_error_m(self, time_s: float) -> tuple[float, float]:
        """Return the error at an earlier time, as stored for the nearest time before it."""
        if time_s >= self._time_s:
            return self._error_m
        return next((error_m for at_s, error_m in reversed(self._past) if at_s <= time_s), self._error_m)

    def _jump(self) -> None:
        direction_rad = self._random.uniform(0.0, 2.0 * pi)
        x, y = self._error_m
        self._error_m = x + self._model.jump_m * cos(direction_rad), y + self._model.jump_m * sin(direction_rad)
        self._jumps_s = self._next_jump_s(self._jumps_s)

    def _next_jump_s(self, after_s: float) -> float:
        every_s = self._model.jumps_every_s
        return inf if every_s == inf else after_s + float(self._random.exponential(every_s))


@dataclass(frozen=True, slots=True)
class TelemetryTiming:
    """The rate, the jitter as a share of the period (less than half), and the mean interval and duration of gaps."""

    rate_hz: float
    jitter: float = 0.0
    gaps_every_s: float = inf
    gap_s: float = 0.0


class TelemetrySchedule:
    """The sample times of one vehicle's telemetry."""

    def __init__(self, model: TelemetryTiming, random: np.random.Generator) -> None:
        self._model = model
        self._random = random
        self._count = 0
        self._gap_s = self._next_gap_s(0.0)
        self._due_s = 0.0

    def due_s(self, until_s: float) -> list[float]:
        """Return the times of all samples up to `until_s` that were not returned before."""
        due_s = []
        while self._due_s <= until_s:
            due_s.append(self._due_s)
            self._due_s = self._next_s()
        return due_s

    def _next_s(self) -> float:
        period_s, jitter = 1.0 / self._model.rate_hz, self._model.jitter
        while True:
            self._count += 1
            next_s = (self._count + jitter * float(self._random.uniform(-1.0, 1.0))) * period_s
            if next_s >= self._gap_s + self._model.gap_s:
                self._gap_s = self._next_gap_s(next_s)
            if next_s < self._gap_s:
                return next_s

    def _next_gap_s(self, after_s: float) -> float:
        every_s = self._model.gaps_every_s
        return inf if every_s == inf else after_s + float(self._random.exponential(every_s))


DRAG_PER_S: Final = 0.05
"""Acceleration per airspeed: a wind of 8 m/s causes 0.4 m/s².

The rotors and body of a quadrotor of 1.5 to 2 kg cause 0.1 to 0.3 1/s. But the plant is the closed position loop of an
autopilot, whose velocity loop has an integrator that the plant does not model: it removes slow disturbances and about
half of the gusts. The remainder is modelled as one share for wind and gusts, the harder case for an observer.
"""


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Limits of the motion's shaping, wind [m/s], gusts, drag, drift of the estimator, timing of the telemetry.

    None is ideal: no limits, no drift, one sample per tick.
    """

    shape: ShapeLimits | None = None
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    gusts: bool = False
    drag_per_s: float = DRAG_PER_S
    estimator_drift: EstimatorDriftModel | None = None
    telemetry_timing: TelemetryTiming | None = None


IDEAL = Imperfections()
