"""A stub autopilot that behaves as ArduCopter: GUIDED flies take-off and setpoints, and positions do not expire.

Differences from PX4: a mode change is immediate and persists after disarming; no stream of setpoints is required, and
its end triggers no failsafe, but a silent ground station may (FS_GCS_ENABLE); a position sent with a velocity moves at
that velocity until the next setpoint, for three seconds at most; take-off is a command to a vehicle armed in GUIDED;
landing disarms at once. GUIDED is `NavMode.OFFBOARD` here, BRAKE is HOLD, LOITER is POSITION.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from math import inf

from estimation.frames import Triple
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.autopilot import MavResult, Severity, StubAutopilot
from sitl.autopilot.dialect import LEVEL, Dialect, EstimatorState, TrueMotion
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import NavMode
from sitl.autopilot.parameters import FlightLimits, Parameters, ParameterTable, Value
from sitl.mavlink_constants import Fields, MessageId, Result
from sitl.vehicle.shaping import ShapeLimits

CHECK_PERIOD_S = 1.0 / 3.0
"""ArduCopter checks three times a second, so FS_GCS_TIMEOUT is detected up to a third of a second late."""
DISABLED = 0
ACTIONS: Mapping[int, NavMode] = {4: NavMode.LAND, 5: NavMode.LAND, 7: NavMode.HOLD}
"""FS_GCS_ENABLE -> the mode; all other values return. 7 is BRAKE.

SmartRTL (3, 4), which the stub does not have, falls back to RTL and LAND, as ArduCopter's without a recorded path."""
CONTINUE_LANDING, CONTINUE_PILOT_CONTROL = 1 << 3, 1 << 4
"""Bits of FS_OPTIONS."""
BY_PILOT = frozenset({NavMode.STABILIZED, NavMode.ALTITUDE, NavMode.POSITION, NavMode.HOLD})
"""Modes that ArduCopter does not consider autonomous, including BRAKE."""


class StationFailsafe:
    """Detects the loss and the return of the ground station's heartbeats."""

    def __init__(self, parameters: Parameters) -> None:
        """Monitor the station of the parameters, with their values at each check."""
        self._parameters = parameters
        self._received_s: float | None = None
        self._lost = False
        self._checked_s = -inf

    def receive_heartbeat(self, time_s: float, system_id: int) -> None:
        """Take a heartbeat that arrived at `time_s`."""
        if system_id == self._parameters["SYSID_MYGCS"]:
            self._received_s = time_s

    def check(self, time_s: float) -> bool | None:
        """Return whether it is lost, if that has changed; None if no check is due or the failsafe is off."""
        if time_s < self._checked_s + CHECK_PERIOD_S or self._parameters["FS_GCS_ENABLE"] == DISABLED:
            return None
        self._checked_s = time_s
        if self._received_s is None:
            return None
        before, self._lost = self._lost, time_s - self._received_s > self._parameters["FS_GCS_TIMEOUT"]
        return None if self._lost is before else self._lost

    def reaction(self, mode: NavMode) -> NavMode | None:
        """Return the mode that an armed vehicle in the air changes to from `mode`; None if it flies on."""
        options = int(self._parameters["FS_OPTIONS"])
        if mode is NavMode.LAND and options & CONTINUE_LANDING:
            return None
        if mode in BY_PILOT and options & CONTINUE_PILOT_CONTROL:
            return None
        return ACTIONS.get(int(self._parameters["FS_GCS_ENABLE"]), NavMode.RETURN)


CM = 0.01
GUIDED_TIMEOUT_S = 3.0
"""GUID_TIMEOUT: older velocities are ignored."""
LANDING_PAUSE_S = 4.0
"""LAND_WITH_DELAY_MS: the landing of a failsafe begins with a hover."""
PREVENTS_ARMING = frozenset({NavMode.HOLD, NavMode.LAND, NavMode.RETURN})

MODES = {
    NavMode.STABILIZED: 0, NavMode.ALTITUDE: 2, NavMode.OFFBOARD: 4, NavMode.POSITION: 5, NavMode.RETURN: 6,
    NavMode.LAND: 9, NavMode.HOLD: 17,
}  # fmt: skip
"""STABILIZE, ALT_HOLD, GUIDED, LOITER, RTL, LAND, BRAKE."""

