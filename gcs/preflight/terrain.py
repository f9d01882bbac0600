"""The heights of ring, line and way home above the ground, by a file of elevations."""

from collections.abc import Iterator
from math import dist, inf

from agents.safety.fence import Fence
from estimation.vectors import Pair
from gcs.errors import InputError
from gcs.mission.elevation import Elevation, read_elevation
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import MISSION, Finding, Grade
from gcs.preflight.parameters import route

_CHECK = "height above ground"
_WHY = "heights are above the mission's origin, and the ground rises and falls"
_WAY_POINTS = 20
Flown = tuple[float, Pair]
"""A height above the origin, and a place [m]."""


def terrain(mission: Mission) -> Iterator[Finding]:
    """Check the least height above ground of each vehicle; nothing without `safety.elevation`.

    Differences to the ground at the origin count, so that the file's datum does not.
    """
    if mission.safety.elevation is None:
        return
    try:
        ground = read_elevation(mission.folder / mission.safety.elevation)
    except InputError as error:
        yield Finding(Grade.REFUSE, MISSION, _CHECK, "; ".join(error.faults), _WHY, "give a file that can be read")
        return
    for vehicle in mission.vehicles:
        yield from _of_vehicle(mission, vehicle, ground)


def _of_vehicle(mission: Mission, vehicle: MissionVehicle, ground: Elevation) -> Iterator[Finding]:
    """Yield a warning of places without ground in the file; places with it are judged also then."""
    origin_m = _ground_m(mission, ground, (0.0, 0.0))
    rises = {flown: _ground_m(mission, ground, flown[1]) for flown in _flown(mission, vehicle)}
    unknown = [place for (_, place), rise_m in rises.items() if rise_m is None]
    if origin_m is None or unknown:
        there = mission.mission_frame().geodetic_from_mission((*((0.0, 0.0) if origin_m is None else unknown[0]), 0.0))
        at = f"{there.latitude_deg:.5f}, {there.longitude_deg:.5f}"
        found = f"the ground at {at} is not in {mission.safety.elevation}"
        yield Finding(Grade.WARNING, vehicle.id, _CHECK, found, _WHY, "give a file that covers the mission")
    known = {flown: rise_m - (origin_m or 0.0) for flown, rise_m in rises.items() if rise_m is not None}
    if origin_m is None or not known:
        return
    least_m, where = inf, (0.0, 0.0)
    for (height_m, place), rise_m in known.items():
        if height_m - rise_m < least_m:
            least_m, where = height_m - rise_m, place
    required_m = mission.safety.min_height_above_ground_m
    if unknown and least_m >= required_m:
        return
    low_m, high_m = min(known.values()), max(known.values())
    found = (
        f"at least {least_m:.1f} m above ground, at ({where[0]:.0f}, {where[1]:.0f}), required {required_m:g} m; the "
        f"ground of its ways lies {low_m:+.1f} to {high_m:+.1f} m from the origin's"
    )
    grade = Grade.REFUSE if least_m < required_m else Grade.PASS
    step = "fly higher (altitude_m of the vehicle, encirclement.altitude_m), or elsewhere"
    yield Finding.graded(grade, vehicle.id, _CHECK, found, _WHY, step)


def _flown(mission: Mission, vehicle: MissionVehicle) -> Iterator[Flown]:
    """Yield where the vehicle flies: line and ring, both at the lower of their heights, and the ways home."""
    config = mission.agent_config(vehicle)
    above_m = config.altitude_m - config.lowest_m
    rings = [alone.encirclement for alone in mission.alone]
    lowest_m = min([config.altitude_m, *(ring.lowest_m(config.lowest_m) - ring.rise_m + above_m for ring in rings)])
    places = _inside(mission, vehicle)
    yield from ((lowest_m, place) for place in places)
    for home_m in config.landing_places_m:
        for x, y in places:
            for k in range(1, _WAY_POINTS + 1):
                share = k / _WAY_POINTS
                yield config.return_altitude_m, (x + share * (home_m[0] - x), y + share * (home_m[1] - y))


def _inside(mission: Mission, vehicle: MissionVehicle) -> list[Pair]:
    """Return the places of a vehicle's route; for those beyond its fence the last one before it, where it is held."""
    places, fence_m = route(mission, vehicle), vehicle.section.limits(mission.safety).fence_m
    if not fence_m:
        return places
    fence, start_m = Fence(fence_m), vehicle.section.start_m
    return [
        place if place == start_m or fence.contains(place) else _last_inside(fence, start_m, place) for place in places
    ]


def _last_inside(fence: Fence, start_m: Pair, place: Pair) -> Pair:
    """Return where the straight way from a start inside a fence to a place beyond it meets the fence."""
    away_m = dist(start_m, place)
    direction = ((place[0] - start_m[0]) / away_m, (place[1] - start_m[1]) / away_m)
    reach_m = min(fence.reach_m(start_m, direction), away_m)
    return start_m[0] + reach_m * direction[0], start_m[1] + reach_m * direction[1]


def _ground_m(mission: Mission, ground: Elevation, place: Pair) -> float | None:
    there = mission.mission_frame().geodetic_from_mission((*place, 0.0))
    return ground.ground_m(there.latitude_deg, there.longitude_deg)
