"""The target's altitude: a random walk, filtered apart from its motion in the plane, by the sightings that tell one.

What is believed stays as it is while nobody tells more.
"""

from math import inf

from estimation.settings import TargetFilterSettings
from estimation.state import Sighting

WANDERS_M = 0.5
"""How far an altitude wanders in the square root of a second: a climb of 1 m/s is followed half a second late."""


class TargetAltitude:
    """Filters the altitudes of everybody's sightings; outliers and what comes too late are refused."""

    def __init__(self, settings: TargetFilterSettings) -> None:
        self._settings = settings
        self._mean_m: float | None = None
        self._variance_m2 = 0.0
        self._time_s = -inf
        self._doubted_s = inf

    @property
    def mean_m(self) -> float | None:
        """The altitude above the mission's origin, None if none was ever told."""
        return self._mean_m

    def sight(self, sighting: Sighting) -> None:
        """Take in a sighting, if it tells an altitude; one that disagrees for a while is believed from then on."""
        if sighting.altitude_m is None or sighting.time_s < self._time_s - self._settings.late_max_s:
            return
        since_s = max(sighting.time_s - self._time_s, 0.0)
        if self._mean_m is None or since_s > self._settings.stale_after_s:
            self._start(sighting.altitude_m, sighting)
            return
        variance_m2 = self._variance_m2 + WANDERS_M**2 * since_s
        innovation_m, expected_m2 = sighting.altitude_m - self._mean_m, variance_m2 + sighting.altitude_sigma_m**2
        if innovation_m**2 > self._settings.gate_sigma**2 * expected_m2:
            self._doubted_s = min(self._doubted_s, sighting.time_s)
            if sighting.time_s - self._doubted_s > self._settings.gate_timeout_s:
                self._start(sighting.altitude_m, sighting)
            return
        gain = variance_m2 / expected_m2
        self._mean_m += gain * innovation_m
        self._variance_m2 = (1.0 - gain) * variance_m2
        self._time_s, self._doubted_s = max(self._time_s, sighting.time_s), inf

    def _start(self, altitude_m: float, sighting: Sighting) -> None:
        self._mean_m, self._variance_m2 = altitude_m, sighting.altitude_sigma_m**2
        self._time_s, self._doubted_s = sighting.time_s, inf
