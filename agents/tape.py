"""The tape of a core: a record of all its inputs and outputs, which can be played to another core.

A core is deterministic: the same calls in the same order give the same outputs, bit for bit. A tape of its calls is
therefore sufficient to replay a flight. Each call is one item; `play` makes the call again.
"""

from collections.abc import Callable
from typing import Any, Protocol

import msgspec

from agents.core import VehicleCore
from agents.drops import NO_DROPS, Drops
from agents.outputs import TickOutput
from agents.ports import VehicleStatus
from agents.settings.config import AgentConfig
from agents.tactics import Event
from agents.team.messages import BusMessage, OperatorCommand
from estimation.state import Sighting, Telemetry


class TimeScale(msgspec.Struct, frozen=True):
    """`set_time_scale`: mission seconds per wall second."""

    factor: float


class Start(msgspec.Struct, frozen=True):
    """`start`: the mission begins."""

    at_s: float


class TacticEvent(msgspec.Struct, frozen=True):
    """`on_event`: an event from the shell or from an operator at this computer."""

    event: Event


class Autopilot(msgspec.Struct, frozen=True):
    """`on_vehicle`: the autopilot's status; recorded when it has changed."""

    status: VehicleStatus


class LateTicks(msgspec.Struct, frozen=True):
    """`on_loop`: the number of skipped ticks; recorded when it has changed."""

    count: int


class Bus(msgspec.Struct, frozen=True):
    """`on_bus`: whether the bus works, and whether an operator is on it; recorded when that has changed."""

    alive: bool
    operated: bool = False


class Computer(msgspec.Struct, frozen=True):
    """`on_computer`: the resource that the computer is short of; recorded when it has changed."""

    short_of: str


class Ground(msgspec.Struct, frozen=True):
    """`on_ground`: the vehicle waits for its start, and what forbids the start."""

    lacks: str


class Message(msgspec.Struct, frozen=True):
    """`on_message`: a message from the bus, the same object for all cores of a process, and its time."""

    now_s: float
    message: BusMessage


class Command(msgspec.Struct, frozen=True):
    """`on_command`: a command of an operator at this computer, and its time."""

    now_s: float
    command: OperatorCommand


class Killed(msgspec.Struct, frozen=True):
    """`on_killed`: the outcome of cutting the motors."""

    now_s: float
    refusal: str


class Presence(msgspec.Struct, frozen=True):
    """`on_presence`: a peer has joined or left the bus."""

    vehicle_id: int
    present: bool


class Tick(msgspec.Struct, frozen=True):
    """`tick`: when a step of the control loop began."""

    now_s: float


CoreInput = (
    TimeScale
    | Start
    | TacticEvent
    | Autopilot
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
    | Presence
    | Tick
)


class Tape(Protocol):
    """Records a core's inputs and outputs in order; never blocks, never raises."""

    def write(self, item: CoreInput | TickOutput) -> None:
        """Take the next item; a tick's output follows the tick."""
        ...


class TapedCore(VehicleCore):
    """A core that writes every call to a tape before it executes it."""

    def __init__(self, config: AgentConfig, tape: Tape) -> None:
        super().__init__(config)
        self._write = tape.write
        self._autopilot: VehicleStatus | None = None
        self._late_ticks = 0
        self._bus = Bus(alive=True)
        self._bus_drops_taped = NO_DROPS
        self._short_of = ""

    def set_time_scale(self, factor: float) -> None:
        """See VehicleCore."""
        self._write(TimeScale(factor))
        super().set_time_scale(factor)

    def start(self, at_s: float) -> None:
        """See VehicleCore."""
        self._write(Start(at_s))
        super().start(at_s)

    def on_event(self, event: Event) -> None:
        """See VehicleCore."""
        self._write(TacticEvent(event))
        super().on_event(event)

    def on_vehicle(self, status: VehicleStatus) -> None:
        """See VehicleCore."""
        if status is not self._autopilot and status != self._autopilot:
            self._autopilot = status
            self._write(Autopilot(status))
        super().on_vehicle(status)

    def on_loop(self, late_ticks: int) -> None:
        """See VehicleCore."""
        if late_ticks != self._late_ticks:
            self._late_ticks = late_ticks
            self._write(LateTicks(late_ticks))
        super().on_loop(late_ticks)

    def on_bus(self, alive: bool, operated: bool = False) -> None:
        """See VehicleCore."""
        if (bus := Bus(alive, operated)) != self._bus:
            self._bus = bus
            self._write(bus)
        super().on_bus(alive, operated)

    def on_drops(self, drops: Drops) -> None:
        """See VehicleCore."""
        if drops != self._bus_drops_taped:
            self._bus_drops_taped = drops
            self._write(drops)
        super().on_drops(drops)

    def on_computer(self, short_of: str) -> None:
        """See VehicleCore."""
        if short_of != self._short_of:
            self._short_of = short_of
            self._write(Computer(short_of))
        super().on_computer(short_of)

    def on_ground(self, lacks: str) -> None:
        """See VehicleCore."""
        self._write(Ground(lacks))
        super().on_ground(lacks)

    def on_telemetry(self, telemetry: Telemetry) -> None:
        """See VehicleCore."""
        self._write(telemetry)
        super().on_telemetry(telemetry)

    def on_sighting(self, sighting: Sighting) -> None:
        """See VehicleCore."""
        self._write(sighting)
        super().on_sighting(sighting)

    def on_message(self, message: BusMessage, now_s: float) -> None:
        """See VehicleCore."""
        self._write(Message(now_s, message))
        super().on_message(message, now_s)

    def on_command(self, command: OperatorCommand, now_s: float) -> None:
        """See VehicleCore."""
        self._write(Command(now_s, command))
        super().on_command(command, now_s)

    def on_killed(self, refusal: str, now_s: float) -> None:
        """See VehicleCore."""
        self._write(Killed(now_s, refusal))
        super().on_killed(refusal, now_s)

    def on_presence(self, vehicle_id: int, present: bool) -> None:
        """See VehicleCore."""
        self._write(Presence(vehicle_id, present))
        super().on_presence(vehicle_id, present)

    def tick(self, now_s: float) -> TickOutput:
        """See VehicleCore."""
        self._write(Tick(now_s))
        output = super().tick(now_s)
        self._write(output)
        return output


def play(core: VehicleCore, item: CoreInput) -> TickOutput | None:
    """Pass an input from a tape to a core; return the output of a tick, None for other inputs."""
    if isinstance(item, Tick):
        return core.tick(item.now_s)
    _CALLS[type(item)](core, item)
    return None


_CALLS: dict[type, Callable[[VehicleCore, Any], object]] = {
    TimeScale: lambda core, item: core.set_time_scale(item.factor),
    Start: lambda core, item: core.start(item.at_s),
    TacticEvent: lambda core, item: core.on_event(item.event),
    Autopilot: lambda core, item: core.on_vehicle(item.status),
    LateTicks: lambda core, item: core.on_loop(item.count),
    Bus: lambda core, item: core.on_bus(item.alive, item.operated),
    Drops: lambda core, item: core.on_drops(item),
    Computer: lambda core, item: core.on_computer(item.short_of),
    Ground: lambda core, item: core.on_ground(item.lacks),
    Telemetry: lambda core, item: core.on_telemetry(item),
    Sighting: lambda core, item: core.on_sighting(item),
    Message: lambda core, item: core.on_message(item.message, item.now_s),
    Command: lambda core, item: core.on_command(item.command, item.now_s),
    Killed: lambda core, item: core.on_killed(item.refusal, item.now_s),
    Presence: lambda core, item: core.on_presence(item.vehicle_id, item.present),
}
