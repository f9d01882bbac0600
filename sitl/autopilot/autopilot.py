"""What all stub autopilots have in common: arming, modes, setpoints, take-off, landing, and the fence.

A state machine that changes only in its methods; time passes only in `step`. Positions are in
the mission frame, headings clockwise from north, times simulated seconds since boot.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum, IntEnum
from importlib import import_module
from math import inf
from typing import ClassVar

import numpy as np

from estimation.frames import Triple
from estimation.plant.model import Plant
from estimation.profile.autopilots import AutopilotName
from sitl.autopilot.airframe import STEP_S, Airframe
from sitl.autopilot.dialect import Dialect
from sitl.autopilot.fence import Zone
from sitl.autopilot.guidance import Guidance, PositionTarget
from sitl.autopilot.modes import Conditions, ModeEvent, NavMode, SelectedMode, can_run
from sitl.autopilot.parameters import Parameters, ParameterTable
from sitl.vehicle.mount import Mount
from sitl.vehicle.shaping import ShapeLimits


@dataclass(frozen=True, slots=True)
class Battery:
    """The battery at boot: its charge as a fraction, and the time that a full one lasts while armed [s]."""

    fraction: float = 1.0
    endurance_s: float = 1800.0


@dataclass(frozen=True, slots=True)
class Positioning:
    """The sources of position.

    Without `gps` the vehicle has a local position only, as indoors with cameras. A vehicle that is not `localised`
    never has a position; an `external` one has a position while it receives external positions.
    """

    gps: bool = True
    localised: bool = True
    external: bool = False


FULL_BATTERY = Battery()
GPS_POSITIONING = Positioning()


ESTIMATOR_READY_S = 2.0
"""The time from boot to a position estimate."""
DEAD_RECKONING_S = 5.0
"""The position estimate remains valid for this long without an external position (EKF2_NOAID_TOUT)."""
LANDED_AFTER_S = 1.0
"""From touching the ground to having landed."""
SETPOINTS_PENDING_MAX = 1000


class MavResult(Enum):
    """The result of a command, as in COMMAND_ACK."""

    ACCEPTED = "accepted"
    REJECTED = "temporarily rejected"


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKE_OFF = 3
    LANDING = 4


class Severity(IntEnum):
    """MAV_SEVERITY, as far as it is used."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


