"""The zones of a geofence, in which a vehicle has to stay, or which it must not enter.

Mission frame, metres.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, isfinite

from estimation.frames import Geodetic, MissionFrame
from sitl.mavlink_constants import Fields

INCLUSION_POLYGON, EXCLUSION_POLYGON, INCLUSION_CIRCLE, EXCLUSION_CIRCLE = 5001, 5002, 5003, 5004
"""MAV_CMD_NAV_FENCE_*: a polygon has one item per corner, with the number of corners in the first parameter."""
CORNERS_LEAST = 3
DEG_E7 = 1e7

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Zone:
    """An inclusion or exclusion zone: a polygon, or a circle around its only corner."""

    stay_inside: bool
    corners_m: tuple[Place, ...]
    radius_m: float = 0.0

    def allows(self, place_m: Place) -> bool:
        """Return whether a place is allowed by this zone."""
        return self._contains(place_m) is self.stay_inside

    def _contains(self, place_m: Place) -> bool:
        x, y = place_m
        if len(self.corners_m) == 1:
            (x0, y0), *_ = self.corners_m
            return hypot(x - x0, y - y0) <= self.radius_m
        # A ray to the right crosses the outline an odd number of times.
        crossed = (
            (y0 > y) is not (y1 > y) and x < x0 + (x1 - x0) * (y - y0) / (y1 - y0)
            for (x0, y0), (x1, y1) in pairwise((*self.corners_m, self.corners_m[0]))
        )
        return sum(crossed) % 2 == 1


def zones_of(items: Sequence[Fields], frame: MissionFrame) -> tuple[Zone, ...]:
    """Return the zones of a fence plan (see `Plans.items`); invalid items are ignored."""
    return tuple(_zones(list(items), frame))


def _zones(items: list[Fields], frame: MissionFrame) -> Iterator[Zone]:
    while items:
        _, command, _, _, size, *_ = items[0]
        polygon = command in (INCLUSION_POLYGON, EXCLUSION_POLYGON)
        count = int(size) if polygon and isfinite(size) and size >= CORNERS_LEAST else 1
        group, items = items[:count], items[count:]
        try:
            corners = tuple(_place_m(item, frame) for item in group)
        except ValueError:  # an invalid geodetic position, or a local frame
            continue
        inside = command in (INCLUSION_POLYGON, INCLUSION_CIRCLE)
        if polygon and len(corners) == count >= CORNERS_LEAST:
            yield Zone(inside, corners)
        elif command in (INCLUSION_CIRCLE, EXCLUSION_CIRCLE) and isfinite(size):
            yield Zone(inside, corners, size)


def _place_m(item: Fields, frame: MissionFrame) -> Place:
    altitude_m = 0.0 if frame.origin is None else frame.origin.altitude_m
    x, y, _ = frame.mission_from_geodetic(Geodetic(item[8] / DEG_E7, item[9] / DEG_E7, altitude_m))
    return x, y
