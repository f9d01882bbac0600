"""The seams between an agent and the world: the vehicle link and the peer bus, as protocols."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import isfinite
from typing import Protocol

import msgspec

from agents.drops import Drops
from agents.team.external_positions import ExternalPosition
from agents.team.messages import BusMessage
from estimation.frames import Triple
from estimation.state import Sighting, Telemetry


class FlightMode(Enum):
    """The autopilot's flight mode, as far as an agent has to tell them apart."""

    UNKNOWN = "unknown"
    READY = "ready"
    TAKE_OFF = "take-off"
    HOLD = "hold"
    OFFBOARD = "offboard"
    LAND = "land"
    RETURN = "return"
    OTHER = "other"


class GpsThreat(Enum):
    """What the autopilot reports of the signals of its GPS."""

    NONE = ""
    JAMMED = "jammed"
    SPOOFED = "spoofed"


class Connection(Enum):
    """A connection of the autopilot that its own failsafes watch."""

    NONE = ""
    REMOTE_CONTROL = "remote control"
    GROUND_STATION = "ground station"


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """What a vehicle's autopilot says about itself beside its motion.

    `battery` is a fraction, None if unknown; `restarts` counts how often the autopilot has started anew. What the
    autopilot does not report is None, or empty: `endurance_s` is its own estimate of the flight time until the battery
    is empty; `tilt_deg` is that of its attitude; `estimator_ratio` is the highest innovation test ratio of its
    estimator (above 1 the sensor is rejected), that of `estimator_sensor`, and `estimator_fault` names what it lacks;
    `gps_dimensions` is that of the fix (0 without one, 2 or 3) from so many `satellites`, and `gps_threat` names
    jamming or spoofing; `lost` names the connection whose loss it has reported; `wind_m_s` is the horizontal wind that
    its estimator takes to blow. `round_trip_s` is the time from a message to its answer [s of the mission clock],
    and `link_fault` how the link falls short.
    """

    connected: bool = False
    armed: bool = False
    in_air: bool = False
    mode: FlightMode = FlightMode.UNKNOWN
    battery: float | None = None
    local_position_ok: bool = False
    armable: bool = False
    restarts: int = 0
    endurance_s: float | None = None
    tilt_deg: int = 0
    estimator_ratio: float | None = None
    estimator_sensor: str = ""
    estimator_fault: str = ""
    gps_dimensions: int | None = None
    satellites: int | None = None
    gps_threat: GpsThreat = GpsThreat.NONE
    lost: Connection = Connection.NONE
    wind_m_s: float | None = None
    round_trip_s: float | None = None
    link_fault: str = ""


class Setpoint(msgspec.Struct, frozen=True):
    """A position setpoint in the mission frame, and the yaw counter-clockwise from its x axis.

    `velocity_m_s` is the velocity (x, y, z) that goes with the position, to be fed forward; empty where none is sent.
    Raises ValueError when a number is not finite: nothing else may reach a wire.
    """

    position_m: Triple
    yaw_rad: float = 0.0
    velocity_m_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not all(map(isfinite, (*self.position_m, self.yaw_rad, *self.velocity_m_s))):
            raise ValueError(f"setpoint {self.position_m}, {self.yaw_rad}, {self.velocity_m_s} is not finite")
        if len(self.velocity_m_s) not in (0, 3):
            raise ValueError(f"setpoint velocity {self.velocity_m_s}: it must have three parts, or none")


class VehicleRefusedError(Exception):
    """A vehicle cannot or will not do what the mission needs: the reason, and what to do next."""

    def __init__(self, reason: str, next_step: str) -> None:
        super().__init__(f"{reason}; {next_step}")
        self.reason = reason
        self.next_step = next_step


class VehicleLink(Protocol):
    """One vehicle, in mission-frame metres: degrees, NED and the autopilot's dialect stop behind this seam.

    Coroutines raise VehicleRefusedError with the autopilot's own words when it refuses or does not answer.
    """

    @property
    def status(self) -> VehicleStatus:
        """The newest status heard."""
        ...

    async def connect(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        """Find the vehicle, verify its system id, request rates; from now on deliver telemetry on the event loop."""
        ...

    async def take_off(self, altitude_m: float) -> None:
        """Arm, climb to `altitude_m` above the mission origin's datum, and return when the vehicle hovers there."""
        ...

    async def start_offboard(self) -> None:
        """Enter offboard; setpoints must be flowing. Returns when the flight mode, not the acknowledgement, says so."""
        ...

    async def stop_offboard(self) -> None:
        """Leave offboard into hold; returns when the flight mode says so."""
        ...

    async def land(self) -> None:
        """Land where the vehicle is; returns when it is disarmed."""
        ...

    async def kill(self) -> None:
        """Cut the motors now, wherever the vehicle is and whoever has it: it falls. Returns when it is disarmed."""
        ...

    def locate(self, position: ExternalPosition) -> None:
        """Pass on where the vehicle is as seen from outside; never blocks, never raises for a lost link."""
        ...

    def hand_over(self) -> None:
        """Send nothing from now on, and leave the flight mode alone: a pilot has the vehicle."""
        ...

    def take_back(self) -> None:
        """Let setpoints through again; offboard has to be started anew."""
        ...

    def send(self, setpoint: Setpoint) -> None:
        """Send one setpoint now; never blocks, never raises for a lost link."""
        ...

    async def close(self) -> None:
        """Release the link; calls in flight are drained first."""
        ...


class PeerBus(Protocol):
    """The bus of a team as one participant uses it: messages to and from the others, and who is present."""

    @property
    def alive(self) -> bool:
        """Whether it can still carry messages, as far as this end knows."""
        ...

    @property
    def drops(self) -> Drops:
        """The messages that this process has dropped so far on receipt, and own ones that could not be sent."""
        ...

    @property
    def operated(self) -> bool:
        """Whether an operator is on the bus, as far as this end knows."""
        ...

    async def open(
        self,
        on_message: Callable[[BusMessage], None],
        on_sensor: Callable[[str, bytes], None],
        on_presence: Callable[[int, bool], None],
    ) -> None:
        """Join; the callbacks run on the event loop.

        They take a message of another participant, which came on the key of its type and its sender; the topic and the
        payload of a sensor outside the team; another vehicle's id and whether it is present.
        """
        ...

    def publish(self, topic: str, payload: bytes) -> None:
        """Send to every other participant, under the own name; never blocks."""
        ...

    async def close(self) -> None:
        """Leave; the others see it at once."""
        ...


class TargetSensor(Protocol):
    """A sensor of the target that travels with one vehicle."""

    def sight(self, now_s: float, position_m: tuple[float, float]) -> Sighting | None:
        """Return a sighting when one is due and the target is within range of `position_m`."""
        ...


class Heartbeat(Protocol):
    """What an agent shows to whoever watches its control loop from outside; never blocks, never raises."""

    def rising(self) -> None:
        """Tell that the vehicle is about to arm and take off."""
        ...

    def tick(self, due_s: float) -> None:
        """Tell that the control loop has ticked; its next tick is due in `due_s` of the wall clock."""
        ...

    def ended(self) -> None:
        """Tell that the vehicle is down, or handed over: nobody needs to watch it any more."""
        ...