class StubAutopilot:
    """One vehicle: commands in, motion and status out. What is special about one autopilot, its subclass states."""

    DIALECT: ClassVar[Dialect]
    TABLE: ClassVar[ParameterTable]
    BOOT_MODE: ClassVar[NavMode]
    NEEDS_STREAM: ClassVar[bool] = False
    ARMED_TEXT: ClassVar[str]
    DISARMED_TEXT: ClassVar[str]
    TAKE_OFF_TEXT: ClassVar[str | None] = None
    LANDING_TEXT: ClassVar[str | None] = None
    LAND_TEXT: ClassVar[str | None] = None
    REFUSED_TEXT: ClassVar[str | None] = None

    def __init__(
        self,
        plant: Plant,
        start_m: Triple = (0.0, 0.0, 0.0),
        *,
        parameters: Parameters | None = None,
        battery: Battery = FULL_BATTERY,
        positioning: Positioning = GPS_POSITIONING,
        mount: Mount | None = None,
    ) -> None:
        """Boot on the ground at `start_m`, disarmed; the limits of horizontal motion are read once."""
        self.mount = mount
        self.parameters = parameters or Parameters(self.TABLE)
        self.airframe = Airframe(plant, start_m, shape=self._shape())
        self.battery_fraction = battery.fraction
        self.armed = False
        self.landed = True
        self.mode = self.BOOT_MODE
        self.gps = positioning.gps
        self._localised = positioning.localised
        self._located_s = -inf if positioning.external else inf
        self._endurance_s = battery.endurance_s
        self._delay_s = plant.delay_s
        self._feeds = plant.feedforward > 0.0
        self._guidance = Guidance(self.parameters, self.airframe)
        self._intention = SelectedMode(self.BOOT_MODE)
        self._steps = 0
        self._pending: deque[tuple[float, PositionTarget]] = deque(maxlen=SETPOINTS_PENDING_MAX)
        self._applied: PositionTarget | None = None
        self.setpoints_received = 0
        self._received_s = -inf
        self._armed_s = self._airborne_s = self._landed_s = -inf
        self._texts: list[tuple[Severity, str]] = []
        self.zones: tuple[Zone, ...] = ()
        self._breached = False
        self._breach_mode: NavMode | None = None

    @property
    def time_s(self) -> float:
        """Simulated seconds since boot, as advanced by `step`."""
        return self._steps * STEP_S

    @property
    def home_m(self) -> Triple:
        """The position of the last arming."""
        return self._guidance.home_m

    @property
    def estimator_ready(self) -> bool:
        """Whether there is a local position estimate."""
        located = self.time_s - self._located_s <= DEAD_RECKONING_S
        return self._localised and located and self.time_s >= ESTIMATOR_READY_S

    def receive_external_position(self, time_s: float) -> None:
        """Take the arrival of an external position."""
        self._located_s = max(self._located_s, time_s)

    @property
    def global_position_known(self) -> bool:
        """Whether it also has a global position: home, and the origin of its local frame."""
        return self.gps and self.estimator_ready

    @property
    def conditions(self) -> Conditions:
        """The present conditions of flight modes: by default all modes need a local position only, and no setpoints."""
        return Conditions(estimator_ready=self.estimator_ready, setpoints_flow=True)

    @property
    def armable(self) -> bool:
        """Whether the preflight checks pass; what depends on the mode may be checked on arming."""
        return self.estimator_ready

    @property
    def failsafe(self) -> bool:
        """Whether a failsafe is flown instead of the user's mode."""
        return self.mode is not self._intention.mode

    @property
    def landed_state(self) -> LandedState:
        """On the ground, or the phase of flight."""
        if self.landed:
            return LandedState.ON_GROUND
        doing = {NavMode.TAKE_OFF: LandedState.TAKE_OFF, NavMode.LAND: LandedState.LANDING}
        return doing.get(self.mode, LandedState.IN_AIR)

    def take_texts(self) -> list[tuple[Severity, str]]:
        """Return the autopilot's texts since the last call."""
        texts, self._texts = self._texts, []
        return texts

    def arm(self) -> MavResult:
        """Arm if the preflight checks pass; accepted if already armed. Clients cannot force it."""
        if self.armed:
            return MavResult.ACCEPTED
        fault = self._arming_fault()
        if fault is not None:
            return self._reject(fault)
        self.armed = True
        self._armed_s = self.time_s
        self._guidance.on_arm()
        self._send_text(self.ARMED_TEXT)
        return MavResult.ACCEPTED

    def disarm(self, *, force: bool = False) -> MavResult:
        """Disarm on the ground; with `force` also in the air, and the vehicle falls."""
        if self.armed and not (self.landed or force):
            return self._reject("Disarming denied: not landed")
        if self.armed:
            self._disarm("external command")
        return MavResult.ACCEPTED

    def select(self, mode: NavMode) -> MavResult:
        """Select a flight mode."""
        if not self._intention.request(mode, armed=self.armed, conditions=self.conditions):
            return self._reject(self.REFUSED_TEXT and self.REFUSED_TEXT.format(mode=mode.value))
        self._breach_mode = None  # selecting a mode permits flight outside the fence
        self._update_mode()
        return MavResult.ACCEPTED

    def take_off(self, altitude_m: float | None = None) -> MavResult:
        """Take off to a mission altitude."""
        raise NotImplementedError

    def land(self) -> MavResult:
        """Land where the vehicle is."""
        result = self.select(NavMode.LAND)
        if result is MavResult.ACCEPTED:
            self._send_text(self.LAND_TEXT)
        return result

    def go_to(self, position_m: Triple) -> MavResult:
        """Fly to a mission position in offboard, which needs further setpoints; from the ground it takes off."""
        self.receive_setpoint(self.time_s, PositionTarget(position_m))
        return self.select(NavMode.OFFBOARD)

    def receive_setpoint(self, time_s: float, target: PositionTarget) -> None:
        """Take an offboard setpoint that arrived at `time_s`; it acts once the plant's delay has passed."""
        self._received_s = time_s
        self.setpoints_received += 1
        self._pending.append((time_s + self._delay_s, target))

    def receive_heartbeat(self, time_s: float, system_id: int) -> None:
        """Take the heartbeat of another system that arrived at `time_s`."""

    def step(self, to_time_s: float, disturbance_m_s2: tuple[float, float] = (0.0, 0.0)) -> None:
        """Advance in whole steps of STEP_S to `to_time_s`; the disturbance is a horizontal acceleration."""
        disturbance = np.array(disturbance_m_s2)
        while self.time_s + STEP_S <= to_time_s + 1e-9:
            self._apply_due_setpoints()
            self._update_mode()
            if self.armed:
                target = self._guidance.target(self.mode, self._applied, time_s=self.time_s, motors_s=self._armed_s)
                self.airframe.fly(target, disturbance)
                self.battery_fraction = max(0.0, self.battery_fraction - STEP_S / self._endurance_s)
            else:
                self.airframe.fall()
            if self.mount is not None:
                self.mount.step(STEP_S, self.airframe.heading_rad)
            self._steps += 1
            self._watch_take_off()
            self._watch_ground()
            self._watch_fence()
            self._watch_station()

    def _apply_due_setpoints(self) -> None:
        # A setpoint acts from the step nearest to its due time, so that steps do not increase the mean delay.
        while self._pending and self._pending[0][0] <= self.time_s + STEP_S / 2:
            self._applied = self._pending.popleft()[1]
        if self._applied is not None and not self.conditions.setpoints_flow:
            self._applied = None

    def _update_mode(self) -> None:
        flown = self._flown()
        if flown is not self.mode:
            self._guidance.enter(flown, after=self.mode)
            self.mode = flown
            self._on_mode_change()
            if self.failsafe:
                self._send_text("Failsafe activated", Severity.CRITICAL)

    def _watch_take_off(self) -> None:
        # If hold cannot be flown, it continues to hover in take-off.
        arrived = self.mode is NavMode.TAKE_OFF and self._guidance.take_off_complete
        if self.armed and arrived and can_run(NavMode.HOLD, self.conditions):
            self._intention.on_event(ModeEvent.TAKE_OFF_COMPLETE)

    def _watch_ground(self) -> None:
        """Detect lift-off at once, and landing after some time on the ground; then disarm."""
        if not self.airframe.on_ground:
            if self.landed:
                self._send_text(self.TAKE_OFF_TEXT)
            self.landed = False
            self._airborne_s = self.time_s
        elif not self.landed and self.time_s - self._airborne_s >= LANDED_AFTER_S:
            self.landed = True
            self._landed_s = self.time_s
            self._send_text(self.LANDING_TEXT)
        if self.armed and self.landed:
            self._disarm_when_idle()

    def _watch_fence(self) -> None:
        """React once to a fence breach in the air; the mode persists until another one is selected."""
        before, flies = self._breached, self.armed and not self.landed and self.global_position_known
        breach = self._breach() if flies else None
        self._breached = breach is not None
        if breach is not None and not before:
            words, self._breach_mode = breach
            self._send_text(words, Severity.CRITICAL)

    def _watch_station(self) -> None:
        """React to a silent ground station."""

    def _disarm_when_idle(self) -> None:
        flown = self._landed_s > self._armed_s
        if self._disarm_after_s(flown=flown) <= self.time_s - max(self._landed_s, self._armed_s):
            self._disarm("landing" if flown else "auto preflight disarming")

    def _disarm(self, reason: str) -> None:
        self.armed = False
        self._breach_mode = None
        self._on_disarmed()
        self._send_text(self.DISARMED_TEXT.format(reason=reason))

    def _reject(self, why: str | None) -> MavResult:
        self._send_text(why, Severity.CRITICAL)
        return MavResult.REJECTED

    def _send_text(self, text: str | None, severity: Severity = Severity.INFO) -> None:
        if text is not None:
            self._texts.append((severity, text))

    def _on_mode_change(self) -> None:
        """Handle a change of the flown mode: setpoints are kept."""

    def _shape(self) -> ShapeLimits | None:
        """Return the limits of the horizontal motion, if it is limited."""
        return None

    def _on_disarmed(self) -> None:
        """Change to the mode after disarming."""
        self._intention.on_event(ModeEvent.DISARMED)

    def _flown(self) -> NavMode:
        """Return the mode to fly: the user's, or a failsafe's."""
        return self._intention.mode

    def _disarm_after_s(self, *, flown: bool) -> float:
        """Return how long it stays armed on the ground, after a flight or before."""
        raise NotImplementedError

    def _arming_fault(self) -> str | None:
        """Return why the vehicle cannot be armed, or None."""
        raise NotImplementedError

    def _breach(self) -> tuple[str, NavMode | None] | None:
        """Return the text on a breach of the fence, and the mode that it leads to; None without a breach."""
        return None


def autopilot_named(name: AutopilotName) -> type[StubAutopilot]:
    """Return the class of an autopilot; its file has its name."""
    found: type[StubAutopilot] = import_module(f"sitl.autopilot.{name}").AUTOPILOT
    return found
