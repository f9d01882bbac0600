"""The geofence on an autopilot compared with the mission's fence and no-fly zones: it is what acts without cordon."""

from collections.abc import Iterator, Mapping, Sequence
from math import cos, dist, hypot, sin, tau

from agents.safety.fence import Fence
from estimation.vectors import Pair
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import FenceArea, Finding, Grade, VehicleFacts

CIRCLE_CORNERS = 36
"""Of the polygon that stands for a circle, here and among the facts."""
SAME_M = 2.0
"""Between outlines that are the same: the frames' and files' rounding, and the origins' errors, are smaller."""
MOVED_MAX_M = 50.0
"""Between outlines of which one is the other in another place; beyond, one of them is missing."""
_CHECK = "geofence compared"
_WHY = "when nothing is sent to the autopilot, it keeps to its own areas only"
_STEP = "upload the mission's with a ground station (cordon zones export), or change the mission"
Corners = Sequence[Pair]


def circle_corners(center_m: Pair, radius_m: float) -> tuple[Pair, ...]:
    """Return the polygon that stands for a circle [m]."""
    turns = (tau * k / CIRCLE_CORNERS for k in range(CIRCLE_CORNERS))
    return tuple((center_m[0] + radius_m * cos(turn), center_m[1] + radius_m * sin(turn)) for turn in turns)


def areas_compared(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Compare the areas on an autopilot with the mission's, horizontally; a failed download is another check's."""
    wanted = dict(_wanted(mission, vehicle))
    if not wanted or facts.fence_areas is None or mission.frame.local:
        return
    if not facts.fence_areas:
        named = " or ".join(wanted)
        grade = Grade.WARNING if mission.safety.no_fly else Grade.PASS
        yield Finding.graded(
            grade, facts.vehicle_id, _CHECK, f"the autopilot has no {named}: it holds no areas", _WHY, _STEP
        )
        return
    differences = _differences(wanted, facts.fence_areas)
    same = f"geofence on the autopilot: it holds {' and '.join(wanted)}"
    found = f"geofence on the autopilot: {'; '.join(differences)}" if differences else same
    grade = Grade.WARNING if differences else Grade.PASS
    yield Finding.graded(grade, facts.vehicle_id, _CHECK, found, _WHY, _STEP)


def rally_compared(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Compare the rally points on an autopilot with the vehicle's spots at the mission's."""
    check, why = "rally points compared", "the autopilot's own return leads to the nearest of its rally points"
    step = "upload the vehicle's with a ground station (cordon zones export --vehicle), or clear them"
    if facts.rally_m is None:
        if mission.safety.rally:
            found = "rally points could not be downloaded"
            yield Finding(Grade.WARNING, facts.vehicle_id, check, found, why, "check the link")
        return
    spots_m = mission.rally_m(vehicle)
    if not (spots_m or facts.rally_m):
        return
    others = [place for place in facts.rally_m if all(dist(place, spot) > SAME_M for spot in spots_m)]
    held = sum(any(dist(place, spot) <= SAME_M for place in facts.rally_m) for spot in spots_m)
    found = f"rally points on the autopilot: it holds {held} of the vehicle's {len(spots_m)}"
    if others:
        x, y = others[0]
        found += f", and {len(others)} that are not its own, for example at ({x:.0f}, {y:.0f})"
    yield Finding.graded(Grade.WARNING if others else Grade.PASS, facts.vehicle_id, check, found, why, step)


def _differences(wanted: Mapping[str, FenceArea], areas: Sequence[FenceArea]) -> list[str]:
    """Return in words what is missing, elsewhere or surplus."""
    left, differences = list(areas), list[str]()
    for label, area in wanted.items():
        offs = {k: _off_m(area, other) for k, other in enumerate(left) if other.stay_in is area.stay_in}
        nearest = min(offs, key=lambda k: offs[k], default=None)
        if nearest is None or offs[nearest] > MOVED_MAX_M:
            differences.append(f"{label} is missing")
            continue
        if offs[nearest] > SAME_M:
            differences.append(f"{label} is up to {offs[nearest]:.0f} m off")
        del left[nearest]
    return differences + [_surplus(area) for area in left]


def _wanted(mission: Mission, vehicle: MissionVehicle) -> Iterator[tuple[str, FenceArea]]:
    """Yield what the autopilot should have, by its name: the vehicle's fence and the zones."""
    if fence_m := vehicle.section.limits(mission.safety).fence_m:
        yield "fence", FenceArea(fence_m, stay_in=True)
    for zone in mission.safety.no_fly:
        if zone.center_m is not None and zone.radius_m is not None:
            yield f"zone '{zone.name}'", FenceArea(circle_corners(zone.center_m, zone.radius_m), stay_in=False)
        else:
            yield f"zone '{zone.name}'", FenceArea(zone.polygon_m, stay_in=False)


def _off_m(one: FenceArea, other: FenceArea) -> float:
    """Return the largest distance [m] of a corner of one outline from the other one."""
    return max(_corners_off_m(one.corners_m, other.corners_m), _corners_off_m(other.corners_m, one.corners_m))


def _corners_off_m(corners: Corners, outline: Corners) -> float:
    distinct = [each for k, each in enumerate(outline) if each != outline[k - 1]]
    if len(distinct) < 2:  # an autopilot may hold anything
        return max(hypot(x - outline[0][0], y - outline[0][1]) for x, y in corners)
    fence = Fence(distinct)
    return max(abs(fence.clearance_m(corner)) for corner in corners)


def _surplus(area: FenceArea) -> str:
    x = sum(corner[0] for corner in area.corners_m) / len(area.corners_m)
    y = sum(corner[1] for corner in area.corners_m) / len(area.corners_m)
    kind = "to stay in" if area.stay_in else "to keep out of"
    return f"an area {kind} about ({x:.0f}, {y:.0f}) is not the mission's"
