"""A stub that behaves as PX4: offboard ends with its stream of setpoints, and the fence is that of its parameters.

Its failsafe for a silent system, NAV_DLL_ACT, is not simulated.
"""

from collections.abc import Mapping
from math import hypot, inf

from sitl.autopilot.autopilot import MavResult, StubAutopilot
from sitl.autopilot.dialect import LEVEL, Dialect, EstimatorState, TrueMotion, bounded_i16
from sitl.autopilot.modes import NEEDS_GLOBAL_POSITION, NEEDS_STICKS, Conditions, NavMode, can_arm
from sitl.autopilot.parameters import FlightLimits, ParameterTable, Value
from sitl.mavlink_constants import Fields, MessageId, Result

CHECK_PERIOD_S = 0.1
"""The offboard stream is checked ten times a second: COM_OF_LOSS_T is noticed that much later."""
MODES = {
    NavMode.MANUAL: (1, 0), NavMode.ALTITUDE: (2, 0), NavMode.POSITION: (3, 0), NavMode.TAKE_OFF: (4, 2),
    NavMode.HOLD: (4, 3), NavMode.RETURN: (4, 5), NavMode.LAND: (4, 6), NavMode.OFFBOARD: (6, 0),
    NavMode.STABILIZED: (7, 0),
}  # fmt: skip
"""The (main mode, sub mode) pairs."""
MODES_BY_SEVERITY = {NavMode.HOLD: 1, NavMode.RETURN: 2, NavMode.LAND: 3}
OFFBOARD_LOSS = {
    0: NavMode.POSITION, 1: NavMode.ALTITUDE, 2: NavMode.STABILIZED, 3: NavMode.RETURN, 4: NavMode.LAND,
    5: NavMode.HOLD,
}  # fmt: skip
"""COM_OBL_RC_ACT -> the mode after setpoints stop; other values are flown as Position, the default."""

STICKS_LOSS = {1: NavMode.HOLD, 2: NavMode.RETURN, 3: NavMode.LAND}
"""NAV_RCL_ACT -> the mode in place of one that needs sticks; other values, which stop motors, descend here."""

BREACH_MODES = {2: NavMode.HOLD, 3: NavMode.RETURN, 5: NavMode.LAND}
"""GF_ACTION -> the mode after a breach; the others only warn, or stop motors, which the stub does not simulate."""
WARNS = 1

RATES_HZ: Mapping[int, float] = {
    MessageId.HEARTBEAT: 1.0, MessageId.SYS_STATUS: 5.0, MessageId.GPS_RAW_INT: 8.0, MessageId.ATTITUDE: 50.0,
    MessageId.LOCAL_POSITION_NED: 30.0, MessageId.GLOBAL_POSITION_INT: 50.0, MessageId.ALTITUDE: 10.0,
    MessageId.BATTERY_STATUS: 0.5, MessageId.HOME_POSITION: 0.5, MessageId.EXTENDED_SYS_STATE: 5.0,
}  # fmt: skip
"""Those of the onboard link, in simulated time."""

DEFAULTS: Mapping[str, Value] = {
    "COM_ARM_WO_GPS": 1, "COM_DISARM_LAND": 2.0, "COM_DISARM_PRFLT": 10.0, "COM_DL_LOSS_T": 10, "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0, "COM_RCL_EXCEPT": 0, "COM_RC_IN_MODE": 1, "COM_SPOOLUP_TIME": 1.0, "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0, "GF_SOURCE": 0, "MAV_SYS_ID": 1, "MAV_TYPE": 2,
    "MIS_TAKEOFF_ALT": 2.5, "MPC_ACC_HOR": 3.0, "MPC_LAND_CRWL": 0.3, "MPC_LAND_SPEED": 0.7, "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5, "MPC_XY_CRUISE": 5.0, "MPC_XY_VEL_MAX": 12.0, "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0, "NAV_DLL_ACT": 0, "NAV_MC_ALT_RAD": 0.8, "NAV_RCL_ACT": 2, "RTL_DESCEND_ALT": 10.0,
    "RTL_RETURN_ALT": 30.0, "SYS_AUTOSTART": 10040, "SYS_HITL": 0,
}  # fmt: skip
"""Those of 1.17, of a multicopter in its simulator. An int is a 32-bit integer on the wire, a float a 32-bit float."""


def _limits(values: Mapping[str, Value]) -> FlightLimits:
    return FlightLimits(
        cruise_m_s=values["MPC_XY_CRUISE"],
        climb_m_s=values["MPC_Z_VEL_MAX_UP"],
        sink_m_s=values["MPC_Z_VEL_MAX_DN"],
        land_m_s=values["MPC_LAND_SPEED"],
        crawl_m_s=values["MPC_LAND_CRWL"],
        take_off_m_s=values["MPC_TKO_SPEED"],
        take_off_ramp_s=values["MPC_TKO_RAMP_T"],
        take_off_height_m=values["MIS_TAKEOFF_ALT"],
        spool_up_s=values["COM_SPOOLUP_TIME"],
        return_rise_m=values["RTL_RETURN_ALT"],
        altitude_margin_m=values["NAV_MC_ALT_RAD"],
    )


def custom_mode(mode: NavMode) -> int:
    """Return the heartbeat's custom_mode field."""
    main, sub = MODES[mode]
    return main << 16 | sub << 24


def _estimator(state: EstimatorState) -> Fields:
    """Return the fields of ESTIMATOR_STATUS; its test ratios are squared."""
    ratios = (share**2 for share in state.shares_of_gates)
    return state.boot_ms * 1000, state.flags, *ratios, 0.0, 0.0, state.accuracy_m, state.accuracy_m


