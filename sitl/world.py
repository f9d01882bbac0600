"""The world around the vehicles: where the target truly is, the sensors that see it, and the wind."""

from dataclasses import dataclass
from math import hypot

import numpy as np

from estimation.state import Sighting


@dataclass(frozen=True, slots=True)
class TargetMotion:
    """A target that moves in a straight line: where it is at mission time 0, and its velocity."""

    start_m: tuple[float, float]
    velocity_m_s: tuple[float, float]

    def position_m(self, mission_time_s: float) -> tuple[float, float]:
        """Return where the target is; before the mission starts it waits."""
        elapsed = max(mission_time_s, 0.0)
        return (
            self.start_m[0] + self.velocity_m_s[0] * elapsed,
            self.start_m[1] + self.velocity_m_s[1] * elapsed,
        )


@dataclass(frozen=True, slots=True)
class SensorModel:
    """A sensor of the target: how far and how often it sees, its noise per axis, and how it rates the target."""

    range_m: float
    rate_hz: float
    noise_m: float
    importance: float
    threat: float


class SimulatedSensor:
    """One vehicle's sensor of a simulated target; seeded, so that the same flight sees the same twice."""

    # Even an ideal sensor has a covariance: a zero would make the filters trust rounding errors.
    _NOISE_MIN_M = 0.01

    def __init__(self, sensor_id: int, model: SensorModel, target: TargetMotion, start_s: float, seed: int) -> None:
        self._sensor_id = sensor_id
        self._model = model
        self._target = target
        self._start_s = start_s
        self._random = np.random.default_rng([seed, 1, sensor_id])
        self._due_s: float | None = None

    def sight(self, now_s: float, position_m: tuple[float, float]) -> Sighting | None:
        """Return a sighting when one is due and the target is within range of `position_m`."""
        due_s = now_s if self._due_s is None else self._due_s
        # A tick in advance of the due time by rounding alone still counts as on time.
        if now_s < due_s - 1e-6:
            return None
        period_s = 1.0 / self._model.rate_hz
        self._due_s = max(due_s + period_s, now_s + period_s / 2.0)
        x, y = self._target.position_m(now_s - self._start_s)
        if hypot(x - position_m[0], y - position_m[1]) > self._model.range_m:
            return None
        noise_x, noise_y = (self._random.standard_normal(2) * self._model.noise_m).tolist()
        variance = max(self._model.noise_m, self._NOISE_MIN_M) ** 2
        return Sighting(
            now_s,
            self._sensor_id,
            (x + noise_x, y + noise_y),
            (variance, 0.0, variance),
            self._model.importance,
            self._model.threat,
        )
