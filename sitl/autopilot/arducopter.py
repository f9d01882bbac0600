"""A stub autopilot that behaves as ArduCopter: GUIDED flies take-off and setpoints, and positions do not expire.

Differences from PX4: a mode change is immediate and persists after disarming; no stream of setpoints is required, and
its end triggers no failsafe, but a silent ground station may (FS_GCS_ENABLE); a position sent with a velocity moves at
that velocity until the next setpoint, for three seconds at most; take-off is a command to a vehicle armed in GUIDED;
landing disarms at once. GUIDED is `NavMode.OFFBOARD` here, BRAKE is HOLD, LOITER is POSITION.
"""

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from math import inf
from types import MappingProxyType

from estimation.frames import Triple
from estimation.plant.model import Plant
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.equipment import FULL_BATTERY, GPS_POSITIONING, Battery, Positioning
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import Conditions, NavMode
from sitl.autopilot.parameters import ARDUCOPTER_TABLE, Parameters
from sitl.autopilot.px4 import Autopilot, CommandResult, Severity
from sitl.vehicle.shaping import ShapeLimits

CHECK_PERIOD_S = 1.0 / 3.0
"""ArduCopter checks three times a second, so FS_GCS_TIMEOUT is detected up to a third of a second late."""
DISABLED = 0
ACTIONS: Mapping[int, NavMode] = MappingProxyType({4: NavMode.LAND, 5: NavMode.LAND, 7: NavMode.HOLD})
"""FS_GCS_ENABLE -> the mode; all other values return. 7 is BRAKE.

SmartRTL (3, 4), which the stub does not have, falls back to RTL and LAND, as ArduCopter's without a recorded path."""
CONTINUE_LANDING, CONTINUE_PILOT_CONTROL = 1 << 3, 1 << 4
"""Bits of FS_OPTIONS."""
BY_PILOT = frozenset({NavMode.STABILIZED, NavMode.ALTITUDE, NavMode.POSITION, NavMode.HOLD})
"""Modes that ArduCopter does not consider autonomous, including BRAKE."""


class StationEvent(Enum):
    """The changes that a check detects."""

    LOST = "lost"
    REGAINED = "regained"


class StationFailsafe:
    """Detects the loss and the return of the ground station's heartbeats."""

    def __init__(self, parameters: Parameters) -> None:
        """Monitor the station of the parameters, with their values at each check."""
        self._parameters = parameters
        self._heard_s: float | None = None
        self._lost = False
        self._checked_s = -inf

    def receive_heartbeat(self, time_s: float, system_id: int) -> None:
        """Take a heartbeat that arrived at `time_s`."""
        if system_id == self._parameters["SYSID_MYGCS"]:
            self._heard_s = time_s

    def check(self, time_s: float) -> StationEvent | None:
        """Return the change since the last check; None if no check is due or the failsafe is off."""
        if time_s < self._checked_s + CHECK_PERIOD_S or self._parameters["FS_GCS_ENABLE"] == DISABLED:
            return None
        self._checked_s = time_s
        if self._heard_s is None:
            return None
        before, self._lost = self._lost, time_s - self._heard_s > self._parameters["FS_GCS_TIMEOUT"]
        if self._lost is before:
            return None
        return StationEvent.LOST if self._lost else StationEvent.REGAINED

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


class ArduCopter(Autopilot):
    """One vehicle: commands in, motion and status out."""

    ARMED_TEXT = "Arming motors"
    DISARMED_TEXT = "Disarming motors"
    TAKE_OFF_TEXT = LANDING_TEXT = LAND_TEXT = MODE_REFUSED_TEXT = None

    def __init__(
        self,
        plant: Plant,
        start_m: Triple = (0.0, 0.0, 0.0),
        *,
        parameters: Parameters | None = None,
        battery: Battery = FULL_BATTERY,
        positioning: Positioning = GPS_POSITIONING,
    ) -> None:
        """Boot on the ground at `start_m`, disarmed, in STABILIZE; the limits of horizontal motion are read once."""
        parameters = parameters or Parameters(ARDUCOPTER_TABLE)
        shape = ShapeLimits(
            parameters["WPNAV_SPEED"] * CM, parameters["WPNAV_ACCEL"] * CM, float(parameters["PSC_JERK_XY"])
        )
        self._feeds = plant.feedforward > 0.0
        self._station = StationFailsafe(parameters)
        super().__init__(
            plant,
            start_m,
            parameters=parameters,
            battery=battery,
            positioning=positioning,
            mode=NavMode.STABILIZED,
            shape=shape,
        )

    @property
    def conditions(self) -> Conditions:
        """The conditions of the flight modes: GUIDED needs no setpoints, and all modes need only a local position."""
        return Conditions(estimator_ready=self.estimator_ready, setpoints_flow=True)

    @property
    def armable(self) -> bool:
        """Whether the pre-arm checks pass, independent of the mode, which is checked on arming."""
        return self.estimator_ready

    def take_off(self, altitude_m: float | None = None) -> CommandResult:
        """Take off to a mission altitude, only if armed in GUIDED on the ground; there is no default altitude."""
        if altitude_m is None or not (self.armed and self.landed and self.mode is NavMode.OFFBOARD):
            return CommandResult.REJECTED
        x, y, _ = self.airframe.position_m
        self._applied = PositionTarget((x, y, altitude_m))
        return CommandResult.ACCEPTED

    def receive_setpoint(self, time_s: float, target: PositionTarget) -> None:
        """Take a setpoint that arrived at `time_s`; outside GUIDED and on the ground it is ignored."""
        if self.mode is NavMode.OFFBOARD and not self.landed:
            super().receive_setpoint(time_s, target)

    def receive_heartbeat(self, time_s: float, system_id: int) -> None:
        """Take the heartbeat of another system that arrived at `time_s`."""
        self._station.receive_heartbeat(time_s, system_id)

    def _watch_station(self) -> None:
        """React to a silent ground station; the mode persists when its heartbeats return."""
        event = self._station.check(self.time_s)
        if event is StationEvent.REGAINED:
            self._say("GCS Failsafe Cleared", Severity.WARNING)
        if event is not StationEvent.LOST:
            return
        if self.armed and self.landed:
            self._say("GCS Failsafe - Disarming", Severity.WARNING)
            self._disarm("ground station failsafe")
            return
        self._say("GCS Failsafe", Severity.WARNING)
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
        if self.time_s - self._heard_s > GUIDED_TIMEOUT_S:
            self._applied = replace(flown, velocity_m_s=())
        else:
            x, y, z = (place + rate * STEP_S for place, rate in zip(flown.position_m, flown.velocity_m_s, strict=True))
            self._applied = replace(flown, position_m=(x, y, z))

    def _arming_fault(self) -> str | None:
        if not self.armable:
            return "PreArm: Need Position Estimate"
        return "Arm: mode not armable" if self.mode in PREVENTS_ARMING else None

    def _flown(self) -> NavMode:
        return self._intention.mode

    def _fence_action(self) -> int:
        """Do nothing: ArduCopter's fence has other parameters and is not simulated."""
        return 0

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
