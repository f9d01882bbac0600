"""PX4, as of 1.17."""

from collections.abc import Mapping

from gcs.autopilots.autopilot import (
    CROSSING,
    MOTORS_STOP,
    POS_HORIZ_ABS,
    POS_HORIZ_REL,
    STUB_UID,
    Autopilot,
    EstimatorDialect,
    Evidence,
    FenceLimits,
    Judgement,
    TruthMessage,
    VehicleKind,
)

SIMULATES = "SYS_HITL"
"""The parameter for hardware in the loop."""
INNER, OUTER = 2.0, 1.0
"""Its value on a board that simulates its body itself, and on one with an external simulator."""
SITL_UID = 0x4954_414C_4449_4E4F
"""The unique id that simulator builds report for system id 1; each further system id adds one."""
OFFBOARD_LOSS_LONGEST_S, OFFBOARD_LOSS_LIMIT_S, OFFBOARD_LOSS_SHORTEST_S = 2.0, 5.0, 0.3
FENCE_WARNS, FENCE_TERMINATES = 1, 4
DEG_E7, MM, CM_S = 1e-7, 1e-3, 1e-2

STATES = {
    0: "manual", 1: "altitude", 2: "position", 3: "mission", 4: "hold", 5: "return", 6: "position slow", 10: "acro",
    12: "descend", 13: "termination", 14: "offboard", 15: "stabilized", 17: "take-off", 18: "land",
    19: "follow target", 20: "precision land", 21: "orbit", 22: "vtol take-off",
}  # fmt: skip
"""The navigation states, as the log numbers them."""

MODES = {
    (1, 0): "manual", (2, 0): "altitude", (3, 0): "position", (3, 1): "orbit", (4, 1): "ready", (4, 2): "take-off",
    (4, 3): "hold", (4, 4): "mission", (4, 5): "return", (4, 6): "land", (4, 8): "follow target",
    (4, 9): "precision land", (4, 10): "vtol take-off", (5, 0): "acro", (6, 0): "offboard", (7, 0): "stabilized",
    (10, 0): "termination",
}  # fmt: skip
"""The (main mode, sub mode), as heartbeats number them."""


def state_name(number: int) -> str:
    """Return the name of a navigation state."""
    return STATES.get(number, f"state {number}")


def _mode(custom_mode: int) -> str:
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    return MODES.get((main, sub), f"mode {main}.{sub}")


def _kind(evidence: Evidence) -> VehicleKind:
    """Return the kind of a vehicle; unknown if its evidence is contradictory."""
    hitl = evidence.parameters.get(SIMULATES)
    if evidence.uid is None or hitl is None:
        return VehicleKind.UNKNOWN
    if evidence.hil:
        return {INNER: VehicleKind.BOARD, OUTER: VehicleKind.BOARD_OUTER}.get(hitl, VehicleKind.UNKNOWN)
    if hitl != 0.0:
        return VehicleKind.UNKNOWN
    if evidence.uid >> 32 == STUB_UID:
        return VehicleKind.STUB
    return VehicleKind.SIMULATOR if evidence.uid == SITL_UID + evidence.system_id - 1 else VehicleKind.FLIGHT


def _offboard_loss_action(value: float) -> Judgement:
    land = "set COM_OBL_RC_ACT = 4 (land) or 5 (hold)"
    well = {4: "land", 5: "hold"}
    if (action := well.get(int(value))) is not None:
        return "pass", f"{action} when setpoints stop", "", ""
    by_hand = {0: "position", 1: "altitude", 2: "manual"}
    if (mode := by_hand.get(int(value))) is not None:
        why = "without a remote control NAV_RCL_ACT decides: by default the vehicle flies home across the others' paths"
        return "warning", f"{mode} mode when setpoints stop", why, land
    if int(value) == 3:
        return "warning", "return when setpoints stop", CROSSING, land
    return "refuse", "motors off or unknown action when setpoints stop", MOTORS_STOP, land


