"""The inputs of a core as text, with times in mission time."""

from collections.abc import Callable, Sequence
from typing import Any

from agents.drops import Drops
from agents.tape import (
    Autopilot,
    Bus,
    Command,
    Computer,
    CoreInput,
    Ground,
    Killed,
    LateTicks,
    Message,
    Presence,
    Start,
    TacticEvent,
    Tick,
    TimeScale,
)
from agents.team.messages import (
    BusMessage,
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    PeerMessage,
    StartProposal,
    TargetPackage,
    VehicleReport,
)
from estimation.state import Sighting, Telemetry

Time = Callable[[float], str]
"""Formats a time on a core's clock."""


def mission_time(time_s: float, start_s: float | None) -> str:
    """Return a time on a core's clock as seconds of the mission; before its start they are negative."""
    return f"{time_s:.3f} s (vehicle clock)" if start_s is None else f"{time_s - start_s:.3f} s"


def input_text(item: CoreInput, time: Time) -> str:
    """Return an input as text."""
    return _FORMATTERS[type(item)](item, time)


def place(values: Sequence[float], digits: int = 2) -> str:
    """Return coordinates as text, (x, y)."""
    return f"({', '.join(f'{round(value, digits) + 0.0:.{digits}f}' for value in values)})"


def _telemetry(item: Telemetry, time: Time) -> str:
    motion = f"position {place(item.position_m, 3)} m, velocity {place(item.velocity_m_s, 3)} m/s"
    return f"telemetry at {time(item.time_s)}: {motion}"


def _sighting(item: Sighting, time: Time) -> str:
    return f"own sighting at {time(item.time_s)}: {_target(item)}"


def _target(item: Sighting | TargetPackage) -> str:
    xx, _, yy = item.covariance_m2
    sigma_m = max(xx, yy, 0.0) ** 0.5
    worth = f"importance {item.importance:.3f}, threat {item.threat:.3f}"
    height = "" if item.altitude_m is None else f"altitude {item.altitude_m:.3f} m (σ {item.altitude_sigma_m:.2f} m), "
    return f"target at {place(item.position_m, 3)} m (σ {sigma_m:.2f} m), {height}{worth}"


def _message(item: Message, time: Time) -> str:
    return f"received at {time(item.now_s)}: {_bus_message(item.message, time)}"


def _bus(item: Bus, _time: Time) -> str:
    return f"bus {'connected' if item.alive else 'lost'}, {'operator' if item.operated else 'no operator'} present"


def _bus_message(message: BusMessage, time: Time) -> str:
    if isinstance(message, OperatorCommand):
        return _command(message)
    return f"vehicle {message.sender} at {time(message.time_s)}: {_peer_message(message)}"


def _peer_message(message: PeerMessage) -> str:
    match message:
        case MemberState():
            where = f"position {place(message.position_m)} m, velocity {place(message.velocity_m_s)} m/s"
            alert = f", alert {message.alert}" if message.alert else ""
            parts = [_peer_message(part) for part in (message.angle, *message.sightings) if part is not None]
            return ", ".join((f"{message.tactic}, {where}{alert}", *parts))
        case NeighbourAngle():
            return f"on the ring, bearing {message.bearing_rad:.3f} rad"
        case TargetPackage():
            return f"sighting: {_target(message)}"
        case StartProposal():
            return "ready to start"
        case CommandAnswer():
            return f"answers command {message.number}: {message.did}"
        case VehicleReport():
            return f"reports mode {message.mode}"


def _command(command: OperatorCommand) -> str:
    receiver = "all vehicles" if command.vehicle is None else f"vehicle {command.vehicle}"
    verb = command.verb if command.shape is None else f"{command.verb} {command.shape}"
    return f"{command.origin} to {receiver}: {verb} (command {command.number})"


def _autopilot(item: Autopilot, _: Time) -> str:
    status = item.status
    facts = (
        "connected" if status.connected else "not connected",
        "armed" if status.armed else "not armed",
        "in the air" if status.in_air else "on the ground",
        f"mode {status.mode.value}",
        "battery unknown" if status.battery is None else f"battery {status.battery:.0%}",
    )
    return f"autopilot: {', '.join(facts)}"


_FORMATTERS: dict[type, Callable[[Any, Time], str]] = {
    TimeScale: lambda item, _: f"time scale {item.factor:g} (mission seconds per wall second)",
    Start: lambda item, time: f"the mission starts at {time(item.at_s)}",
    TacticEvent: lambda item, _: f"tactic event: {item.event.value}",
    Autopilot: _autopilot,
    LateTicks: lambda item, _: f"{item.count} ticks skipped",
    Drops: lambda item, _: f"bus: messages dropped since the start: {item.text() or 'none'}",
    Bus: _bus,
    Computer: lambda item, _: f"computer short of {item.short_of}" if item.short_of else "computer: no shortage",
    Ground: lambda item, _: f"on the ground: {item.lacks or 'ready to start'}",
    Telemetry: _telemetry,
    Sighting: _sighting,
    Message: _message,
    Command: lambda item, time: f"local command at {time(item.now_s)}: {_command(item.command)}",
    Killed: lambda item, _: f"motors: {item.refusal}" if item.refusal else "motors: cut",
    Presence: lambda item, _: f"vehicle {item.vehicle_id} {'joined' if item.present else 'left'} the bus",
    Tick: lambda item, time: f"tick at {time(item.now_s)}",
}
