"""The altitude of a vehicle's setpoints: its layer, or on the ring an offset above the target's altitude.

All vehicles are raised by the same amount, which keeps the differences of their `altitude_m`, also if the altitude
limit of one of them is reached.
"""

from typing import TYPE_CHECKING

from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from estimation.settings import TargetFilterSettings
from estimation.state import Sighting

if TYPE_CHECKING:
    from estimation.filters.target_altitude import TargetAltitude

_STAYS = (Tactic.HOLD, Tactic.ASIDE)


class Altitude:
    """Computes one vehicle's altitude, with a bounded rate if the mission follows the target's altitude."""

    def __init__(self, config: AgentConfig) -> None:
        ring = config.encirclement
        self._flying_m = config.altitude_m
        self._target = _target_altitude(config.target_filter) if ring.altitude == "target" else None
        lowest_m = config.altitude_m if config.altitude_lowest_m is None else config.altitude_lowest_m
        self._above_lowest_m = config.altitude_m - lowest_m
        self._offset_m = ring.altitude_offset_m or 0.0
        self._low_m, self._high_m = config.lowest_between_m
        self._step_m = ring.climb_max_m_s / config.rate_hz
        self._altitude_m = config.take_off_altitude_m

    @property
    def target_m(self) -> float | None:
        """The estimate of the target's altitude, None if it is unknown or not followed."""
        return None if self._target is None else self._target.mean_m

    def sight(self, *sightings: Sighting) -> None:
        """Take sightings from any sensors, in any order."""
        if self._target is not None:
            for sighting in sorted(sightings, key=lambda each: each.time_s):
                self._target.sight(sighting)

    def next_m(self, tactic: Tactic, layer_m: float) -> float:
        """Return the altitude of the next setpoint, once for each; `layer_m` is the altitude without a target."""
        if self._target is None:
            return layer_m
        left_m = self._wanted_m(tactic, layer_m) - self._altitude_m
        self._altitude_m += min(max(left_m, -self._step_m), self._step_m)
        return self._altitude_m

    def _wanted_m(self, tactic: Tactic, layer_m: float) -> float:
        if tactic in _STAYS:
            return self._altitude_m
        # Every vehicle stays in its layer until all are in their places.
        if tactic is not Tactic.ENCIRCLE or layer_m != self._flying_m or self.target_m is None:
            return layer_m
        lowest_m = self.target_m + self._offset_m
        lowest_m = lowest_m if self._high_m is None else min(lowest_m, self._high_m)
        lowest_m = lowest_m if self._low_m is None else max(lowest_m, self._low_m)
        return lowest_m + self._above_lowest_m


def _target_altitude(settings: TargetFilterSettings) -> "TargetAltitude":
    # filterpy takes as long to import as the rest of an agent, and few missions follow an altitude.
    from estimation.filters.target_altitude import TargetAltitude  # noqa: PLC0415

    return TargetAltitude(settings)
