"""Boundaries in the mission frame, and the distances to them: the fence, which encloses the vehicles, and no-fly zones.

The free side of a fence is its inside, that of a zone its outside; everything else is the same for both.
"""

from collections.abc import Sequence
from math import hypot, inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from agents.settings.sections import NoFlySection, SafetySettings
from estimation.state import Vector

Corner = tuple[float, float]
_ON_EDGE_M: Final = 1e-9


class NearestPoint:
    """The point of one edge that is nearest to a place: its distance, and the unit vector from it to the free side.

    `end` is -1 or 1 if it is the corner where the edge begins or ends.
    """

    def __init__(self, distance_m: float, inward: Corner, end: int = 0) -> None:
        self.distance_m: Final = distance_m
        self.inward: Final = inward
        self.end: Final = end


class Fence:
    """A polygon by its corners, in either orientation; edges must not cross each other.

    One that `encloses` has its inside as its free side, else its outside.
    """

    def __init__(self, corners_m: Sequence[Corner], encloses: bool = True) -> None:
        self._encloses = encloses
        self._edges = tuple(zip(corners_m, (*corners_m[1:], corners_m[0]), strict=True))
        doubled_area_m2 = sum(x1 * y2 - x2 * y1 for (x1, y1), (x2, y2) in self._edges)
        self.area_m2: Final = abs(doubled_area_m2) / 2.0
        self._left_is_inward = 1.0 if (doubled_area_m2 > 0.0) is encloses else -1.0
        # Whether the corner where each edge begins sticks into the free side.
        self._sticks_in = tuple(
            self._left_is_inward * _side(*before, end) < 0.0
            for before, (_, end) in zip((self._edges[-1], *self._edges[:-1]), self._edges, strict=True)
        )

    def contains(self, place_m: Corner) -> bool:
        """Return whether a place is on the free side: a ray from an inner one crosses an odd number of edges."""
        x, y = place_m
        inside = not self._encloses
        for (x1, y1), (x2, y2) in self._edges:
            if (y1 > y) != (y2 > y) and x < x1 + (y - y1) / (y2 - y1) * (x2 - x1):
                inside = not inside
        return inside

    def clearance_m(self, place_m: Corner) -> float:
        """Return the distance to the boundary, negative beyond it."""
        nearest_m = min(point.distance_m for point in self._points(place_m, 1.0))
        return nearest_m if self.contains(place_m) else -nearest_m

    def clearances_m(self, places_m: Vector) -> Vector:
        """Return the distances (n,) of places (n, 2) to the boundary, negative beyond it."""
        x, y = places_m[:, 0], places_m[:, 1]
        inside: NDArray[np.bool_] = np.full(len(places_m), not self._encloses)
        nearest_m: Vector = np.full(len(places_m), inf)
        for (x1, y1), (x2, y2) in self._edges:
            if y1 != y2:
                inside ^= ((y1 > y) != (y2 > y)) & (x < x1 + (y - y1) / (y2 - y1) * (x2 - x1))
            along_x, along_y = x2 - x1, y2 - y1
            share = ((x - x1) * along_x + (y - y1) * along_y) / (along_x**2 + along_y**2)
            share = np.clip(share, 0.0, 1.0)
            nearest_m = np.minimum(nearest_m, np.hypot(x - x1 - share * along_x, y - y1 - share * along_y))
        return np.where(inside, nearest_m, -nearest_m)

    def reach_m(self, place_m: Corner, direction: Corner) -> float:
        """Return the distance to the boundary along a unit direction; infinity from a place beyond it."""
        if not self.contains(place_m):
            return inf
        return min(_ahead(place_m, direction, start, end) for start, end in self._edges)

    def nearest_points(self, place_m: Corner, within_m: float = inf) -> list[NearestPoint]:
        """Return the nearest point of every edge within a distance; from beyond that of the nearest edge alone.

        From beyond the distance is negative, and only the way back matters. A vehicle that flies along an edge towards
        a corner that sticks into the free side passes it: the edge behind that corner is left out until then. So are
        edges of a zone that face away from the vehicle: it would meet another one first.
        """
        if self.contains(place_m):
            points = self._points(place_m, 1.0)
            return [
                point
                for i, point in enumerate(points)
                if point.distance_m <= within_m and not self._hidden(points, i) and self._faces(i, place_m)
            ]
        nearest = min(self._points(place_m, -1.0), key=lambda point: point.distance_m)
        return [NearestPoint(-nearest.distance_m, nearest.inward)]

    def _points(self, place_m: Corner, sense: float) -> list[NearestPoint]:
        return [_nearest(place_m, start, end, sense, self._left_is_inward) for start, end in self._edges]

    def _faces(self, index: int, place_m: Corner) -> bool:
        """Return whether a place is on the free side of an edge, for a zone; every edge counts of a fence."""
        return self._encloses or self._left_is_inward * _side(*self._edges[index], place_m) >= 0.0

    def _hidden(self, points: list[NearestPoint], index: int) -> bool:
        """Return whether the nearest point of an edge is a corner that sticks out, seen along the edge before it."""
        following = (index + 1) % len(points)
        match points[index].end:
            case -1:
                return self._sticks_in[index] and points[index - 1].end == 0
            case 1:
                return self._sticks_in[following] and points[following].end == 0
            case _:
                return False

    def crossed_edges(self) -> tuple[int, int] | None:
        """Return two edges that cross each other or touch without being neighbours, None for a simple polygon."""
        count = len(self._edges)
        for i in range(count):
            for k in range(i + 2, count):
                if (i, k) != (0, count - 1) and _meet(*self._edges[i], *self._edges[k]):
                    return i, k
        return None


