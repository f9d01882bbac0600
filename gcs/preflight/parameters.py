"""Preflight checks of the autopilot's parameters: failsafes, geofence, limits. Parameters are read, never written."""

from collections.abc import Callable, Iterator, Mapping

from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import ARDUPILOT_SIMULATES, PX4_SIMULATES, AutopilotKind, Finding, Grade, VehicleFacts
from gcs.preflight.mission import ACCELERATION_LIMITS, SPEED_LIMITS, extent_m, highest_m

Judgement = tuple[Grade, str, str, str]
"""Grade, meaning of the value, reason, and next step."""
Judge = Callable[[float], Judgement]

OFFBOARD_LOSS_LONGEST_S, OFFBOARD_LOSS_LIMIT_S, OFFBOARD_LOSS_SHORTEST_S = 2.0, 5.0, 0.3
GUIDED_LONGEST_S = 5.0
WITHOUT_SETPOINTS = "it determines the reaction to a loss of cordon or of the link"
CROSSING = "the vehicle climbs and flies home across the other vehicles' paths, without separation by the guard"
MOTORS_STOP = "the motors stop, and the vehicle falls"


def _offboard_loss_action(value: float) -> Judgement:
    land = "set COM_OBL_RC_ACT = 4 (land) or 5 (hold)"
    well = {4: "land", 5: "hold"}
    if (action := well.get(int(value))) is not None:
        return Grade.PASS, f"{action} when setpoints stop", "", ""
    by_hand = {0: "position", 1: "altitude", 2: "manual"}
    if (mode := by_hand.get(int(value))) is not None:
        why = "without a remote control NAV_RCL_ACT decides: by default the vehicle flies home across the others' paths"
        return Grade.WARNING, f"{mode} mode when setpoints stop", why, land
    if int(value) == 3:
        return Grade.WARNING, "return when setpoints stop", CROSSING, land
    return Grade.REFUSE, "motors off or unknown action when setpoints stop", MOTORS_STOP, land


def _offboard_loss_time(value: float) -> Judgement:
    meaning = f"{value:g} s without setpoints until the failsafe acts"
    reset = "set COM_OF_LOSS_T = 1"
    if value < OFFBOARD_LOSS_SHORTEST_S:
        return Grade.WARNING, meaning, "a short interruption of the link ends the flight", reset
    why = "until then the vehicle flies on towards its last setpoint"
    if value > OFFBOARD_LOSS_LONGEST_S:
        return Grade.REFUSE if value > OFFBOARD_LOSS_LIMIT_S else Grade.WARNING, meaning, why, reset
    return Grade.PASS, meaning, "", ""


def _link_loss_action(value: float) -> Judgement:
    well = {0: "no action", 1: "hold", 3: "land"}
    if (action := well.get(int(value))) is not None:
        return Grade.PASS, f"{action} when the ground station's link is lost", "", ""
    land = "set NAV_DLL_ACT = 3 (land) or 1 (hold)"
    if int(value) == 2:
        return Grade.WARNING, "return when the ground station's link is lost", CROSSING, land
    return Grade.REFUSE, "motors off or unknown action when the ground station's link is lost", MOTORS_STOP, land


def _throttle_failsafe(value: float) -> Judgement:
    if int(value) == 0:
        why = "without it the vehicle does not react when a failed remote control keeps the pilot from taking over"
        step = "set FS_THR_ENABLE = 3 (land) if a remote control is used; without one, leave it and check the link"
        return Grade.WARNING, "no failsafe when the remote control is lost", why, step
    return Grade.PASS, f"failsafe {value:g} when the remote control is lost", "", ""


def _station_failsafe(value: float) -> Judgement:
    land = f"set FS_GCS_ENABLE = 5 (land), and SYSID_MYGCS (MAV_GCS_SYSID since 4.7) to cordon's id, {CORDON_ID}"
    if int(value) == 0:
        why = "after a loss of cordon or of the link the vehicle hovers at its last setpoint until the battery is empty"
        return Grade.WARNING, "no failsafe when the ground station's link is lost", why, land
    if int(value) in (1, 3):
        return Grade.WARNING, "return when the ground station's link is lost", CROSSING, land
    return Grade.PASS, f"failsafe {value:g} when the ground station's link is lost", "", ""


def _guided_timeout(value: float) -> Judgement:
    meaning = f"{value:g} s until guided velocities and attitudes expire"
    if value > GUIDED_LONGEST_S:
        return Grade.WARNING, meaning, "until then the vehicle flies on without commands", "set GUID_TIMEOUT = 3"
    return Grade.PASS, meaning, "", ""


JUDGES: Mapping[AutopilotKind, Mapping[str, Judge]] = {
    AutopilotKind.PX4: {
        "COM_OBL_RC_ACT": _offboard_loss_action,
        "COM_OF_LOSS_T": _offboard_loss_time,
        "NAV_DLL_ACT": _link_loss_action,
    },
    AutopilotKind.ARDUPILOT: {
        "FS_THR_ENABLE": _throttle_failsafe,
        "FS_GCS_ENABLE": _station_failsafe,
        "GUID_TIMEOUT": _guided_timeout,
    },
}
FENCES: Mapping[AutopilotKind, tuple[str, ...]] = {
    AutopilotKind.PX4: ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"),
    AutopilotKind.ARDUPILOT: ("FENCE_ENABLE", "FENCE_ACTION", "FENCE_TYPE", "FENCE_RADIUS", "FENCE_ALT_MAX"),
}
PX4_FENCE_WARNS, PX4_FENCE_TERMINATES = 1, 4
ARDUPILOT_FENCE_ALTITUDE, ARDUPILOT_FENCE_CIRCLE, ARDUPILOT_FENCE_AREAS = 1, 2, 4
STATION_ID = ("MAV_GCS_SYSID", "SYSID_MYGCS")
CORDON_ID = 245
"""MAVSDK's system id as a ground station."""