def _offboard_loss_time(value: float) -> Judgement:
    meaning = f"{value:g} s without setpoints until the failsafe acts"
    reset = "set COM_OF_LOSS_T = 1"
    if value < OFFBOARD_LOSS_SHORTEST_S:
        return "warning", meaning, "a short interruption of the link ends the flight", reset
    why = "until then the vehicle flies on towards its last setpoint"
    if value > OFFBOARD_LOSS_LONGEST_S:
        return "refuse" if value > OFFBOARD_LOSS_LIMIT_S else "warning", meaning, why, reset
    return "pass", meaning, "", ""


def _link_loss_action(value: float) -> Judgement:
    well = {0: "no action", 1: "hold", 3: "land"}
    if (action := well.get(int(value))) is not None:
        return "pass", f"{action} when the ground station's link is lost", "", ""
    land = "set NAV_DLL_ACT = 3 (land) or 1 (hold)"
    if int(value) == 2:
        return "warning", "return when the ground station's link is lost", CROSSING, land
    return "refuse", "motors off or unknown action when the ground station's link is lost", MOTORS_STOP, land


def _fence(values: Mapping[str, float]) -> FenceLimits:
    action, limits = values["GF_ACTION"], [(name, values[name]) for name in ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST")]
    across, up = (limit if action > FENCE_WARNS and limit[1] > 0.0 else None for limit in limits)
    found = f"GF_ACTION = {FENCE_TERMINATES}: flight termination at the fence"
    terminates = (found, "set GF_ACTION = 2 (hold) or 5 (land)") if action == FENCE_TERMINATES else None
    return FenceLimits(across, up, action > FENCE_WARNS, terminates)


AUTOPILOT = Autopilot(
    name="px4",
    label="PX4",
    number=12,
    simulator_port=14540,
    guided_mode=None,
    mode=_mode,
    external_mode="offboard",
    parameters_bytewise=True,
    leaves_offboard_s=2.0,
    setpoint_timeout=("COM_OF_LOSS_T", 1.0),
    failed_check=r"\b(preflight fail|arming denied|not ready)\b",
    truth=TruthMessage(
        "HIL_STATE_QUATERNION",
        115,
        76,
        lambda fields: (fields["lat"] * DEG_E7, fields["lon"] * DEG_E7, fields["alt"] * MM),
        lambda fields: (fields["vx"] * CM_S, fields["vy"] * CM_S, fields["vz"] * CM_S),
    ),
    estimator=EstimatorDialect(
        "ESTIMATOR_STATUS",
        230,
        ("pos_horiz_ratio", "pos_vert_ratio", "vel_ratio", "mag_ratio"),
        POS_HORIZ_REL | POS_HORIZ_ABS,
        POS_HORIZ_ABS,
        {2048: "accelerometer error"},
        1024,
        "WIND_COV",
        231,
        ("wind_x", "wind_y"),
    ),
    kind=_kind,
    failsafe_parameters=lambda _time_scale: {"COM_OBL_RC_ACT": 4},
    judges={
        "COM_OBL_RC_ACT": _offboard_loss_action,
        "COM_OF_LOSS_T": _offboard_loss_time,
        "NAV_DLL_ACT": _link_loss_action,
    },
    fence_parameters=("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"),
    fence=_fence,
    speed_limits=(("MPC_XY_VEL_MAX", 1.0),),
    acceleration_limits=(("MPC_ACC_HOR", 1.0),),
    advice={
        "airframe": "SYS_AUTOSTART and MAV_TYPE",
        "rates": "MAV_0_RATE",
        "streams": "MAV_0_MODE, mavlink -m minimal",
        "bench": f"{SIMULATES} = {INNER:g}",
        "simulation": SIMULATES,
        "system id": "MAV_SYS_ID",
        "signing": "since 1.18",
        "gimbal": "MNT_MODE_IN = 4",
        "alone": "leaves offboard about 1 s after the last setpoint, then holds or lands (COM_OBL_RC_ACT)",
    },
)
