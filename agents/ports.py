"""The interfaces between an agent and its environment: the vehicle link and the peer bus, as protocols."""

from collections.abc import Callable, Mapping
from enum import Enum
from functools import partial
from math import isfinite
from typing import Protocol

import msgspec

from agents.drops import Drops, Refusals
from agents.team.external_positions import ExternalPosition
from agents.team.messages import Aircraft, AutopilotReport, BusMessage
from estimation.frames import Triple
from estimation.state import Sighting, Telemetry


class FlightMode(Enum):
    """The autopilot's flight mode, as far as an agent distinguishes them."""

    UNKNOWN = "unknown"
    READY = "ready"
    TAKE_OFF = "take-off"
    HOLD = "hold"
    OFFBOARD = "offboard"
    LAND = "land"
    RETURN = "return"
    OTHER = "other"


class GpsThreat(Enum):
    """The autopilot's report of interference with its GPS."""

    NONE = ""
    JAMMED = "jammed"
    SPOOFED = "spoofed"


class Connection(Enum):
    """A connection of the autopilot that its own failsafes watch."""

    NONE = ""
    REMOTE_CONTROL = "remote control"
    GROUND_STATION = "ground station"
    SETPOINTS = "stream of setpoints"


class ModeSource(Enum):
    """Who or what changed the flight mode last, where the autopilot's reports show it."""

    UNKNOWN = ""
    PILOT = "its pilot"
    STATION = "another ground station"
    FAILSAFE = "its autopilot's failsafe"


class Reference(msgspec.Struct, frozen=True):
    """What positions refer to; unknown while the link reads it again.

    `moves` counts moves of the origin in flight, `jumps` jumps of the position alone; the newest: north, east, up.
    """

    is_known: bool = True
    moves: int = 0
    jumps: int = 0
    moved_m: Triple = (0.0, 0.0, 0.0)
    jumped_m: Triple = (0.0, 0.0, 0.0)


class VehicleStatus(AutopilotReport, frozen=True, omit_defaults=False):
    """The status that a vehicle's autopilot reports, except its motion.

    `battery` is a fraction. What is unknown is None, or empty: `endurance_s` is the flight time until the battery is
    empty; `estimator_ratio` its estimator's highest innovation test ratio, that of `estimator_sensor`;
    `estimator_fault` names an invalid output; `height_off_m` is its height above that of `height_sensor` since
    take-off, beyond the sensor's accuracy; `gps_dimensions` the type of fix (0, 2 or 3), with the number of
    `satellites`; `gps_threat` names jamming or spoofing, `lost` the connection whose loss it has reported or which
    explains its failsafe, `mode_by` what changed its flight mode last. `round_trip_s` is the time from a message to its
    answer [s of the mission clock]; `link_fault` describes how the link is degraded, `battery_fault` what the autopilot
    says of a battery, `gimbal_fault` why the gimbal does not follow the mission; `stale` names the repeated reports
    that have stopped. `traffic` are the nearest aircraft outside the vehicle that it receives.
    """

    connected: bool = False
    armed: bool = False
    in_air: bool = False
    mode: FlightMode = FlightMode.UNKNOWN
    local_position_ok: bool = False
    armable: bool = False
    restarts: int = 0
    tilt_deg: int = 0
    estimator_ratio: float | None = None
    height_off_m: float | None = None
    estimator_sensor: str = ""
    estimator_fault: str = ""
    height_sensor: str = ""
    gps_threat: GpsThreat = GpsThreat.NONE
    lost: Connection = Connection.NONE
    round_trip_s: float | None = None
    link_fault: str = ""
    battery_fault: str = ""
    stale: str = ""
    mode_by: ModeSource = ModeSource.UNKNOWN
    reference: Reference = Reference()
    gimbal_fault: str = ""
    traffic: tuple[Aircraft, ...] = ()


class Setpoint(msgspec.Struct, frozen=True):
    """A position setpoint in the mission frame, and the yaw counter-clockwise from its x axis.

    `velocity_m_s` is the velocity (x, y, z) to be fed forward with the position; empty if none is sent. `camera_rad`
    are the elevation above the horizontal and the bearing, as the yaw, that the camera's gimbal is to be sent; empty if
    none is sent. Raises ValueError when a number is not finite: only finite numbers may be sent.
    """

    position_m: Triple
    yaw_rad: float = 0.0
    velocity_m_s: tuple[float, ...] = ()
    camera_rad: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        numbers = *self.position_m, self.yaw_rad, *self.velocity_m_s, *self.camera_rad
        if not all(map(isfinite, numbers)):
            raise ValueError(f"setpoint {', '.join(map(str, numbers))} is not finite")
        if len(self.velocity_m_s) not in (0, 3):
            raise ValueError(f"setpoint velocity {self.velocity_m_s}: it must have three parts, or none")
        if len(self.camera_rad) not in (0, 2):
            raise ValueError(f"camera {self.camera_rad}: it must have elevation and bearing, or none")