_EXTENDED_STATUS = (MessageId.SYS_STATUS, MessageId.GPS_RAW_INT)
_POSITION = (MessageId.GLOBAL_POSITION_INT, MessageId.LOCAL_POSITION_NED)
_ATTITUDE = (MessageId.ATTITUDE,)
_BATTERY = (MessageId.BATTERY_STATUS,)

DEFAULTS: Mapping[str, Value] = {
    "ARMING_CHECK": 1, "DISARM_DELAY": 10, "FENCE_ACTION": 1, "FENCE_ALT_MAX": 100.0, "FENCE_ENABLE": 0,
    "FENCE_RADIUS": 300.0, "FENCE_TYPE": 7, "FRAME_CLASS": 1, "FS_CRASH_CHECK": 1, "FS_EKF_ACTION": 1,
    "FS_EKF_THRESH": 0.8, "FS_GCS_ENABLE": 0, "FS_GCS_TIMEOUT": 5.0, "FS_OPTIONS": 16, "FS_THR_ENABLE": 1,
    "GUID_OPTIONS": 0, "GUID_TIMEOUT": 3.0, "LAND_SPEED": 50.0, "MOT_SPOOL_TIME": 0.5, "PSC_JERK_XY": 5.0,
    "RTL_ALT": 1500.0, "SIM_OPOS_LAT": 47.397742, "SYSID_MYGCS": 255, "SYSID_THISMAV": 1, "TKOFF_SLEW_TIME": 2.0,
    "WPNAV_ACCEL": 250.0, "WPNAV_RADIUS": 200.0, "WPNAV_SPEED": 500.0, "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0,
}  # fmt: skip
"""They are in centimetres although the names do not show it. GUID_TIMEOUT ends velocities, not positions."""


def _limits(values: Mapping[str, Value]) -> FlightLimits:
    return FlightLimits(
        cruise_m_s=values["WPNAV_SPEED"] / 100.0,
        climb_m_s=values["WPNAV_SPEED_UP"] / 100.0,
        sink_m_s=values["WPNAV_SPEED_DN"] / 100.0,
        land_m_s=values["LAND_SPEED"] / 100.0,
        crawl_m_s=values["LAND_SPEED"] / 100.0,
        take_off_m_s=values["WPNAV_SPEED_UP"] / 100.0,
        take_off_ramp_s=values["TKOFF_SLEW_TIME"],
        take_off_height_m=0.0,  # a take-off states its altitude
        spool_up_s=values["MOT_SPOOL_TIME"],
        return_rise_m=values["RTL_ALT"] / 100.0,
        altitude_margin_m=values["WPNAV_RADIUS"] / 100.0,
    )


def _estimator(state: EstimatorState) -> Fields:
    """Return the fields of EKF_STATUS_REPORT; its "variances" are the square roots of its test ratios."""
    return state.flags, *state.shares_of_gates, 0.0


def _truth(motion: TrueMotion) -> Fields:
    """Return the fields of SIM_STATE: beside place and velocity, those of a level vehicle."""
    latitude, longitude, altitude_mm = motion.place
    place = (float(latitude), float(longitude), altitude_mm / 1e3)
    return *LEVEL, *(0.0,) * 9, *place, 0.0, 0.0, *motion.velocity_ned_m_s, latitude, longitude


