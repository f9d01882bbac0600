"""Rings that cut each other: their vehicles would come nearer to each other than the separation."""

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from math import dist, inf
from typing import NamedTuple

from agents.ring.commanded_ring import circles_apart_m
from agents.settings.sections import EncirclementSettings, SafetySettings
from gcs.errors import KeyFault
from gcs.mission.mission import MissionSection, VehicleSection
from sitl.world import Pair, TargetMotion

TRACKING_M = 0.5
"""How far the vehicles of two rings are from them, in sum: each within a quarter of a metre."""
_HALVINGS = 60
"""Halvings of an interval that leave nothing of it but rounding."""


class Tube(NamedTuple):
    """A ring with the planned motion of its target; `is_shared` if it may cut others."""

    number: int
    ring: EncirclementSettings
    target: TargetMotion
    is_shared: bool

    def heights_m(self, vehicles: Sequence[VehicleSection]) -> Pair:
        """Return the lowest and the highest place of its vehicles."""
        flying_m = [vehicle.altitude_m for vehicle in vehicles]
        return self.ring.band_m(min(flying_m), max(flying_m) - min(flying_m))


def cutting_rings(
    tubes: Sequence[Tube],
    vehicles: Sequence[VehicleSection],
    safety: SafetySettings | None,
    mission: MissionSection | None,
) -> Iterator[KeyFault]:
    """Yield a fault for each two rings that come too near to each other, horizontally and in height, unless shared."""
    if safety is None or mission is None:
        return
    needed_m, vertical_m = safety.separation_m + TRACKING_M, safety.vertical_separation_m
    for one, other in combinations(tubes, 2):
        if one.is_shared or other.is_shared:
            continue
        (low_m, high_m), (other_low_m, other_high_m) = one.heights_m(vehicles), other.heights_m(vehicles)
        above_m = max(other_low_m - high_m, low_m - other_high_m, 0.0)
        away_m, at_s = nearest_m(one, other, mission.duration_s)
        if above_m >= vertical_m or away_m >= needed_m:
            continue
        needed = f"{needed_m:g} m (safety.separation_m and {TRACKING_M:g} m)"
        yield KeyFault(
            f"rings[{other.number}]",
            f"{away_m:.2f} m from rings[{one.number}] after {at_s:.0f} s, and {above_m:g} m in height: they need "
            f"{needed}, or {vertical_m:g} m (safety.vertical_separation_m); "
            "change radius_m or altitude_m, or write shared = true: their vehicles then evade each other",
        )


def nearest_m(one: Tube, other: Tube, duration_s: float) -> tuple[float, float]:
    """Return the least horizontal distance of two circles during a mission, and a time at which they have it [m, s].

    Two targets move straight at constant speeds between the corners of their paths. There the distance of the centres
    first falls and then grows, and that of the circles has its least value at one of three times, or is zero between.
    """
    if one.target == other.target:
        return _between_m(one, other, 0.0), 0.0
    paths = [each.target.path_m(duration_s, 2) for each in (one, other)]
    corners_s = sorted({0.0, duration_s, *(at_s for path in paths for at_s, _ in path)})
    least = (inf, 0.0)
    for from_s, to_s in pairwise(corners_s):
        turn_s = _nearest_s(one, other, from_s, to_s)
        times_s = (from_s, *_cut_s(one, other, from_s, turn_s), turn_s, *_cut_s(one, other, turn_s, to_s), to_s)
        least = min(least, *((_between_m(one, other, at_s), at_s) for at_s in times_s))
    return least


def _between_m(one: Tube, other: Tube, at_s: float) -> float:
    """Return the distance of two circles at a time."""
    return circles_apart_m(one.ring.radius_m, other.ring.radius_m, _apart_m(one, other, at_s))


def _apart_m(one: Tube, other: Tube, at_s: float) -> float:
    return dist(one.target.position_m(at_s), other.target.position_m(at_s))


def _nearest_s(one: Tube, other: Tube, from_s: float, to_s: float) -> float:
    """Return when the centres are nearest to each other in an interval of constant velocities."""
    (x, y), (other_x, other_y) = one.target.position_m(from_s), other.target.position_m(from_s)
    (x_rate, y_rate), (other_x_rate, other_y_rate) = (each.target.velocity_at_m_s(from_s) for each in (one, other))
    x_rate, y_rate = other_x_rate - x_rate, other_y_rate - y_rate
    squared = x_rate**2 + y_rate**2
    if squared == 0.0:
        return from_s
    return min(max(from_s - ((other_x - x) * x_rate + (other_y - y) * y_rate) / squared, from_s), to_s)


def _cut_s(one: Tube, other: Tube, from_s: float, to_s: float) -> tuple[float, ...]:
    """Return a time between two at which circles cut that do so at neither, their centres' distance being monotone."""
    radius_m, other_m = one.ring.radius_m, other.ring.radius_m
    ends_m = (_apart_m(one, other, from_s), _apart_m(one, other, to_s))
    if not (min(ends_m) < abs(radius_m - other_m) and max(ends_m) > radius_m + other_m):
        return ()
    outside_s, inside_s = (from_s, to_s) if ends_m[0] > ends_m[1] else (to_s, from_s)
    for _ in range(_HALVINGS):
        middle_s = (outside_s + inside_s) / 2.0
        if _apart_m(one, other, middle_s) > max(radius_m, other_m):
            outside_s = middle_s
        else:
            inside_s = middle_s
    return (inside_s,)