class VehicleRefusedError(Exception):
    """A vehicle refused, or failed, to do what the mission needs: the reason, and the next step.

    `clause` is the reason without its `subject`, for a text that names the vehicle itself.
    """

    def __init__(self, clause: str, next_step: str, *, subject: str = "") -> None:
        self.clause, self.subject = clause, subject
        self.reason = f"{subject} {clause}" if subject else clause
        self.next_step = next_step
        super().__init__(f"{self.reason}; {next_step}")

    def __reduce__(self) -> "tuple[Callable[..., VehicleRefusedError], tuple[str, str]]":
        """Return how it is made again in another process: of its parts, not of its text."""
        return partial(type(self), subject=self.subject), (self.clause, self.next_step)


class VehicleLink(Protocol):
    """The link to one vehicle, in mission-frame metres; implementations convert degrees, NED and MAVLink dialects.

    Coroutines raise VehicleRefusedError with the autopilot's text when it refuses or does not answer.
    """

    @property
    def status(self) -> VehicleStatus:
        """The newest status received."""

    async def connect(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        """Find the vehicle, verify its system id, request rates; from then on deliver telemetry on the event loop."""

    async def take_off(self, altitude_m: float) -> None:
        """Arm, climb to `altitude_m` above the mission origin's datum, and return when the vehicle hovers there."""

    async def start_offboard(self) -> None:
        """Enter offboard; setpoints must be streaming. Returns when the flight mode has changed."""

    async def stop_offboard(self) -> None:
        """Leave offboard for hold; returns when the flight mode confirms it."""

    async def catch_up(self) -> None:
        """Wait until the status shows what the calls so far have done, also those that failed or were cancelled."""

    async def land(self) -> None:
        """Land where the vehicle is; returns when it is disarmed."""

    async def kill(self) -> None:
        """Cut the motors at once, in every state and also from a pilot: the vehicle falls. Returns when disarmed."""

    def locate(self, position: ExternalPosition) -> None:
        """Send the vehicle its externally measured position; never blocks, never raises for a lost link."""

    def hand_over(self) -> None:
        """Send nothing from now on and do not change the flight mode: a pilot has control."""

    def take_back(self) -> None:
        """Send setpoints again; offboard has to be started again."""

    def send(self, setpoint: Setpoint) -> None:
        """Send one setpoint now; never blocks, never raises for a lost link."""

    async def close(self) -> None:
        """Release the link, after the calls in progress have ended."""


class PeerBus(Protocol):
    """The bus of a team as one participant uses it: messages to and from the others, and who is present."""

    @property
    def alive(self) -> bool:
        """Whether the local session can still carry messages."""

    @property
    def drops(self) -> Drops:
        """The messages that this process has dropped so far on receipt, and own ones that could not be sent."""

    @property
    def operated(self) -> bool:
        """Whether an operator is present on the bus."""

    @property
    def operators_seen(self) -> int:
        """How often an operator has come so far."""

    @property
    def revoked(self) -> tuple[str, ...]:
        """The common names whose keys were revoked since it was opened: nothing is received from them."""

    @property
    def refusals(self) -> Refusals:
        """What this process has refused so far, by sender."""

    @property
    def heads(self) -> Mapping[str, bytes]:
        """The newest head of an audit log that each vehicle of another process has sent, by its name; not verified."""

    async def open(
        self,
        on_message: Callable[[BusMessage], None],
        on_sensor: Callable[[str, bytes], None],
        on_presence: Callable[[int, bool], None],
    ) -> None:
        """Join; the callbacks run on the event loop.

        They receive: a message of another participant, already checked against the key of its type and sender; the
        topic and payload of a sensor outside the team; another vehicle's id and whether it is present.
        """

    def admit(self, vehicle_id: int) -> None:
        """Receive from now on a vehicle that is not in the mission file; before, only what announces it is."""

    def publish(self, topic: str, payload: bytes) -> None:
        """Send to every other participant under this participant's name; never blocks."""

    async def close(self) -> None:
        """Leave; the others are notified at once."""


class TargetSensor(Protocol):
    """A target sensor on board one vehicle."""

    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        """Return the sightings that are due, of the targets within range of `position_m`."""


class Heartbeat(Protocol):
    """The heartbeat from an agent to the supervisor of its control loop; never blocks, never raises."""

    def rising(self) -> None:
        """Report that the vehicle is about to arm and take off."""

    def tick(self, due_s: float) -> None:
        """Report a tick of the control loop; the next one is due in `due_s` of the wall clock."""

    def ended(self) -> None:
        """Report that the vehicle has landed or was handed over: supervision ends."""
