"""Ways around no-fly zones: the room that plans keep from zones, and the heights at which zones count."""

from collections.abc import Sequence
from typing import Final

from agents.settings.sections import ChoreographySettings, EncirclementSettings

ZONE_MARGIN_M: Final = 1.0
"""The room to a zone, across and in height, that plans keep."""


def heights_m(
    altitudes_m: Sequence[float], ring: EncirclementSettings | None, layers: ChoreographySettings | None
) -> tuple[float, float]:
    """Return the lowest and the highest height between take-off and landing of vehicles with these flying heights."""
    low_m, high_m = min(altitudes_m), max(altitudes_m)
    if layers is not None:
        high_m += len(altitudes_m) * layers.layer_m
    if ring is not None and ring.altitude != "target":
        ring_low_m, ring_high_m = ring.band_m(min(altitudes_m), max(altitudes_m) - min(altitudes_m))
        low_m, high_m = min(low_m, ring_low_m), max(high_m, ring_high_m)
    return low_m, high_m
