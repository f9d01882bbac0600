"""Preflight checks of each vehicle on the ground, and of the vehicles against each other, without parameters."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from math import atan2, hypot, inf, pi

import numpy as np

from agents.ports import FlightMode
from agents.shell.computer import ComputerClock
from agents.situation.estimator import LINK_DELAY_MAX_S
from estimation.frames import Triple
from gcs.autopilots.registry import AUTOPILOTS, advice
from gcs.link.batteries import BatteryReport
from gcs.link.gimbal import NO_GIMBAL
from gcs.link.status_texts import POSITION_ITEMS, HealthItem, explains, quoted
from gcs.mission.excitation import PLACE_TOLERANCE_M
from gcs.mission.mission import FrameSection, Mission, MissionVehicle
from gcs.preflight.findings import COMPUTER, MISSION, Finding, Grade, VehicleFacts, tolerated

PLACE_LIMIT_M = 10.0
HEIGHT_TOLERANCE_M = 2.0
CLIMB_LEAST_M = 1.0
ORIGIN_TOLERANCE_M = 1000.0
"""Beyond this distance the tangent planes of mission and vehicle differ by centimetres."""
BATTERY_LOW, BATTERY_EMPTY = 0.5, 0.25
SATELLITES_LEAST = 8
RATE_LOW_SHARE, RATE_LEAST_SHARE = 0.8, 0.4
WHOLE_SPEED_TOLERANCE, CLOCK_TOLERANCE = 1e-6, 0.1
COMPUTER_CLOCK_ERROR_MAX_S = 0.5
"""The kernel states an upper bound, which grows by 1 ms every 2 s between two adjustments."""
CLOCK_LAG_TOLERANCE_S = 0.05
CALM_MODES = (FlightMode.HOLD, FlightMode.READY)


def identity(facts: VehicleFacts) -> Iterator[Finding]:
    """Check that cordon can fly this autopilot and airframe."""
    labels = [each.label for each in AUTOPILOTS]
    yield Finding.graded(
        Grade.PASS if facts.autopilot.is_known else Grade.REFUSE,
        facts.vehicle_id,
        "autopilot",
        f"its autopilot is {facts.autopilot.label}",
        f"cordon supports the modes and failsafes of {' and '.join(labels)} only",
        f"fly {' or '.join(labels)}, or take the vehicle out of the mission",
    )
    yield Finding.graded(
        Grade.PASS if facts.multicopter else Grade.REFUSE,
        facts.vehicle_id,
        "airframe",
        "it is a multicopter" if facts.multicopter else "it is not a multicopter",
        "the mission needs a vehicle that can hover",
        f"check its airframe ({advice('airframe')}), or the url",
    )


def at_rest(facts: VehicleFacts) -> Iterator[Finding]:
    """Check that the vehicle is disarmed, on the ground, and in a mode that cordon can start from."""
    status = facts.status
    if status.armed or status.in_air:
        state = "in the air" if status.in_air else "armed"
        why = "cordon starts on the ground, and another pilot or station seems to fly this vehicle"
        step = "land and disarm it" + (
            "; `cordon recover` brings home one that no program flies" if status.in_air else ""
        )
        yield Finding(Grade.REFUSE, facts.vehicle_id, "armed", f"it is {state} already", why, step)
    else:
        yield Finding(Grade.PASS, facts.vehicle_id, "armed", "it is disarmed, on the ground")
    if not facts.mode_received:
        why, step = "the mode shows who controls the vehicle", "wait until its heartbeats arrive, check the link"
        yield Finding(Grade.REFUSE, facts.vehicle_id, "mode", "it sent no flight mode", why, step, temporary=True)
        return
    yield Finding.graded(
        Grade.PASS if status.mode in (*CALM_MODES, FlightMode.LAND) else Grade.WARNING,  # as its last flight left it
        facts.vehicle_id,
        "mode",
        f"its flight mode is {status.mode.value}",
        "cordon changes to hold before it arms, and a mode switch in another position may override that",
        f"set it to hold ({advice('hold')}), and leave the mode switch there",
    )


def health(facts: VehicleFacts) -> Iterator[Finding]:
    """Check every item of the autopilot's health report.

    Consequences of other findings are left out: arming checks fail with any other item, and a vehicle without a
    position in the mission frame has no position items.
    """
    if not facts.health:
        why, step = "an autopilot that does not report is not ready to arm", "wait until it has started, check the link"
        yield Finding(Grade.REFUSE, facts.vehicle_id, "health", "it sent no health report", why, step, temporary=True)
    failing = [item for item, well in facts.health.items() if not well]
    independent = [item for item in failing if not (_lost(facts) and item in POSITION_ITEMS)]
    if failing != [HealthItem.ARMING]:
        independent = [item for item in independent if item is not HealthItem.ARMING]
    for item in independent:
        # Arming checks depend on the mode, and cordon changes to hold before it arms.
        by_mode = item is HealthItem.ARMING and facts.status.mode not in CALM_MODES
        yield Finding(
            Grade.WARNING if by_mode else Grade.REFUSE,
            facts.vehicle_id,
            "health",
            f"{item}: not healthy{f' in {facts.status.mode.value}' if by_mode else ''}{_reported(facts, item)}",
            "the autopilot will refuse to arm, or will have no position in flight",
            HEALTH_STEPS[item],
            temporary=item in (*POSITION_ITEMS, HealthItem.ARMING),
        )
    if facts.is_ready:
        yield Finding(Grade.PASS, facts.vehicle_id, "health", f"all of its {len(facts.health)} health items are good")


def _reported(facts: VehicleFacts, *items: HealthItem) -> str:
    """Return what the autopilot reports about health items, to follow a finding; empty if it reports nothing."""
    texts = [text for text in facts.failed_checks if explains(text, items)]
    return f"; it reports {quoted(texts)}" if texts else ""


def camera(facts: VehicleFacts, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check that the gimbal of a camera that the mission points answers, and that no other station controls it."""
    if vehicle.section.gimbal is None:
        return
    why = "the mission points its camera at the target"
    if not facts.gimbal.answers:
        step = f"switch it on, and check its settings ({advice('gimbal')}), or leave `gimbal` out of the mission"
        yield Finding(Grade.REFUSE, facts.vehicle_id, "gimbal", NO_GIMBAL, why, step)
    elif facts.gimbal.controlled_by:
        found = f"system {facts.gimbal.controlled_by} controls its gimbal"
        step = "release it there, or leave `gimbal` out of the mission"
        yield Finding(Grade.REFUSE, facts.vehicle_id, "gimbal", found, why, step)
    else:
        yield Finding(Grade.PASS, facts.vehicle_id, "gimbal", "its gimbal answers, and no other station controls it")