def parameters_wanted(autopilot: AutopilotKind) -> tuple[tuple[str, ...], ...]:
    """Return the parameters to read; an entry of several names is complete once one of them is received."""
    if autopilot not in JUDGES:
        return ()
    limits = (tuple(name for name, _ in table[autopilot]) for table in (SPEED_LIMITS, ACCELERATION_LIMITS))
    station = (STATION_ID,) if autopilot is AutopilotKind.ARDUPILOT else ()
    simulates = ((PX4_SIMULATES,) if autopilot is AutopilotKind.PX4 else (ARDUPILOT_SIMULATES,),)
    return (
        *simulates,
        *((name,) for name in JUDGES[autopilot]),
        *((name,) for name in FENCES[autopilot]),
        *limits,
        *station,
    )


def failsafes(facts: VehicleFacts) -> Iterator[Finding]:
    """Check the autopilot's reaction to lost setpoints and links."""
    for name, judge in JUDGES[facts.autopilot].items():
        value = facts.parameter(name)
        if value is None:
            yield _unread(facts, name, WITHOUT_SETPOINTS)
        else:
            grade, meaning, why, step = judge(value)
            yield Finding(grade, facts.subject, name, f"{name} = {value:g}: {meaning}", why, step)


def station(facts: VehicleFacts) -> Iterator[Finding]:
    """Check that ArduPilot's ground station failsafe monitors cordon's system id."""
    if facts.autopilot is not AutopilotKind.ARDUPILOT or facts.parameter("FS_GCS_ENABLE") == 0.0:
        return
    value = facts.parameter(*STATION_ID)
    if value is None:
        yield _unread(facts, " or ".join(STATION_ID), WITHOUT_SETPOINTS)
        return
    name = next(name for name in STATION_ID if facts.parameter(name) is not None)
    yield Finding.graded(
        Grade.PASS if int(value) == CORDON_ID else Grade.WARNING,
        facts.subject,
        "ground station id",
        f"{name} = {value:g}: the ground station failsafe monitors system {value:g}; cordon is system {CORDON_ID}",
        "a failsafe that monitors another ground station does not act on a loss of cordon or its link",
        f"set {name} = {CORDON_ID}",
    )


def fence(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check that the autopilot's geofence contains the mission and does not terminate the flight."""
    names = FENCES[facts.autopilot]
    missing = [name for name in names if facts.parameter(name) is None]
    yield from (
        _unread(facts, name, "a fence that is smaller than the mission ends the mission in flight") for name in missing
    )
    if missing:
        return
    values = dict(zip(names, (facts.parameter(name) or 0.0 for name in names), strict=True))
    across, up, terminates = _px4_fence(values) if facts.autopilot is AutopilotKind.PX4 else _ardupilot_fence(values)
    if across is None and up is None:
        yield Finding(Grade.PASS, facts.subject, "fence", "the autopilot's fence is off or takes no action")
        return
    if terminates:
        yield Finding(
            Grade.REFUSE,
            facts.subject,
            "fence",
            f"GF_ACTION = {PX4_FENCE_TERMINATES}: flight termination at the fence",
            MOTORS_STOP,
            "set GF_ACTION = 2 (hold) or 5 (land)",
        )
    reaches = ((across, extent_m(mission, vehicle), "from home"), (up, highest_m(mission, vehicle), "above home"))
    for limit, needed_m, where in reaches:
        if limit is not None:
            yield _room(facts, *limit, needed_m, where)


_Limit = tuple[str, float]


def _px4_fence(values: Mapping[str, float]) -> tuple[_Limit | None, _Limit | None, bool]:
    """Return name and value of the horizontal and of the vertical limit, and whether a breach ends in termination."""
    limits = [(name, values[name]) for name in ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST")]
    across, up = (limit if values["GF_ACTION"] > PX4_FENCE_WARNS and limit[1] > 0.0 else None for limit in limits)
    return across, up, values["GF_ACTION"] == PX4_FENCE_TERMINATES


def _ardupilot_fence(values: Mapping[str, float]) -> tuple[_Limit | None, _Limit | None, bool]:
    kinds = int(values["FENCE_TYPE"]) if values["FENCE_ENABLE"] > 0.0 and values["FENCE_ACTION"] > 0.0 else 0
    across = ("FENCE_RADIUS", values["FENCE_RADIUS"]) if kinds & ARDUPILOT_FENCE_CIRCLE else None
    up = ("FENCE_ALT_MAX", values["FENCE_ALT_MAX"]) if kinds & ARDUPILOT_FENCE_ALTITUDE else None
    return across, up, False


def _room(facts: VehicleFacts, name: str, limit_m: float, needed_m: float, where: str) -> Finding:
    return Finding.graded(
        Grade.WARNING if needed_m > limit_m else Grade.PASS,
        facts.subject,
        "fence",
        f"the mission reaches {needed_m:.0f} m {where}; the fence {name} is at {limit_m:g} m",
        "the autopilot ends the mission at its fence, regardless of the other vehicles",
        f"raise {name} above {needed_m:.0f} m, or shorten the mission",
    )


def _unread(facts: VehicleFacts, name: str, why: str) -> Finding:
    step = f"check {name} with a ground station, and check the link"
    return Finding(Grade.WARNING, facts.subject, name, f"{name} could not be read", why, step)
