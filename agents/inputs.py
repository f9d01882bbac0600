"""The inputs of a core: everything that it receives, each a frozen struct that names its topic and describes itself.

A core is deterministic: the same inputs in the same order give the same outputs, bit for bit. Recording a flight is
writing each input before the core takes it (`agents.recording`), a replay is reading each and letting a core take it.
Samples of telemetry, sightings and counts of dropped messages are inputs as well, and are defined where they are made.

Each input has `topic`, the name of its records in a flight log, `lasts`, whether it holds until the next of its kind,
so that only changes are recorded, and `describe`, which returns it as text for the timeline of a replay.
"""

from collections.abc import Callable
from typing import ClassVar

import msgspec

from agents.drops import Drops
from agents.ports import VehicleStatus
from agents.tactics import Event
from agents.team.messages import (
    AddedVehicle,
    BusMessage,
    CommandAnswer,
    MemberState,
    OperatorCommand,
    PeerMessage,
    StartProposal,
    VehicleReport,
)
from estimation.state import Sighting, Telemetry, place_text, target_text

Time = Callable[[float], str]
"""Formats a time on a core's clock."""


class _Input(msgspec.Struct, frozen=True):
    topic: ClassVar[str]
    lasts: ClassVar[bool] = False

    def describe(self, time: Time) -> str:
        """Return it as text."""
        return self._text(time)

    def _text(self, time: Time) -> str:
        raise NotImplementedError


class TimeScale(_Input, frozen=True):
    """Mission seconds per wall second: timeouts of links, which take wall time, are multiplied by it."""

    topic: ClassVar = "time_scale"
    factor: float

    def _text(self, _time: Time) -> str:
        return f"time scale {self.factor:g} (mission seconds per wall second)"


class Start(_Input, frozen=True):
    """The mission begins: the zero of the formation's clock."""

    topic: ClassVar = "start"
    at_s: float

    def _text(self, time: Time) -> str:
        return f"the mission starts at {time(self.at_s)}"


class TacticEvent(_Input, frozen=True):
    """An event from the shell or from an operator at this computer."""

    topic: ClassVar = "event"
    event: Event

    def _text(self, _time: Time) -> str:
        return f"tactic event: {self.event.value}"


class AutopilotStatus(_Input, frozen=True):
    """The autopilot's status."""

    topic: ClassVar = "autopilot"
    lasts: ClassVar = True
    status: VehicleStatus

    def _text(self, _time: Time) -> str:
        status = self.status
        facts = (
            "connected" if status.connected else "not connected",
            "armed" if status.armed else "not armed",
            "in the air" if status.in_air else "on the ground",
            f"mode {status.mode.value}",
            "battery unknown" if status.battery is None else f"battery {status.battery:.0%}",
        )
        return f"autopilot: {', '.join(facts)}"


class LateTicks(_Input, frozen=True):
    """The number of ticks that were skipped before the next one."""

    topic: ClassVar = "late"
    lasts: ClassVar = True
    count: int

    def _text(self, _time: Time) -> str:
        return f"{self.count} ticks skipped"


class Bus(_Input, frozen=True):
    """Whether the session of the bus works, whether an operator is there, and the certificates `revoked` in flight."""

    topic: ClassVar = "bus"
    lasts: ClassVar = True
    alive: bool
    operated: bool = False
    revoked: tuple[str, ...] = ()

    def _text(self, _time: Time) -> str:
        revoked = f", keys revoked: {', '.join(self.revoked)}" if self.revoked else ""
        present = f"{'operator' if self.operated else 'no operator'} present"
        return f"bus {'connected' if self.alive else 'lost'}, {present}{revoked}"


class Computer(_Input, frozen=True):
    """The resource that this computer is short of, empty if none."""

    topic: ClassVar = "computer"
    lasts: ClassVar = True
    short_of: str

    def _text(self, _time: Time) -> str:
        return f"computer short of {self.short_of}" if self.short_of else "computer: no shortage"


class Ground(_Input, frozen=True):
    """The vehicle waits for its start, and what forbids its start, empty if nothing does."""

    topic: ClassVar = "ground"
    start_blockers: str

    def _text(self, _time: Time) -> str:
        return f"on the ground: {self.start_blockers or 'ready to start'}"


