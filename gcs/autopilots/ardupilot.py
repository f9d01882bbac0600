"""ArduPilot: ArduCopter, as of 4.7."""

from collections.abc import Mapping

from gcs.autopilots.autopilot import (
    CORDON_ID,
    CROSSING,
    POS_HORIZ_ABS,
    POS_HORIZ_REL,
    PRED_POS_HORIZ_ABS,
    PRED_POS_HORIZ_REL,
    STUB_UID,
    Autopilot,
    EstimatorDialect,
    Evidence,
    FenceLimits,
    Fields,
    Judgement,
    TruthMessage,
    VehicleKind,
)

SIMULATES = "SIM_OPOS_LAT"
"""A parameter that only firmware with simulation has."""
GUIDED = 4
GUIDED_LONGEST_S = 5.0
FENCE_ALTITUDE, FENCE_CIRCLE, FENCE_AREAS = 1, 2, 4
STATION_TIMEOUT_S, STATION_TIMEOUT_WALL_S = 5.0, 3.0
"""FS_GCS_TIMEOUT: the firmware's default, but at least this many seconds of the link.

MAVSDK sends a heartbeat once per wall second; beside other simulators the autopilot's time may pass faster.
"""
STATION_GRACE_S = 1.0
"""Tolerance of FS_GCS_TIMEOUT, which is checked three times a second."""
DEG_E7 = 1e-7

MODES = {
    0: "stabilize", 1: "acro", 2: "alt hold", 3: "auto", GUIDED: "guided", 5: "loiter", 6: "return", 7: "circle",
    9: "land", 11: "drift", 13: "sport", 14: "flip", 15: "autotune", 16: "poshold", 17: "brake", 18: "throw",
    19: "avoid adsb", 20: "guided nogps", 21: "smart return", 22: "flowhold", 23: "follow", 24: "zigzag",
    25: "system id", 26: "autorotate", 27: "auto return", 28: "turtle", 29: "rate acro",
}  # fmt: skip
"""The modes, numbered in the log and in heartbeats alike."""


def _kind(evidence: Evidence) -> VehicleKind:
    """Return the kind of a vehicle; a board that simulates has the USB vendor id of its maker."""
    if evidence.uid is not None and evidence.uid >> 32 == STUB_UID:
        return VehicleKind.STUB
    if not any(value is not None for value in evidence.parameters.values()) or evidence.vendor_id is None:
        return VehicleKind.UNKNOWN
    if evidence.parameters.get(SIMULATES) is None:
        return VehicleKind.FLIGHT
    return VehicleKind.BOARD if evidence.vendor_id else VehicleKind.SIMULATOR


def _true_place(fields: Fields) -> tuple[float, float, float]:
    """Return the place in SIM_STATE; its first latitude and longitude are 32-bit floats, exact to half a metre.

    Raises ValueError if only those are known: the exact ones are 0.
    """
    if fields["lat_int"] == fields["lon_int"] == 0:
        raise ValueError("the exact place is unknown")
    return fields["lat_int"] * DEG_E7, fields["lon_int"] * DEG_E7, float(fields["alt"])


def _failsafe_parameters(time_scale: float) -> Mapping[str, int | float]:
    timeout_s = max(STATION_TIMEOUT_S, STATION_TIMEOUT_WALL_S * time_scale)
    return {"FS_GCS_ENABLE": 5, "SYSID_MYGCS": CORDON_ID, "FS_GCS_TIMEOUT": timeout_s}


def _throttle_failsafe(value: float) -> Judgement:
    if int(value) == 0:
        why = "without it the vehicle does not react when a failed remote control keeps the pilot from taking over"
        step = "set FS_THR_ENABLE = 3 (land) if a remote control is used; without one, leave it and check the link"
        return "warning", "no failsafe when the remote control is lost", why, step
    return "pass", f"failsafe {value:g} when the remote control is lost", "", ""