class RoundEdge:
    """A circle whose outside is free."""

    def __init__(self, center_m: Corner, radius_m: float) -> None:
        self._center_m = center_m
        self._radius_m = radius_m

    def contains(self, place_m: Corner) -> bool:
        """Return whether a place is on the free side."""
        return self.clearance_m(place_m) >= 0.0

    def clearance_m(self, place_m: Corner) -> float:
        """Return the distance to the circle, negative inside."""
        return hypot(place_m[0] - self._center_m[0], place_m[1] - self._center_m[1]) - self._radius_m

    def clearances_m(self, places_m: Vector) -> Vector:
        """Return the distances (n,) of places (n, 2) to the circle, negative inside."""
        return np.hypot(places_m[:, 0] - self._center_m[0], places_m[:, 1] - self._center_m[1]) - self._radius_m

    def nearest_points(self, place_m: Corner, within_m: float = inf) -> list[NearestPoint]:
        """Return the nearest point of the circle if it is within a distance, which is negative inside."""
        away_x, away_y = place_m[0] - self._center_m[0], place_m[1] - self._center_m[1]
        away_m = hypot(away_x, away_y)
        distance_m = away_m - self._radius_m
        if distance_m > within_m:
            return []
        direction = (away_x / away_m, away_y / away_m) if away_m > _ON_EDGE_M else (1.0, 0.0)
        return [NearestPoint(distance_m, direction)]


class NoFlyZone:
    """A no-fly zone: its name, its boundary, and the heights between which it is closed."""

    def __init__(self, section: NoFlySection) -> None:
        center_m, radius_m = section.center_m, section.radius_m
        self.name: Final = section.name
        self.boundary: Final[Fence | RoundEdge] = (
            Fence(section.polygon_m, encloses=False)
            if center_m is None or radius_m is None
            else RoundEdge(center_m, radius_m)
        )
        self.floor_m: Final = -inf if section.floor_m is None else section.floor_m
        self.ceiling_m: Final = inf if section.ceiling_m is None else section.ceiling_m

    def overlaps(self, low_m: float, high_m: float) -> bool:
        """Return whether the zone is closed at a height between two."""
        return self.floor_m <= high_m and self.ceiling_m >= low_m

    def height_m(self, planned_m: float, height_m: float, margin_m: float) -> float:
        """Return the height nearest to a planned one that a vehicle at `height_m`, above or below the zone, may have.

        At a height of the zone it is the planned one: what keeps it out is the boundary.
        """
        if height_m < self.floor_m:
            return min(planned_m, self.floor_m - margin_m)
        return max(planned_m, self.ceiling_m + margin_m) if height_m > self.ceiling_m else planned_m