class ArduCopter(StubAutopilot):
    """One vehicle: commands in, motion and status out."""

    DIALECT = Dialect(
        autopilot=3,
        system_id_parameter="SYSID_THISMAV",
        firmware_version=4 << 24 | 7 << 16 | 0 << 8 | 0,
        # Mission and command items as integers, local setpoints, MAVLink 2, fences, parameters as numbers.
        capabilities=1 | 2 | 4 | 8 | 128 | 8192 | 16384 | 131072,
        refused=Result.FAILED,
        modes={mode: (number, float(number), 0.0) for mode, number in MODES.items()},
        rates_hz={MessageId.HEARTBEAT: 1.0},
        estimator_message=193,
        estimator=_estimator,
        truth_message=108,
        truth=_truth,
        streams={
            0: (*_EXTENDED_STATUS, *_POSITION, *_ATTITUDE, *_BATTERY),
            **{2: _EXTENDED_STATUS, 6: _POSITION, 10: _ATTITUDE, 12: _BATTERY},
        },
        take_off_from_home=True,
    )
    TABLE = ParameterTable(DEFAULTS, _limits)
    BOOT_MODE = NavMode.STABILIZED
    ARMED_TEXT = "Arming motors"
    DISARMED_TEXT = "Disarming motors"

    @cached_property
    def _station(self) -> StationFailsafe:
        return StationFailsafe(self.parameters)

    def _shape(self) -> ShapeLimits:
        speed, acceleration = self.parameters["WPNAV_SPEED"] * CM, self.parameters["WPNAV_ACCEL"] * CM
        return ShapeLimits(speed, acceleration, float(self.parameters["PSC_JERK_XY"]))

    def take_off(self, altitude_m: float | None = None) -> MavResult:
        """Take off to a mission altitude, only if armed in GUIDED on the ground; there is no default altitude."""
        if altitude_m is None or not (self.armed and self.landed and self.mode is NavMode.OFFBOARD):
            return MavResult.REJECTED
        x, y, _ = self.airframe.position_m
        self._applied = PositionTarget((x, y, altitude_m))
        return MavResult.ACCEPTED

    def go_to(self, position_m: Triple) -> MavResult:
        """Fly to a mission position in GUIDED; from the ground it takes off first, and needs the setpoint again."""
        result = super().go_to(position_m)
        return self.take_off(position_m[2]) if result is MavResult.ACCEPTED and self.landed else result

    def receive_setpoint(self, time_s: float, target: PositionTarget) -> None:
        """Take a setpoint that arrived at `time_s`; outside GUIDED and on the ground it is ignored."""
        if self.mode is NavMode.OFFBOARD and not self.landed:
            super().receive_setpoint(time_s, target)

    def receive_heartbeat(self, time_s: float, system_id: int) -> None:
        """Take the heartbeat of another system that arrived at `time_s`."""
        self._station.receive_heartbeat(time_s, system_id)

    def _watch_station(self) -> None:
        """React to a silent ground station; the mode persists when its heartbeats return."""
        lost = self._station.check(self.time_s)
        if lost is False:
            self._send_text("GCS Failsafe Cleared", Severity.WARNING)
        if not lost:
            return
        if self.armed and self.landed:
            self._send_text("GCS Failsafe - Disarming", Severity.WARNING)
            self._disarm("ground station failsafe")
            return
        self._send_text("GCS Failsafe", Severity.WARNING)
        reaction = self._station.reaction(self.mode) if self.armed else None
        if reaction is NavMode.RETURN and not self.global_position_known:
            reaction = NavMode.LAND
        if reaction is None or reaction is self.mode:
            return
        self.select(reaction)
        if self.mode is NavMode.LAND:
            self._guidance.hover_before_landing(self.time_s + LANDING_PAUSE_S)

    def _apply_due_setpoints(self) -> None:
        super()._apply_due_setpoints()
        flown = self._applied
        if not self._feeds or flown is None or not flown.velocity_m_s:
            return
        if self.time_s - self._received_s > GUIDED_TIMEOUT_S:
            self._applied = replace(flown, velocity_m_s=())
        else:
            x, y, z = (place + rate * STEP_S for place, rate in zip(flown.position_m, flown.velocity_m_s, strict=True))
            self._applied = replace(flown, position_m=(x, y, z))

    def _arming_fault(self) -> str | None:
        if not self.armable:
            return "PreArm: Need Position Estimate"
        return "Arm: mode not armable" if self.mode in PREVENTS_ARMING else None

    def _on_mode_change(self) -> None:
        """Drop the setpoints: GUIDED begins by holding the position."""
        self._pending.clear()
        self._applied = None

    def _on_disarmed(self) -> None:
        """Keep the mode and drop the setpoint, which the vehicle would otherwise fly to after the next arming."""
        self._on_mode_change()

    def _disarm_after_s(self, *, flown: bool) -> float:
        """Return how long it stays armed on the ground; 0 after a commanded landing; a parameter of 0 is no limit."""
        if flown and self.mode in (NavMode.LAND, NavMode.RETURN):
            return 0.0
        return self.parameters["DISARM_DELAY"] or inf


AUTOPILOT = ArduCopter
