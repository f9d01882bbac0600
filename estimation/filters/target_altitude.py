"""The target's altitude: a random walk, filtered from sightings with an altitude, apart from its horizontal motion.

Without further sightings the estimate is constant.
"""

from math import inf
from typing import Final

import numpy as np
from filterpy import kalman

from estimation.settings import TargetFilterSettings
from estimation.state import Sighting, Vector

RANDOM_WALK_M: Final = 0.5
"""Random walk of the altitude per square root of a second: a climb of 1 m/s is followed with a lag of 0.5 s."""
_OBSERVATION = np.eye(1)


class TargetAltitude:
    """Filters the altitudes of the team's sightings; outliers and late ones are refused."""

    def __init__(self, settings: TargetFilterSettings) -> None:
        self._settings = settings
        self._mean_m: Vector | None = None
        self._variance_m2 = np.zeros((1, 1))
        self._time_s = -inf
        self._refused_since_s = inf

    @property
    def mean_m(self) -> float | None:
        """The altitude above the mission's origin [m]; None before any sighting with an altitude."""
        return None if self._mean_m is None else self._mean_m.item()

    def sight(self, sighting: Sighting) -> None:
        """Process a sighting that has an altitude; restart when outliers persist for the gate's timeout."""
        if sighting.altitude_m is None or sighting.time_s < self._time_s - self._settings.late_max_s:
            return
        since_s = max(sighting.time_s - self._time_s, 0.0)
        if self._mean_m is None or since_s > self._settings.stale_after_s:
            self._start(sighting.altitude_m, sighting)
            return
        mean_m, variance_m2 = kalman.predict(self._mean_m, self._variance_m2, Q=RANDOM_WALK_M**2 * since_s)
        noise_m2 = sighting.altitude_sigma_m**2
        innovation_m, expected_m2 = sighting.altitude_m - mean_m.item(), variance_m2.item() + noise_m2
        if innovation_m**2 > self._settings.gate_sigma**2 * expected_m2:
            self._refused_since_s = min(self._refused_since_s, sighting.time_s)
            if sighting.time_s - self._refused_since_s > self._settings.gate_timeout_s:
                self._start(sighting.altitude_m, sighting)
            return
        self._mean_m, self._variance_m2 = kalman.update(
            mean_m, variance_m2, sighting.altitude_m, noise_m2, H=_OBSERVATION
        )
        self._time_s, self._refused_since_s = max(self._time_s, sighting.time_s), inf

    def _start(self, altitude_m: float, sighting: Sighting) -> None:
        self._mean_m, self._variance_m2 = np.array([altitude_m]), np.array([[sighting.altitude_sigma_m**2]])
        self._time_s, self._refused_since_s = sighting.time_s, inf
