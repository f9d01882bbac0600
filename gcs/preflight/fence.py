"""Preflight check of the mission against the inclusion and exclusion areas of the autopilot's geofence."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import cos, pi, sin
from operator import itemgetter

from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import FenceArea, Finding, Grade, VehicleFacts
from gcs.preflight.parameters import fence_limits

Place = tuple[float, float]

WHY = "the autopilot ends the mission at its fence, regardless of the other vehicles"
RING_POINTS, PATH_POINTS = 24, 20


def fence_areas(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check the mission's positions against the areas of an enabled fence."""
    if facts.fence_areas is None:
        found = "geofence download failed: areas that end the mission are unknown"
        step = "check the fence with a ground station, and check the link"
        yield Finding(Grade.WARNING, facts.vehicle_id, "fence areas", found, WHY, step)
        return
    if not facts.fence_areas or not fence_limits(facts).areas:
        return
    places = route(mission, vehicle)
    outside = [place for place in places if not _allowed(place, facts.fence_areas)]
    x, y = (outside or places)[0]
    areas = f"geofence with {len(facts.fence_areas)} areas"
    yield Finding.graded(
        Grade.WARNING if outside else Grade.PASS,
        facts.vehicle_id,
        "fence areas",
        f"{areas}: the mission leaves them, for example at ({x:.0f}, {y:.0f})"
        if outside
        else f"{areas}: the mission stays inside",
        WHY,
        "change the fence with a ground station, or move or shorten the mission",
    )


def route(mission: Mission, vehicle: MissionVehicle) -> list[Place]:
    """Return positions [m] of a vehicle in the mission in order of time: its line and the ring, or its box."""
    start_x, start_y = vehicle.section.start_m
    if mission.excites:
        return [(start_x, start_y), *mission.safety.fence_m]
    radius_m, duration_s = mission.encirclement.radius_m, mission.mission.duration_s
    times_s = [duration_s * k / PATH_POINTS for k in range(PATH_POINTS + 1)]
    timed = [(at_s, (start_x + mission.formation.speed_m_s * at_s, start_y)) for at_s in times_s]
    for at_s, (x, y) in mission.target.motion.path_m(duration_s, PATH_POINTS + 1):
        angles = (2.0 * pi * k / RING_POINTS for k in range(RING_POINTS))
        timed += [(at_s, (x + radius_m * cos(angle), y + radius_m * sin(angle))) for angle in angles]
    return [(start_x, start_y), *(place for _, place in sorted(timed, key=itemgetter(0)))]


def within(place: Place, corners: Sequence[Place]) -> bool:
    """Return whether a position lies in a polygon: a ray from it crosses the border an odd number of times."""
    x, y = place
    inside = False
    for (x1, y1), (x2, y2) in pairwise((*corners, corners[0])):
        if (y1 > y) != (y2 > y) and x < x1 + (y - y1) * (x2 - x1) / (y2 - y1):
            inside = not inside
    return inside


def _allowed(place: Place, areas: Sequence[FenceArea]) -> bool:
    stay_in = [within(place, area.corners_m) for area in areas if area.stay_in]
    keep_out = (within(place, area.corners_m) for area in areas if not area.stay_in)
    return (not stay_in or any(stay_in)) and not any(keep_out)