def _station_failsafe(value: float) -> Judgement:
    land = f"set FS_GCS_ENABLE = 5 (land), and SYSID_MYGCS (MAV_GCS_SYSID since 4.7) to cordon's id, {CORDON_ID}"
    if int(value) == 0:
        why = "after a loss of cordon or of the link the vehicle hovers at its last setpoint until the battery is empty"
        return "warning", "no failsafe when the ground station's link is lost", why, land
    if int(value) in (1, 3):
        return "warning", "return when the ground station's link is lost", CROSSING, land
    return "pass", f"failsafe {value:g} when the ground station's link is lost", "", ""


def _guided_timeout(value: float) -> Judgement:
    meaning = f"{value:g} s until guided velocities and attitudes expire"
    if value > GUIDED_LONGEST_S:
        return "warning", meaning, "until then the vehicle flies on without commands", "set GUID_TIMEOUT = 3"
    return "pass", meaning, "", ""


def _fence(values: Mapping[str, float]) -> FenceLimits:
    kinds, acts = int(values["FENCE_TYPE"]), values["FENCE_ENABLE"] > 0.0 and values["FENCE_ACTION"] > 0.0
    across = ("FENCE_RADIUS", values["FENCE_RADIUS"]) if acts and kinds & FENCE_CIRCLE else None
    up = ("FENCE_ALT_MAX", values["FENCE_ALT_MAX"]) if acts and kinds & FENCE_ALTITUDE else None
    return FenceLimits(across, up, acts and bool(kinds & FENCE_AREAS))


AUTOPILOT = Autopilot(
    name="ardupilot",
    label="ArduPilot",
    number=3,
    simulator_port=14640,
    guided_mode=GUIDED,
    mode=lambda number: MODES.get(number, f"mode {number}"),
    external_mode=MODES[GUIDED],
    parameters_bytewise=False,
    leaves_offboard_s=STATION_TIMEOUT_S + STATION_GRACE_S,
    failed_check=r"^(PreArm|Arm): ",
    truth=TruthMessage(
        "SIM_STATE",
        108,
        104,
        _true_place,
        lambda fields: (float(fields["vn"]), float(fields["ve"]), float(fields["vd"])),
    ),
    estimator=EstimatorDialect(
        "EKF_STATUS_REPORT",
        193,
        ("pos_horiz_variance", "pos_vert_variance", "velocity_variance", "compass_variance"),
        # Disarmed, it may report only the position predicted for flight, which its own arming checks use.
        POS_HORIZ_REL | POS_HORIZ_ABS | PRED_POS_HORIZ_REL | PRED_POS_HORIZ_ABS,
        POS_HORIZ_ABS | PRED_POS_HORIZ_ABS,
        {1024: "not initialized"},
        1 << 15,
        "WIND",
        168,
        ("speed",),
    ),
    kind=_kind,
    failsafe_parameters=_failsafe_parameters,
    judges={
        "FS_THR_ENABLE": _throttle_failsafe,
        "FS_GCS_ENABLE": _station_failsafe,
        "GUID_TIMEOUT": _guided_timeout,
    },
    fence_parameters=("FENCE_ENABLE", "FENCE_ACTION", "FENCE_TYPE", "FENCE_RADIUS", "FENCE_ALT_MAX"),
    fence=_fence,
    # The names differ from 4.7 on.
    speed_limits=(("WPNAV_SPEED", 0.01), ("WP_SPD", 1.0)),
    acceleration_limits=(("WPNAV_ACCEL", 0.01), ("WP_ACC", 1.0)),
    station_failsafe="FS_GCS_ENABLE",
    station_ids=("MAV_GCS_SYSID", "SYSID_MYGCS"),
    advice={
        "airframe": "FRAME_CLASS",
        "hold": "loiter or guided",
        "rates": "SR0_*",
        "streams": "SR1_* = 0",
        "simulation": SIMULATES,
        "system id": "SYSID_THISMAV",
        "signing": "does",
        "gimbal": "MNT1_TYPE",
        "alone": "stays at its last setpoint until its ground station failsafe acts (FS_GCS_ENABLE)",
    },
)
