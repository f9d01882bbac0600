"""Drift of a vehicle's position estimate: a slow random error with occasional jumps."""

from collections import deque
from dataclasses import dataclass
from math import cos, exp, inf, pi, sin, sqrt

import numpy as np

from sitl.draws import AHEAD, normals

_REMEMBERED = 512
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
