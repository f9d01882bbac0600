"""Preflight checks of the vehicle's autopilot: parameters, which are never written, geofence areas, kind, profile."""

import re
from collections.abc import Iterator, Sequence
from datetime import date
from itertools import pairwise
from math import cos, pi, sin
from operator import itemgetter

from agents.safety.failsafe import RATIO_MAX, RATIO_RESERVE
from estimation.plant.model import Identification, PlantGrade
from gcs.autopilots.autopilot import CORDON_ID, MOTORS_STOP, FenceLimits, VehicleKind
from gcs.autopilots.registry import UNKNOWN, advice, autopilot_of
from gcs.link.self_reports import EstimatorReport
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import MISSION, FenceArea, Finding, Grade, VehicleFacts, limited
from gcs.preflight.mission import extent_m, highest_m

STEPS = {
    "horizontal position": "leave it at rest with a clear view of the sky; indoors check the positioning system",
    "height": "leave it at rest for a minute, or restart the autopilot; shield the barometer from wind and sun",
    "velocity": "leave it at rest for a minute with a clear view of the sky, or restart the autopilot",
    "compass": "move the vehicle away from steel, cables and cars; if the ratio stays high, calibrate the compass",
}
_DRIFT_WHY = "the estimated position or heading may jump or drift in flight, and the vehicle follows it"
RESTART = "leave the vehicle at rest, restart the autopilot, and read its messages in a ground station"


def estimator(facts: VehicleFacts, mission: Mission) -> Iterator[Finding]:
    """Check the estimator report: the available states, and each test ratio above the limit, or else the highest."""
    report = facts.estimator
    if report is None or not report.ratios:
        message = facts.autopilot.estimator.message
        found = f"estimator report ({message}) not received: sensor consistency is unknown"
        yield _finding(facts, Grade.WARNING, found, "check the estimator with a ground station, and check the link")
        return
    for fault in report.wrong:
        yield _finding(facts, Grade.REFUSE, f"estimator fault: {fault}", RESTART)
    yield from _position(facts, report, local=mission.frame.local)
    if report.glitch:
        yield _finding(facts, Grade.WARNING, "estimator reports a GPS glitch", STEPS["horizontal position"])
    highest = max(report.ratios, key=lambda name: report.ratios[name])
    for name, ratio in report.ratios.items():
        grade = limited(ratio, RATIO_MAX, RATIO_RESERVE)
        if grade is not Grade.PASS:
            state = "rejected by the estimator" if grade is Grade.REFUSE else "innovation test ratio too high"
            found = f"{name}: {state} (test ratio {ratio:.2f}, limit {RATIO_MAX:g})"
            yield _finding(facts, grade, found, STEPS[name])
        elif name == highest:
            found = f"estimator: highest innovation test ratio {ratio:.2f} ({name}), limit {RATIO_MAX:g}"
            yield Finding(Grade.PASS, facts.vehicle_id, "estimator", found)


def _position(facts: VehicleFacts, report: EstimatorReport, *, local: bool) -> Iterator[Finding]:
    """Check that the estimator provides the position that the mission needs; a missing position is another check."""
    lost = facts.origin_m is None or facts.position_m is None
    if lost or report.absolute or (local and report.relative):
        return
    if local:
        step = "check the positioning system (cameras, odometry), then restart the autopilot"
        yield _finding(facts, Grade.REFUSE, "estimator has no horizontal position", step)
    else:
        found = "estimator has no global horizontal position"
        yield _finding(facts, Grade.REFUSE, found, "wait for GPS with a clear view of the sky")


def _finding(facts: VehicleFacts, grade: Grade, found: str, step: str) -> Finding:
    return Finding(grade, facts.vehicle_id, "estimator", found, _DRIFT_WHY, step, temporary=True)


OLD_DAYS = 180
_NUMBERS = re.compile(r"(\d+)\.(\d+)")
_WHY = "the controller relies on the plant: with a wrong one, radius and rate on the ring are off"
_STEP = "identify it again (cordon excite, cordon identify), and set its profile to the new file"


def profile(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle, today: date | None) -> Iterator[Finding]:
    """Check a vehicle's profile against the vehicle's reports.

    An excitation flight does not depend on the profile, and is not checked. Without `today` no profile is old.
    """
    if mission.excites:
        return
    other = list(_other_autopilot(facts, vehicle))
    yield from other
    identified = vehicle.profile.identified
    if identified is None:
        return
    reservations = [*_reservations(identified, facts, today), *_other_kind(identified, vehicle)]
    if not other and identified.autopilot.lower() != facts.autopilot.label.lower():
        reservations.append(
            f"it was identified with {identified.autopilot}, and the vehicle flies {facts.autopilot.label}"
        )
    what = f"its profile '{vehicle.section.profile}', identified on {identified.date}"
    found = (
        f"{what}: {'; '.join(reservations)}"
        if reservations
        else f"{what} with its firmware, is {identified.verdict.value}"
    )
    yield Finding.graded(Grade.WARNING if reservations else Grade.PASS, facts.vehicle_id, "profile", found, _WHY, _STEP)