class Area:
    """Where a vehicle may fly: inside its fence, if it has one, and outside of the zones at their heights."""

    def __init__(self, safety: SafetySettings) -> None:
        self.fence: Final = Fence(safety.fence_m) if safety.fence_m else None
        self.zones: Final = tuple([NoFlyZone(each) for each in safety.no_fly])

    def clearance_m(self, place_m: Corner, height_m: float) -> float:
        """Return the distance to the nearest boundary, negative beyond it; infinity if there is none."""
        fence_m = inf if self.fence is None else self.fence.clearance_m(place_m)
        closed_m = [each.boundary.clearance_m(place_m) for each in self.zones if each.overlaps(height_m, height_m)]
        return min(fence_m, *closed_m) if closed_m else fence_m

    def hindrance(self, place_m: Corner, height_m: float, margin_m: float) -> str:
        """Return the boundary beyond which a place is, or to which it is nearer than a margin; empty without one."""
        boundaries = [] if self.fence is None else [(self.fence.clearance_m(place_m), "the fence", "outside")]
        boundaries += [
            (zone.boundary.clearance_m(place_m), f"the no-fly zone '{zone.name}'", "inside")
            for zone in self.zones
            if zone.overlaps(height_m, height_m)
        ]
        if not boundaries:
            return ""
        clearance_m, name, beyond = min(boundaries)
        if clearance_m >= margin_m:
            return ""
        if clearance_m < 0.0:
            return f"{-clearance_m:.1f} m {beyond} {name}"
        return f"{clearance_m:.1f} m from {name}, and {margin_m:g} m are needed"

    def entered(self, place_m: Corner, height_m: float) -> NoFlyZone | None:
        """Return the zone that a place at a height is in, None if there is none."""
        for zone in self.zones:
            if zone.overlaps(height_m, height_m) and not zone.boundary.contains(place_m):
                return zone
        return None


def _nearest(place_m: Corner, start: Corner, stop: Corner, sense: float, left_is_inward: float) -> NearestPoint:
    (x, y), (x1, y1), (x2, y2) = place_m, start, stop
    along_x, along_y = x2 - x1, y2 - y1
    length_m = hypot(along_x, along_y)
    share = ((x - x1) * along_x + (y - y1) * along_y) / length_m**2
    end = -1 if share <= 0.0 else 1 if share >= 1.0 else 0
    share = min(max(share, 0.0), 1.0)
    away_x, away_y = x - x1 - share * along_x, y - y1 - share * along_y
    distance_m = hypot(away_x, away_y)
    if distance_m < _ON_EDGE_M:
        return NearestPoint(0.0, (-left_is_inward * along_y / length_m, left_is_inward * along_x / length_m), end)
    return NearestPoint(distance_m, (sense * away_x / distance_m, sense * away_y / distance_m), end)


def _ahead(place_m: Corner, direction: Corner, start: Corner, end: Corner) -> float:
    """Return the distance ahead to the crossing of an edge, infinity if there is none."""
    (x, y), (x_rate, y_rate), (x1, y1), (x2, y2) = place_m, direction, start, end
    across = x_rate * (y2 - y1) - y_rate * (x2 - x1)
    if across == 0.0:
        return inf
    distance_m = ((x1 - x) * (y2 - y1) - (y1 - y) * (x2 - x1)) / across
    share = ((x1 - x) * y_rate - (y1 - y) * x_rate) / across
    return distance_m if distance_m >= 0.0 and 0.0 <= share <= 1.0 else inf


def _meet(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    """Return whether the segments ab and cd have a point in common."""
    sides = _side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b)
    if sides[0] * sides[1] < 0.0 and sides[2] * sides[3] < 0.0:
        return True
    touching = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(side == 0.0 and _between(*each) for side, each in zip(sides, touching, strict=True))


def _side(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _between(a: Corner, b: Corner, c: Corner) -> bool:
    return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])
