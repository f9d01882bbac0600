"""The telemetry sample times of a vehicle: a rate with jitter and gaps."""

from dataclasses import dataclass
from math import inf

import numpy as np


@dataclass(frozen=True, slots=True)
class TelemetryTiming:
    """The rate, the jitter as a share of the period, and the mean interval and duration of gaps.

    Raises ValueError if samples could be out of order.
    """

    rate_hz: float
    jitter: float = 0.0
    gaps_every_s: float = inf
    gap_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.rate_hz > 0.0:
            raise ValueError(f"rate_hz = {self.rate_hz}: it must be positive")
        if not 0.0 <= self.jitter < 0.5:
            raise ValueError(f"jitter = {self.jitter}: it must be less than half a period")


class TelemetrySchedule:
    """The sample times of one vehicle's telemetry."""

    def __init__(self, model: TelemetryTiming, random: np.random.Generator) -> None:
        """Start with a sample at time 0."""
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
