"""Shortest ways around no-fly zones and inside the fence: a visibility graph about zones that are wider by some room.

A way is found when its goal changes. In a tick the vehicle only flies to the next place of its way.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import cos, dist, inf, pi
from typing import Any, Final

import numpy as np

from agents.safety.fence import NoFlyZone
from agents.settings.config import AgentConfig
from agents.settings.sections import ChoreographySettings, EncirclementSettings, NoFlySection, SafetySettings
from estimation.state import Vector
from estimation.vectors import Pair

ZONE_MARGIN_M: Final = 1.0
"""The room to a zone, across and in height, that plans keep at rest."""
_PASSED_SHARE: Final = 0.65
"""By speed over the barriers' rate: the room beyond that in which a vehicle passes a corner, and the guard need not
slow it down.
"""
_ARC_PARTS: Final = 4
"""The number of edges that round a quarter turn of a corner."""
_WORLD_M: Final = 1e6
_TOUCHES_M: Final = 1e-6
_GRID_M: Final = 1e-3
"""Corners of the graph are rounded to this, so that they do not depend on the last digits of a library."""
WAY_SHARE: Final = 0.7
"""The share of its speed limit at which a vehicle flies around zones to a ring."""
REACHED_M: Final = 1.0
DETOUR: Final = 2.0
"""A narrow way, in which the guard slows the vehicle down, is flown if any other is so many times as long."""
_GOAL_MOVED_M: Final = 0.5


def heights_m(
    altitudes_m: Sequence[float], count: int, ring: EncirclementSettings | None, layers: ChoreographySettings | None
) -> Pair:
    """Return the lowest and the highest height between take-off and landing of `count` vehicles.

    `altitudes_m` are their flying heights, or the lowest and the highest of them.
    """
    low_m, high_m = min(altitudes_m), max(altitudes_m)
    if layers is not None:
        high_m += count * layers.layer_m
    if ring is not None and ring.altitude != "target":
        ring_low_m, ring_high_m = ring.band_m(min(altitudes_m), max(altitudes_m) - min(altitudes_m))
        low_m, high_m = min(low_m, ring_low_m), max(high_m, ring_high_m)
    return low_m, high_m


def passing_room_m(speed_m_s: float, safety: SafetySettings) -> float:
    """Return the room to a zone with which a vehicle passes it at a speed, and the guard hardly changes its aims."""
    return ZONE_MARGIN_M + _PASSED_SHARE * speed_m_s / safety.barrier_rate_per_s


def flown_zones(config: AgentConfig, *held_m: float) -> tuple[NoFlySection, ...]:
    """Return the zones that plans keep out of: those between the lowest and the highest height of the team.

    Vehicles change their heights anywhere between them, so one above another's height is in the way as well. The ring's
    are those of the configuration, as commanded; `held_m` are other heights that count.
    """
    if not config.safety.no_fly:
        return ()
    highest_m = config.altitude_m if config.layers_from_m is None else config.layers_from_m
    altitudes_m = (config.lowest_m, max(highest_m, config.lowest_m))
    low_m, high_m = heights_m(altitudes_m, len(config.slots), config.encirclement, config.choreography)
    return zones_between(config.safety, min(low_m, *held_m, high_m), max(low_m, *held_m, high_m))


def zones_between(safety: SafetySettings, low_m: float, high_m: float) -> tuple[NoFlySection, ...]:
    """Return the zones that are closed at a height between two, or too near to one of them."""
    return tuple([
        each for each in safety.no_fly if NoFlyZone(each).overlaps(low_m - ZONE_MARGIN_M, high_m + ZONE_MARGIN_M)
    ])  # fmt: skip


def way_of(config: AgentConfig, speed_m_s: float, *held_m: float, before: "Way | None" = None) -> "Way | None":
    """Return the way of a vehicle at a speed; None if no zone is at its heights, so that all ways are straight.

    `before` is its way so far, which stays if the same zones are in the way. `held_m` as in `flown_zones`.
    """
    zones = flown_zones(config, *held_m)
    if not zones:
        return None
    routes = routes_between(zones, config.safety.fence_m, passing_room_m(speed_m_s, config.safety))
    return before if before is not None and before.routes is routes else Way(routes)


@lru_cache(maxsize=64)
def routes_between(zones: tuple[NoFlySection, ...], fence_m: tuple[Pair, ...], room_m: float) -> "Routes":
    """Return the ways around zones and inside a fence (empty: none), with so much room."""
    return Routes(zones, fence_m, room_m)


def shapes_of(zones: Sequence[NoFlySection], room_m: float) -> list[Vector]:
    """Return the corners (n, 2) of zones that are wider by some room; their edges keep it as well."""
    import shapely  # noqa: PLC0415

    shapes = list[Vector]()
    for each in zones:
        if each.center_m is None or each.radius_m is None:
            shapes += wider(each.polygon_m, room_m)
        else:
            wide_m = (each.radius_m + room_m) / cos(pi / (8.0 * _ARC_PARTS))
            shape = shapely.Point(each.center_m).buffer(wide_m, quad_segs=2 * _ARC_PARTS)
            shapes.append(np.asarray(shapely.get_coordinates(shape)[:-1], dtype=np.float64))
    return shapes


def wider(corners_m: Sequence[Pair], room_m: float) -> list[Vector]:
    """Return the corners (n, 2) of a polygon that is wider by some room; a narrower one may have several parts."""
    import shapely  # noqa: PLC0415

    wide_m = room_m / cos(pi / (4.0 * _ARC_PARTS)) if room_m > 0.0 else room_m
    parts = shapely.get_parts(shapely.Polygon(corners_m).buffer(wide_m, quad_segs=_ARC_PARTS)).tolist()
    corners = [shapely.get_coordinates(part.exterior)[:-1] for part in parts if not part.is_empty]
    return [np.asarray(each, dtype=np.float64) for each in corners]


class Routes:
    """The shortest ways outside of zones and inside a fence (empty: none), with room to all of them."""

    def __init__(self, zones: Sequence[NoFlySection], fence_m: Sequence[Pair], room_m: float) -> None:
        import shapely  # noqa: PLC0415 - slow to import, and only missions with zones need it

        self._shapely: Any = shapely
        self._zones, self._fence_m = tuple(zones), tuple(fence_m)
        shapes = [shapely.Polygon(each) for each in shapes_of(zones, room_m)]
        world = (
            shapely.Polygon(fence_m).buffer(-room_m)
            if fence_m
            else shapely.box(-_WORLD_M, -_WORLD_M, _WORLD_M, _WORLD_M)
        )
        rounded = shapely.set_precision(world.difference(shapely.union_all(shapes)), _GRID_M)
        self._free: Any = shapely.set_precision(rounded, 0.0)
        self._open: Any = self._free.buffer(_TOUCHES_M)
        shapely.prepare(self._open)
        corners = [each for each in shapely.get_coordinates(self._free).tolist() if max(map(abs, each)) < _WORLD_M]
        self._corners: Vector = np.array(sorted({(x, y) for x, y in corners}), dtype=np.float64).reshape(-1, 2)
        count = len(self._corners)
        first, second = np.triu_indices(count, 1)
        sees = self._sees(self._corners[first], self._corners[second])
        self._lengths: Vector = np.full((count, count), inf)
        away = self._corners[first] - self._corners[second]
        self._lengths[first, second] = self._lengths[second, first] = np.where(sees, np.hypot(*away.T), inf)

    @property
    def narrow(self) -> "Routes":
        """The ways with the least room, which may lead where there is none with more: there the guard slows down."""
        return routes_between(self._zones, self._fence_m, ZONE_MARGIN_M)

    @property
    def bare(self) -> "Routes":
        """The ways without room, which only zones and fence themselves block."""
        return routes_between(self._zones, self._fence_m, 0.0)

    def is_free(self, place_m: Pair) -> bool:
        """Return whether a place has the room."""
        return bool(self._shapely.covers(self._open, self._shapely.Point(place_m)))

    def is_straight(self, from_m: Pair, to_m: Pair) -> bool:
        """Return whether the straight way between two places has the room."""
        return bool(self._shapely.covers(self._open, self._shapely.LineString((from_m, to_m))))

    def free_m(self, place_m: Pair) -> Pair:
        """Return the place nearest to another that has the room."""
        if self.is_free(place_m):
            return place_m
        shortest = self._shapely.shortest_line(self._free, self._shapely.Point(place_m))
        x, y = self._shapely.get_coordinates(shortest)[0].tolist()
        return x, y

    def way_m(self, from_m: Pair, goals_m: Sequence[Pair]) -> tuple[Pair, ...]:
        """Return the places of the shortest way to one of the goals, which is the last; empty if there is no way.

        Where the vehicle or a goal has not the room, the way leads over the nearest place that has it.
        """
        if self.is_straight(from_m, goals_m[0]) and len(goals_m) == 1:
            return (goals_m[0],)
        begin_m, ends_m = self.free_m(from_m), [self.free_m(each) for each in goals_m]
        count, corners = len(self._corners), self._corners
        to_begin, to_ends = self._lengths_to(begin_m), np.array([self._lengths_to(each) for each in ends_m])
        # Dijkstra's algorithm from the begin, over the corners.
        lengths, before = to_begin.copy(), np.full(count, -1)
        left = np.ones(count, dtype=np.bool_)
        for _ in range(count):
            nearest = int(np.argmin(np.where(left, lengths, inf)))
            if not left[nearest] or lengths[nearest] == inf:
                break
            left[nearest] = False
            through = lengths[nearest] + self._lengths[nearest]
            shorter = through < lengths
            lengths[shorter] = through[shorter]
            before[shorter] = nearest
        straight = self._sees(np.broadcast_to(np.array(begin_m), (len(ends_m), 2)), np.array(ends_m))
        best_m, best, corner = inf, -1, -1
        for number, end_m in enumerate(ends_m):
            if straight[number] and dist(begin_m, end_m) < best_m:
                best_m, best, corner = dist(begin_m, end_m), number, -1
            if count:
                last = int(np.argmin(lengths + to_ends[number]))
                if lengths[last] + to_ends[number, last] < best_m:
                    best_m, best, corner = float(lengths[last] + to_ends[number, last]), number, last
        if best < 0:
            return ()
        way: list[Pair] = []
        while corner >= 0:
            way.append((corners.item(corner, 0), corners.item(corner, 1)))
            corner = int(before[corner])
        places = [begin_m, *way[::-1], ends_m[best], goals_m[best]]
        return tuple([each for each, last_m in zip(places, (from_m, *places), strict=False) if each != last_m])

    def _lengths_to(self, place_m: Pair) -> Vector:
        """Return the lengths (corners,) of the straight ways to a place, infinity where there is none."""
        place = np.broadcast_to(np.array(place_m, dtype=np.float64), self._corners.shape)
        away = self._corners - place
        return np.where(self._sees(place, self._corners), np.hypot(away[:, 0], away[:, 1]), inf)

    def _sees(self, first: Vector, second: Vector) -> Any:
        """Return whether the straight ways between places (n, 2) have the room."""
        if not len(first):
            return np.zeros(0, dtype=np.bool_)
        return self._shapely.covers(self._open, self._shapely.linestrings(np.stack((first, second), axis=1)))


class Way:
    """The way that one vehicle flies; it is found anew when its goal moves, or when it has been led off it."""

    def __init__(self, routes: Routes) -> None:
        self.routes: Final = routes
        self._goals_m: tuple[Pair, ...] = ()
        self._places_m: list[Pair] = []
        self._found_in = routes
        self.length_m = 0.0

    def reset(self) -> None:
        """Forget the way, when the vehicle comes from another tactic."""
        self._goals_m = ()

    def places_m(self, here_m: Pair, *goals_m: Pair) -> tuple[Pair, ...]:
        """Return the places of the whole way from here to the nearest of the goals, the last; empty without a way."""
        self._find(here_m, goals_m)
        return tuple(self._places_m)

    def next_m(self, here_m: Pair, *goals_m: Pair) -> Pair:
        """Return the next place of the way to the nearest of the goals, the goal in the end.

        Without a way it is the vehicle's own place: it stays.
        """
        if not self._goals_m or any(dist(*both) > _GOAL_MOVED_M for both in zip(goals_m, self._goals_m, strict=True)):
            self._find(here_m, goals_m)
        places = self._places_m
        while len(places) > 1 and dist(here_m, places[0]) < REACHED_M:
            places.pop(0)
        found_in = self._found_in
        if len(places) > 1 and found_in.is_free(here_m) and not found_in.is_straight(here_m, places[0]):
            self._find(here_m, goals_m)
        return self._places_m[0] if self._places_m else here_m

    def _find(self, here_m: Pair, goals_m: tuple[Pair, ...]) -> None:
        self._goals_m, self._found_in = goals_m, self.routes
        self._places_m = list(self.routes.way_m(here_m, goals_m))
        self.length_m = _length_m(here_m, self._places_m)
        if not self._places_m or self.length_m > DETOUR * dist(here_m, self._places_m[-1]):
            narrow = list(self.routes.narrow.way_m(here_m, goals_m))
            length_m = _length_m(here_m, narrow)
            if narrow and (not self._places_m or DETOUR * length_m < self.length_m):
                self._found_in, self._places_m, self.length_m = self.routes.narrow, narrow, length_m


def _length_m(here_m: Pair, places_m: Sequence[Pair]) -> float:
    return sum(map(dist, [here_m, *places_m], places_m))