class Message(_Input, frozen=True):
    """A message from the bus, the same object for all cores of a process, and the time of its arrival."""

    topic: ClassVar = "message"
    now_s: float
    message: BusMessage

    def _text(self, time: Time) -> str:
        message = self.message
        if isinstance(message, OperatorCommand):
            text = _command_text(message)
        else:
            text = f"vehicle {message.sender} at {time(message.time_s)}: {_message_text(message)}"
        return f"received at {time(self.now_s)}: {text}"


class Command(_Input, frozen=True):
    """A command of an operator at this computer, and its time: it acts at once, and the next tick answers it."""

    topic: ClassVar = "command"
    now_s: float
    command: OperatorCommand

    def _text(self, time: Time) -> str:
        return f"local command at {time(self.now_s)}: {_command_text(self.command)}"


class Killed(_Input, frozen=True):
    """The outcome of cutting the motors, and its time: why it failed, empty if it did not."""

    topic: ClassVar = "killed"
    now_s: float
    refusal: str

    def _text(self, _time: Time) -> str:
        return f"motors: {self.refusal}" if self.refusal else "motors: cut"


class Rejoined(_Input, frozen=True):
    """What became of a command to rejoin, and its time: why it was refused, empty if the vehicle takes off again.

    A core whose vehicle takes off again begins anew: it keeps what operators have commanded, and nothing else.
    """

    topic: ClassVar = "rejoined"
    now_s: float
    refusal: str

    def _text(self, _time: Time) -> str:
        return f"rejoin: {self.refusal}" if self.refusal else "rejoin: another flight begins"


class VehicleJoins(_Input, frozen=True):
    """A vehicle that is not in the mission file would join the flight: it is a member from now on, unless the core
    refuses it.
    """

    topic: ClassVar = "added"
    vehicle_id: int
    vehicle: AddedVehicle

    def _text(self, _time: Time) -> str:
        return f"vehicle {self.vehicle_id} would join, with its start at {place_text(self.vehicle.start_m)} m"


class Presence(_Input, frozen=True):
    """A peer has joined or left the bus."""

    topic: ClassVar = "presence"
    vehicle_id: int
    present: bool

    def _text(self, _time: Time) -> str:
        return f"vehicle {self.vehicle_id} {'joined' if self.present else 'left'} the bus"


class Lying(_Input, frozen=True):
    """Another vehicle of the mission lies on the ground at a place, disarmed, and sends no states."""

    topic: ClassVar = "lying"
    vehicle_id: int
    position_m: tuple[float, float]

    def _text(self, _time: Time) -> str:
        return f"vehicle {self.vehicle_id} lies on the ground at {place_text(self.position_m)} m"


class Tick(_Input, frozen=True):
    """When a step of the control loop began."""

    topic: ClassVar = "tick"
    now_s: float

    def _text(self, time: Time) -> str:
        return f"tick at {time(self.now_s)}"


ReceivedInput = (
    TimeScale
    | Start
    | TacticEvent
    | AutopilotStatus
    | LateTicks
    | Bus
    | Drops
    | Computer
    | Ground
    | Telemetry
    | Sighting
    | Message
    | Command
    | Killed
    | Rejoined
    | VehicleJoins
    | Presence
    | Lying
)
"""What a core takes between two ticks."""
CoreInput = ReceivedInput | Tick
"""The same, and the ticks."""


def _message_text(message: PeerMessage) -> str:
    match message:
        case MemberState():
            where = f"position {place_text(message.position_m)} m, velocity {place_text(message.velocity_m_s)} m/s"
            alert = f", alert {message.alert}" if message.alert else ""
            ring = [f"on the ring, bearing {message.angle.bearing_rad:.3f} rad"] if message.angle is not None else []
            seen = [f"sighting: {target_text(each)}" for each in message.sightings]
            return ", ".join((f"{message.tactic}, {where}{alert}", *ring, *seen))
        case StartProposal():
            return "ready to start"
        case CommandAnswer():
            return f"answers command {message.number}: {message.did}"
        case VehicleReport():
            return f"reports mode {message.mode}"


def _command_text(command: OperatorCommand) -> str:
    receiver = "all vehicles" if command.vehicle is None else f"vehicle {command.vehicle}"
    verb = f"{command.verb} {command.argument}".rstrip()
    return f"{command.origin} to {receiver}: {verb} (command {command.number})"