def _other_autopilot(facts: VehicleFacts, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Refuse a profile of another autopilot; a warning if the mission itself states this autopilot."""
    key = vehicle.profile.autopilot
    if key is None or facts.autopilot in (autopilot_of(key), UNKNOWN):
        return
    chosen = vehicle.section.autopilot
    meant = chosen is not None and autopilot_of(chosen) is facts.autopilot
    yield Finding(
        Grade.WARNING if meant else Grade.REFUSE,
        facts.vehicle_id,
        "profile",
        f"its profile '{vehicle.section.profile}' is for {autopilot_of(key).label} (autopilot = \"{key}\"), and the "
        f"vehicle reports {facts.autopilot.label}",
        "plant, filter and limits of another autopilot do not describe this vehicle",
        f"use a profile for {facts.autopilot.label} in the mission, or check the url",
    )


def _reservations(identified: Identification, facts: VehicleFacts, today: date | None) -> Iterator[str]:
    if identified.verdict is PlantGrade.DO_NOT_FLY:
        reasons = "".join(f", {reason}" for reason in identified.reasons)
        yield f"its own verdict is '{identified.verdict.value}'{reasons}"
    days = 0 if today is None else (today - date.fromisoformat(identified.date)).days
    if days > OLD_DAYS:
        yield f"it is {days} days old"
    same = identified.autopilot.lower() == facts.autopilot.label.lower()
    if same and _release(identified.firmware) != _release(facts.firmware) and identified.firmware and facts.firmware:
        yield f"it was identified with firmware {identified.firmware}, and the vehicle's is {facts.firmware}"


def _other_kind(identified: Identification, vehicle: MissionVehicle) -> Iterator[str]:
    gain = vehicle.plant.feedforward
    if identified.feeds and not gain:
        yield "it was identified with velocities beside setpoints, and with feedforward = 0 none are sent"
    if gain and not identified.feeds:
        yield f"it was identified with setpoints alone, and with feedforward = {gain:g} velocities are sent as well"


def _release(firmware: str) -> tuple[str, ...] | str:
    """Return the part of a firmware that may affect the plant: the first two numbers, or all of any other text."""
    numbers = _NUMBERS.search(firmware)
    return firmware if numbers is None else numbers.groups()


MIXED = "real vehicles would react to simulated neighbours"
LIVE = "a board with a simulated body may drive real motors"
BENCH = "on the bench, with propellers off, add --bench to `cordon check` and `cordon fly`"


def kinds(team: Sequence[VehicleFacts], *, bench: bool) -> Iterator[Finding]:
    """State the kind of each received vehicle; refuse mixed teams, and teams that need `bench`."""
    received = [facts for facts in team if facts.unreachable is None]
    for facts in received:
        yield _stated(facts)
    real = [facts for facts in received if not facts.kind.is_simulated]
    if bench:
        yield from (_not_simulated(facts) for facts in real)
    elif real and len(real) < len(received):
        yield _mixed(received)
    if not bench:
        yield from (_board(facts) for facts in received if facts.kind.is_board)


def bench_line(team: Sequence[VehicleFacts]) -> str:
    """Return the vehicles of each kind as one line."""
    ids = {kind: [str(facts.vehicle_id) for facts in team if facts.kind is kind] for kind in VehicleKind}
    parts = (f"{kind.value}: {', '.join(each)}" for kind, each in ids.items() if each)
    return "; ".join(parts)


def _stated(facts: VehicleFacts) -> Finding:
    known = facts.kind is not VehicleKind.UNKNOWN
    return Finding.graded(
        Grade.PASS if known else Grade.WARNING,
        facts.vehicle_id,
        "kind",
        f"what it is: {facts.kind.value}",
        "a vehicle of unknown kind is treated as a real one",
        f"check the link: its version and parameters were not received, or do not agree ({advice('simulation')})",
    )


def _mixed(team: Sequence[VehicleFacts]) -> Finding:
    step = "fly the real vehicles apart from simulated ones, with a team name and a mission of their own"
    found = f"real and simulated vehicles: {bench_line(team)}"
    unknown = any(facts.kind is VehicleKind.UNKNOWN for facts in team)
    return Finding(Grade.REFUSE, MISSION, "kinds", found, MIXED, step, temporary=unknown)


def _not_simulated(facts: VehicleFacts) -> Finding:
    found = f"it is not simulated: {facts.kind.value}"
    step = f"take it out of the mission, or set it up with a simulated body ({advice('bench')})"
    return Finding(Grade.REFUSE, facts.vehicle_id, "bench", found, "--bench is for simulated vehicles only", step)


def _board(facts: VehicleFacts) -> Finding:
    return Finding(Grade.REFUSE, facts.vehicle_id, "bench", f"it is a {facts.kind.value}", LIVE, BENCH)


WITHOUT_SETPOINTS = "it determines the reaction to a loss of cordon or of the link"


def failsafes(facts: VehicleFacts) -> Iterator[Finding]:
    """Check the autopilot's reaction to lost setpoints and links."""
    for name, judge in facts.autopilot.judges.items():
        value = facts.parameter(name)
        if value is None:
            yield _unread(facts, name, WITHOUT_SETPOINTS)
        else:
            grade, meaning, why, step = judge(value)
            yield Finding(Grade(grade), facts.vehicle_id, name, f"{name} = {value:g}: {meaning}", why, step)


def station(facts: VehicleFacts) -> Iterator[Finding]:
    """Check that a ground station failsafe that monitors one system id monitors cordon's."""
    ids = facts.autopilot.station_ids
    if not ids or facts.parameter(facts.autopilot.station_failsafe) == 0.0:
        return
    value = facts.parameter(*ids)
    if value is None:
        yield _unread(facts, " or ".join(ids), WITHOUT_SETPOINTS)
        return
    name = next(name for name in ids if facts.parameter(name) is not None)
    yield Finding.graded(
        Grade.PASS if int(value) == CORDON_ID else Grade.WARNING,
        facts.vehicle_id,
        "ground station id",
        f"{name} = {value:g}: the ground station failsafe monitors system {value:g}; cordon is system {CORDON_ID}",
        "a failsafe that monitors another ground station does not act on a loss of cordon or its link",
        f"set {name} = {CORDON_ID}",
    )


def fence(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check that the autopilot's geofence contains the mission and does not terminate the flight."""
    names = facts.autopilot.fence_parameters
    missing = [name for name in names if facts.parameter(name) is None]
    yield from (
        _unread(facts, name, "a fence that is smaller than the mission ends the mission in flight") for name in missing
    )
    if missing:
        return
    across, up, _, terminates = fence_limits(facts)
    if across is None and up is None:
        yield Finding(Grade.PASS, facts.vehicle_id, "fence", "the autopilot's fence is off or takes no action")
        return
    if terminates:
        found, step = terminates
        yield Finding(Grade.REFUSE, facts.vehicle_id, "fence", found, MOTORS_STOP, step)
    reaches = ((across, extent_m(mission, vehicle), "from home"), (up, highest_m(mission, vehicle), "above home"))
    for limit, needed_m, where in reaches:
        if limit is not None:
            yield _room(facts, *limit, needed_m, where)


def fence_limits(facts: VehicleFacts) -> FenceLimits:
    """Return the autopilot's fence in force; a parameter that could not be read counts as 0."""
    return facts.autopilot.fence({name: facts.parameter(name) or 0.0 for name in facts.autopilot.fence_parameters})


def _room(facts: VehicleFacts, name: str, limit_m: float, needed_m: float, where: str) -> Finding:
    return Finding.graded(
        Grade.WARNING if needed_m > limit_m else Grade.PASS,
        facts.vehicle_id,
        "fence",
        f"the mission reaches {needed_m:.0f} m {where}; the fence {name} is at {limit_m:g} m",
        "the autopilot ends the mission at its fence, regardless of the other vehicles",
        f"raise {name} above {needed_m:.0f} m, or shorten the mission",
    )


def _unread(facts: VehicleFacts, name: str, why: str) -> Finding:
    step = f"check {name} with a ground station, and check the link"
    return Finding(Grade.WARNING, facts.vehicle_id, name, f"{name} could not be read", why, step)


Place = tuple[float, float]

_FENCE_WHY = "the autopilot ends the mission at its fence, regardless of the other vehicles"
RING_POINTS, PATH_POINTS = 24, 20


def fence_areas(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check the mission's positions against the areas of an enabled fence."""
    if facts.fence_areas is None:
        found = "geofence download failed: areas that end the mission are unknown"
        step = "check the fence with a ground station, and check the link"
        yield Finding(Grade.WARNING, facts.vehicle_id, "fence areas", found, _FENCE_WHY, step)
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
        _FENCE_WHY,
        "change the fence with a ground station, or move or shorten the mission",
    )


def route(mission: Mission, vehicle: MissionVehicle) -> list[Place]:
    """Return positions [m] of a vehicle in the mission: its line and the rings, then its rally points; or its box."""
    start_x, start_y = vehicle.section.start_m
    if mission.excites:
        return [(start_x, start_y), *mission.safety.fence_m]
    duration_s = mission.mission.duration_s
    times_s = [duration_s * k / PATH_POINTS for k in range(PATH_POINTS + 1)]
    timed = [(at_s, (start_x + mission.formation.speed_m_s * at_s, start_y)) for at_s in times_s]
    for alone in mission.alone:
        radius_m = alone.encirclement.radius_m
        for at_s, (x, y) in alone.target.motion.path_m(duration_s, PATH_POINTS + 1):
            angles = (2.0 * pi * k / RING_POINTS for k in range(RING_POINTS))
            timed += [(at_s, (x + radius_m * cos(angle), y + radius_m * sin(angle))) for angle in angles]
    return [(start_x, start_y), *(place for _, place in sorted(timed, key=itemgetter(0))), *mission.rally_m(vehicle)]


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