def _lost(facts: VehicleFacts) -> bool:
    return facts.origin_m is None or facts.position_m is None


HEALTH_STEPS = {
    HealthItem.GYROMETER: "calibrate the gyrometer with a ground station",
    HealthItem.ACCELEROMETER: "calibrate the accelerometer with a ground station",
    HealthItem.MAGNETOMETER: "calibrate the compass with a ground station, away from steel",
    HealthItem.LOCAL_POSITION: "wait for its estimator, and check GPS and compass",
    HealthItem.GLOBAL_POSITION: "wait for GPS with a clear view of the sky",
    HealthItem.HOME_POSITION: "wait for GPS: home is set with the first good position",
    HealthItem.ARMING: "set it to hold, and resolve the failed arming checks that a ground station then shows",
}


def place(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check that the vehicle has a position, and that it is at its start in the mission; in the air it is elsewhere.

    In a local frame the mission defines the vehicle's origin: then that is not checked.
    """
    if facts.origin_m is None or facts.position_m is None:
        yield _without_a_place(facts, mission.frame)
        return
    if not mission.frame.local:
        yield _far(facts, hypot(facts.origin_m[0], facts.origin_m[1]))
    if not facts.status.in_air:
        yield _start(facts, vehicle, _off_start(facts.position_m, vehicle))
        yield _height(facts, vehicle, facts.position_m[2])


def _far(facts: VehicleFacts, away_m: float) -> Finding:
    return Finding.graded(
        Grade.WARNING if away_m > ORIGIN_TOLERANCE_M else Grade.PASS,
        facts.vehicle_id,
        "origin",
        f"its own origin is {away_m:.1f} m from the mission's",
        "far from the mission's origin the vehicles' frames differ because of the Earth's curvature",
        "set [frame] to a point near the vehicles",
    )


def _without_a_place(facts: VehicleFacts, frame: FrameSection) -> Finding:
    found, step = facts.lost or ("it sent no local position", "wait for its estimator, or check it")
    unwell = [item for item in POSITION_ITEMS if not facts.health.get(item, True)]
    if unwell:
        found = f"it has no valid position ({', '.join(unwell)}: not healthy){_reported(facts, *unwell)}"
        source = "GPS first; with a good fix" if not frame.local else "the external position first; with that"
        step = f"check {source}, restart the autopilot, and read its messages"
    if frame.external_positions:
        step = "only `cordon fly` sends external positions, not `cordon check`; see docs/indoor.md"
    why = "without a position in the mission frame it cannot keep its separation"
    return Finding(
        Grade.REFUSE, facts.vehicle_id, "origin", found, why, step, temporary=facts.lost is None or bool(unwell)
    )


def _off_start(position_m: Triple, vehicle: MissionVehicle) -> tuple[float, float]:
    return position_m[0] - vehicle.section.start_m[0], position_m[1] - vehicle.section.start_m[1]


def _start(facts: VehicleFacts, vehicle: MissionVehicle, off_m: tuple[float, float]) -> Finding:
    x, y = vehicle.section.start_m
    return Finding.graded(
        tolerated(hypot(*off_m), PLACE_TOLERANCE_M, PLACE_LIMIT_M),
        facts.vehicle_id,
        "start",
        f"it stands {hypot(*off_m):.1f} m from its start_m ({x:g}, {y:g}): "
        f"{_signed(off_m[0])} m along x, {_signed(off_m[1])} m along y",
        "the vehicles' paths to their slots would cross",
        "move it to its start_m, or correct start_m or [frame] in the mission",
        temporary=not facts.is_ready,
    )


def _signed(value_m: float) -> str:
    """Return metres with a sign, rounded to decimetres; without a sign if that is 0."""
    return f"{value_m:+.1f}" if abs(value_m) >= 0.05 else "0.0"


def _height(facts: VehicleFacts, vehicle: MissionVehicle, ground_m: float) -> Finding:
    climb_m = vehicle.section.altitude_m - ground_m
    grade = Grade.WARNING if abs(ground_m) > HEIGHT_TOLERANCE_M else Grade.PASS
    return Finding.graded(
        Grade.REFUSE if climb_m < CLIMB_LEAST_M else grade,
        facts.vehicle_id,
        "height",
        f"it stands {_signed(ground_m)} m from the height of the mission's origin: to fly at altitude_m = "
        f"{vehicle.section.altitude_m:g} m it climbs {climb_m:.1f} m",
        "altitudes are relative to the mission's origin: a wrong datum causes a wrong height above the ground",
        "set frame.altitude_m to the height of the ground as the autopilots state it; in a local frame, origin_m",
        temporary=not facts.is_ready,
    )


def gps(facts: VehicleFacts) -> Iterator[Finding]:
    """Check the GPS receiver if there is one."""
    if facts.gps is None:
        return
    fix = f"{facts.gps.dimensions}D fix" if facts.gps.dimensions else "no fix"
    blind = facts.gps.dimensions < 3
    satellites = facts.gps.satellites
    poor = blind or (satellites is not None and satellites < SATELLITES_LEAST)
    elsewhere = facts.health.get(HealthItem.GLOBAL_POSITION, False)  # the autopilot may use another receiver
    yield Finding.graded(
        Grade.REFUSE if blind and not elsewhere else Grade.WARNING if poor else Grade.PASS,
        facts.vehicle_id,
        "gps",
        f"GPS: {fix}, {'an unknown number of' if satellites is None else satellites} satellites",
        "without a 3D fix it has no position" if blind else "with few satellites the position may be off by metres",
        "give it a clear view of the sky and wait a few minutes; then check its receiver and cable",
        temporary=True,
    )


def battery(facts: VehicleFacts) -> Iterator[Finding]:
    """Check the battery, or the lowest of those that the vehicle flies with."""
    charge = facts.status.battery
    several = f"its batteries: {', '.join(map(_battery_text, facts.batteries))}" if len(facts.batteries) > 1 else ""
    if charge is None:
        found = several or f"it reports no {'charge of its ' if facts.batteries else ''}battery"
        why = "the battery failsafes need its charge"
        yield Finding(Grade.WARNING, facts.vehicle_id, "battery", found, why, "check its power module")
        return
    yield Finding.graded(
        Grade.REFUSE if charge < BATTERY_EMPTY else Grade.WARNING if charge < BATTERY_LOW else Grade.PASS,
        facts.vehicle_id,
        "battery",
        several or f"its battery is at {charge:.0%}",
        "its battery failsafe would end its mission in flight",
        "charge or change the battery",
    )


def _battery_text(battery: BatteryReport) -> str:
    charge = "not estimated" if battery.charge is None else f"at {battery.charge:.0%}"
    return f"{battery.number} {charge}{'' if battery.flies else ', not for flight'}"


def telemetry(facts: VehicleFacts) -> Iterator[Finding]:
    """Check the rate of motion messages against the requested one, if the vehicle has a position."""
    reached, requested = facts.telemetry_rate_hz, facts.telemetry_rate_asked_hz
    if reached is None:
        return
    poor = Grade.REFUSE if reached < RATE_LEAST_SHARE * requested else Grade.WARNING
    yield Finding.graded(
        Grade.PASS if reached >= RATE_LOW_SHARE * requested else poor,
        facts.vehicle_id,
        "telemetry",
        f"motion messages arrive at {reached:.1f} Hz; {requested:g} Hz were requested",
        "control and separation rely on its latest position",
        f"use a faster link, move nearer, or lower the rates of other streams ({advice('rates')})",
        temporary=True,
    )


def latency(facts: VehicleFacts, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check the link's round-trip time, which the prediction adds to the delay of the profile."""
    round_trip_s, delay_s = facts.link.round_trip_s, vehicle.plant.delay_s
    if round_trip_s is None:
        found = "the round-trip time of its link is unknown: it does not answer TIMESYNC"
        step = "check the link; the firmware has to answer TIMESYNC"
    else:
        found = f"its link's round-trip time is {round_trip_s:.2f} s, beside a delay of {delay_s:.2f} s in its profile"
        step = "use a faster link, or lower the rates on it"
    known = round_trip_s is not None and round_trip_s <= LINK_DELAY_MAX_S
    why = f"the prediction compensates known link delays of up to {LINK_DELAY_MAX_S:g} s"
    yield Finding.graded(Grade.PASS if known else Grade.WARNING, facts.vehicle_id, "latency", found, why, step)


def clock_rate(facts: VehicleFacts) -> Iterator[Finding]:
    """Check that the autopilot's clock runs at wall time, or as a simulator's at a steady rate."""
    ratio = facts.clock_ratio
    whole = ratio is not None and abs(ratio - round(ratio)) < WHOLE_SPEED_TOLERANCE
    runs = "is unknown: it sends no attitude" if ratio is None else f"runs {ratio:.3g} times as fast as the wall's"
    if whole:
        runs = "runs as the wall's does" if ratio == 1.0 else f"{runs}: it is a simulator's"
    yield Finding.graded(
        Grade.PASS if whole else Grade.WARNING,
        facts.vehicle_id,
        "clock",
        f"its clock {runs}",
        "all timeouts are measured with it",
        "check the link; for a simulator, choose a speed that this computer can sustain",
    )


def clock_lag(vehicle_id: int, peer: int, lag_s: float) -> Finding:
    """Judge the lag of a peer's computer clock behind that of this vehicle's computer [wall s]."""
    side = "ahead of" if lag_s > 0.0 else "behind"
    return Finding.graded(
        Grade.WARNING if abs(lag_s) > CLOCK_LAG_TOLERANCE_S else Grade.PASS,
        vehicle_id,
        "clock offset",
        f"its computer's clock is {abs(lag_s):.2f} s {side} that of vehicle {peer}'s",
        "peers' positions are extrapolated from the time in their messages: with a clock offset they are wrong",
        "synchronise both computers' clocks with one time server (chrony, NTP)",
    )


def clock_setting(clock: ComputerClock) -> Finding:
    """Judge the error of this computer's clock."""
    error_s = clock.error_s
    found = "no program synchronises its clock" if error_s is None else f"its clock is accurate to {error_s:.3f} s"
    well = error_s is not None and error_s <= COMPUTER_CLOCK_ERROR_MAX_S
    return Finding.graded(
        Grade.PASS if well else Grade.WARNING,
        COMPUTER,
        "clock",
        found,
        "agents on several computers compute the age of each other's messages from their clocks",
        "install chrony on every computer of the team, with one of them or a time server as the source",
    )


def elsewhere(mission: Mission, team: Sequence[VehicleFacts]) -> tuple[tuple[Finding, ...], Sequence[VehicleFacts]]:
    """Return the finding of a team that stands away from the mission as a whole, and its facts without that shift.

    The shift would otherwise be found once for each vehicle, start, height and fence. The positions of most vehicles
    have to be known.
    """
    placed = {each.vehicle_id: each.position_m for each in team if each.position_m is not None}
    if mission.frame.local or 2 * len(placed) <= len(team):
        return (), team
    offs_m = np.array([(*_off_start(place_m, mission.vehicle(i)), place_m[2]) for i, place_m in placed.items()])
    shift_m = np.median(offs_m, axis=0)
    away_m = hypot(*shift_m[:2])
    if away_m <= PLACE_LIMIT_M or np.any(np.hypot(*(offs_m - shift_m).T[:2]) > PLACE_LIMIT_M):
        return (), team
    x, y, z = shift_m.tolist()
    frame = mission.mission_frame()
    north_m, east_m, _ = frame.ned_from_mission((x, y, 0.0))
    there, [first_m, *_] = frame.geodetic_from_mission((x, y, z)), placed.values()
    away = f"{_distance(away_m)} {_compass_point(north_m, east_m)}"
    why = "starts, target and fence of the mission are where [frame] says"
    if [*placed] == [mission.added]:  # the others fly this mission already
        what = f"vehicle {mission.added} is {away} of its start"
        todo = f"move it to its start, or give as --start where it stands: {first_m[0]:.1f},{first_m[1]:.1f}"
    else:
        what = f"the team is {away} of the mission"
        todo = (
            "move the team, or the mission: "
            f"frame.latitude_deg = {there.latitude_deg:.6f}, longitude_deg = {there.longitude_deg:.6f}, "
            f"altitude_m = {there.altitude_m:.1f}"
        )
    found = Finding(Grade.REFUSE, MISSION, "place", what, why, todo, temporary=not all(each.is_ready for each in team))
    return (found,), [_shifted(each, (-x, -y, -z)) for each in team]


def _shifted(facts: VehicleFacts, by_m: Triple) -> VehicleFacts:
    """Return facts with all places moved."""
    x, y, z = by_m
    areas = facts.fence_areas and tuple(
        replace(area, corners_m=tuple((cx + x, cy + y) for cx, cy in area.corners_m)) for area in facts.fence_areas
    )
    return replace(
        facts,
        origin_m=facts.origin_m and (facts.origin_m[0] + x, facts.origin_m[1] + y, facts.origin_m[2] + z),
        position_m=facts.position_m and (facts.position_m[0] + x, facts.position_m[1] + y, facts.position_m[2] + z),
        fence_areas=areas,
        rally_m=facts.rally_m and tuple((px + x, py + y) for px, py in facts.rally_m),
    )


def _distance(length_m: float) -> str:
    return f"{length_m / 1000.0:.1f} km" if length_m >= 1000.0 else f"{length_m:.0f} m"


_COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


def _compass_point(north_m: float, east_m: float) -> str:
    return _COMPASS[round(atan2(east_m, north_m) / (pi / 4.0)) % len(_COMPASS)]


def together(mission: Mission, team: Sequence[VehicleFacts]) -> Iterator[Finding]:
    """Check the vehicles against each other, as far as their clocks and their positions on the ground are known."""
    standing = [each for each in team if not each.status.in_air]
    placed = {each.vehicle_id: each.position_m for each in standing if each.position_m is not None}
    settled = all(each.is_ready for each in team)
    if len(placed) > 1:
        yield _agreement(mission, placed, settled=settled)
        yield _apart(mission, placed, settled=settled)
        yield _standing_heights(mission, {i: position_m[2] for i, position_m in placed.items()}, settled=settled)
    ratios = [each.clock_ratio for each in team if each.clock_ratio is not None]
    if ratios and max(ratios) > (1.0 + CLOCK_TOLERANCE) * min(ratios):
        speeds = " and ".join(f"{ratio:.3g}" for ratio in sorted(set(ratios)))
        yield Finding(
            Grade.REFUSE,
            MISSION,
            "clocks",
            f"the vehicles' clocks run at different speeds: {speeds} times the wall's",
            "the team needs one mission clock",
            "run all simulators at one speed, and none beside real vehicles",
            temporary=not settled,
        )


def _agreement(mission: Mission, placed: dict[int, Triple], *, settled: bool) -> Finding:
    """Check the relative position with the largest error between two vehicles; a common shift is ignored."""
    off_m = {i: _off_start(position_m, mission.vehicle(i)) for i, position_m in placed.items()}
    worst_m, one, other = max(
        (hypot(off_m[i][0] - off_m[k][0], off_m[i][1] - off_m[k][1]), i, k) for i, k in combinations(off_m, 2)
    )
    return Finding.graded(
        tolerated(worst_m, PLACE_TOLERANCE_M, PLACE_LIMIT_M),
        MISSION,
        "origin agreement",
        f"the position of vehicle {other} relative to vehicle {one} is {worst_m:.1f} m off their start_m, "
        "the most of any two",
        "with inconsistent origins, vehicles are nearer to each other than their positions show",
        "move them to their start_m; if they are there, restart the autopilots and wait for better GPS",
        temporary=not settled,
    )


def _apart(mission: Mission, placed: dict[int, Triple], *, settled: bool) -> Finding:
    nearest_m, one, other = min(
        (hypot(placed[i][0] - placed[k][0], placed[i][1] - placed[k][1]), i, k) for i, k in combinations(placed, 2)
    )
    separation_m = mission.safety.separation_m
    return Finding.graded(
        Grade.REFUSE if nearest_m < separation_m else Grade.PASS,
        MISSION,
        "separation on the ground",
        f"vehicles {one} and {other} are nearest to each other, {nearest_m:.1f} m; "
        f"safety.separation_m is {separation_m:g} m",
        "they would take off closer than the separation",
        "move them farther apart, or check their GPS",
        temporary=not settled,
    )


def _standing_heights(mission: Mission, ground_m: dict[int, float], *, settled: bool) -> Finding:
    """Check the reported heights of the ground under two vehicles against the layers that separate them.

    On level ground they differ by errors: the vehicle that reports the higher ground flies that much lower than it
    reports. Vehicles whose layers are less than `vertical_separation_m` apart evade each other, whatever their heights.
    """
    apart_m, heights_m = mission.safety.vertical_separation_m, {i: _layers_m(mission, i) for i in ground_m}
    judged_m, minus_m, gap_m, level_m, one, other = min(
        (level_m if abs(above_m) >= apart_m else inf, -abs(differs_m), abs(above_m), level_m, i, k)
        for i, k in combinations(ground_m, 2)
        for differs_m in [ground_m[i] - ground_m[k]]
        for above_m in {here - there for here, there in zip(heights_m[i], heights_m[k], strict=True)}
        for level_m in [abs(above_m - differs_m)]
    )
    return Finding.graded(
        Grade.REFUSE if judged_m < apart_m else Grade.PASS,
        MISSION,
        "standing heights",
        f"vehicles {one} and {other} report ground that differs by {-minus_m:.1f} m in height; "
        f"their layers are {gap_m:g} m apart, on level ground {level_m:.1f} m in truth",
        "vehicles do not evade each other if the heights that they report differ by "
        f"safety.vertical_separation_m = {apart_m:g} m or more",
        "on level ground, wait for better GPS or restart the autopilots; on a slope, set layers and altitude_m "
        f"{apart_m - minus_m:.1f} m apart",
        temporary=not settled,
    )


def _layers_m(mission: Mission, vehicle_id: int) -> Triple:
    """Return a vehicle's heights after take-off, in the mission and on the way home."""
    config = mission.agent_config(mission.vehicle(vehicle_id))
    return config.take_off_altitude_m, config.altitude_m, config.return_altitude_m