def _truth(motion: TrueMotion) -> Fields:
    """Return the fields of HIL_STATE_QUATERNION: beside place and velocity, those of a level vehicle."""
    velocity = [bounded_i16(v * 100.0) for v in motion.velocity_ned_m_s]
    rates, speeds, forces = (0.0, 0.0, 0.0), (0, 0), (0, 0, 0)
    return 0, LEVEL, *rates, *motion.place, *velocity, *speeds, *forces


class Px4(StubAutopilot):
    """One vehicle: commands in, motion and status out."""

    DIALECT = Dialect(
        autopilot=12,
        system_id_parameter="MAV_SYS_ID",
        firmware_version=1 << 24 | 17 << 16 | 0 << 8 | 255,
        # Mission and command items as integers, parameters bytewise, local setpoints, MAVLink 2, fences.
        capabilities=2 | 4 | 8 | 16 | 128 | 8192 | 16384,
        refused=Result.TEMPORARILY_REJECTED,
        modes={mode: (custom_mode(mode), float(main), float(sub)) for mode, (main, sub) in MODES.items()},
        rates_hz=RATES_HZ,
        estimator_message=230,
        estimator=_estimator,
        truth_message=115,
        truth=_truth,
        acknowledges_mode_first=True,
        tells_checks_in_heartbeat=True,
        parameters_bytewise=True,
        hil_parameter="SYS_HITL",
        origin_may_move=True,
        corrects_home=True,
    )
    TABLE = ParameterTable(DEFAULTS, _limits)
    BOOT_MODE = NavMode.HOLD  # without a remote control
    NEEDS_STREAM = True
    ARMED_TEXT = "Armed by external command"
    DISARMED_TEXT = "Disarmed by {reason}"
    TAKE_OFF_TEXT = "Takeoff detected"
    LANDING_TEXT = "Landing detected"
    LAND_TEXT = "Landing at current position"
    REFUSED_TEXT = "Switching to {mode} is currently not available"

    @property
    def conditions(self) -> Conditions:
        """The present conditions of flight modes."""
        age_s = self.time_s - self._received_s
        flow = age_s <= self.parameters["COM_OF_LOSS_T"] + CHECK_PERIOD_S
        return Conditions(self.estimator_ready, flow, self.global_position_known)

    @property
    def armable(self) -> bool:
        """Whether the preflight checks pass in the present mode."""
        return can_arm(self.mode, self.conditions)

    def take_off(self, altitude_m: float | None = None) -> MavResult:
        """Take off to a mission altitude, by default MIS_TAKEOFF_ALT above the present one; if disarmed, on arming."""
        result = self.select(NavMode.TAKE_OFF)
        if result is MavResult.ACCEPTED:
            self._guidance.plan_take_off(altitude_m)
            if altitude_m is None:
                self._send_text(f"Using default takeoff altitude: {self.parameters['MIS_TAKEOFF_ALT']:.1f} m")
        return result

    def _flown(self) -> NavMode:
        """Return the mode to fly: the user's, or a failsafe's; of several failsafes the one that ends the flight."""
        flown = self._without_setpoints()
        if self._breach_mode is None:
            return flown
        return max(flown, self._breach_mode, key=lambda mode: MODES_BY_SEVERITY.get(mode, 0))

    def _without_setpoints(self) -> NavMode:
        """Return the user's mode, or the failsafe of offboard without setpoints.

        There are no sticks: a failsafe that needs them becomes the one for lost sticks (since 1.17; earlier versions
        descend in Position mode). A failsafe that needs a global position lands without one.
        """
        mode, conditions = self._intention.mode, self.conditions
        if not (self.armed and mode is NavMode.OFFBOARD and not conditions.setpoints_flow):
            return mode
        failsafe = OFFBOARD_LOSS.get(int(self.parameters["COM_OBL_RC_ACT"]), NavMode.POSITION)
        if failsafe in NEEDS_STICKS:
            failsafe = STICKS_LOSS.get(int(self.parameters["NAV_RCL_ACT"]), failsafe)
        lost = failsafe in NEEDS_GLOBAL_POSITION and not conditions.global_position
        return NavMode.LAND if lost else failsafe

    def _breach(self) -> tuple[str, NavMode | None] | None:
        """Return text and mode of a breach by GF_ACTION; the vehicle has to be inside one inclusion zone."""
        action = int(self.parameters["GF_ACTION"])
        if action != WARNS and action not in BREACH_MODES:
            return None
        across_m, up_m = self.parameters["GF_MAX_HOR_DIST"], self.parameters["GF_MAX_VER_DIST"]
        (x, y, z), home_m = self.airframe.position_m, self.home_m
        inclusions = [zone.allows((x, y)) for zone in self.zones if zone.stay_inside]
        kept_out = all(zone.allows((x, y)) for zone in self.zones if not zone.stay_inside)
        words = "Geofence: approaching or outside geofence"
        if 0.0 < across_m < hypot(x - home_m[0], y - home_m[1]):
            words = "Geofence: exceeding maximum distance to Home"
        elif 0.0 < up_m < z - home_m[2]:
            words = "Geofence: exceeding maximum altitude above Home"
        elif kept_out and (any(inclusions) or not inclusions):
            return None
        return words, BREACH_MODES.get(action)

    def _arming_fault(self) -> str | None:
        return None if self.armable else "Arming denied: Resolve system health failures first"

    def _disarm_after_s(self, *, flown: bool) -> float:
        """Return how long it stays armed on the ground, after a flight or before; a parameter of 0 is no limit."""
        if flown:
            return self.parameters["COM_DISARM_LAND"] or inf
        limit_s = self.parameters["COM_DISARM_PRFLT"]
        return limit_s + self.parameters["COM_SPOOLUP_TIME"] if limit_s else inf


AUTOPILOT = Px4
