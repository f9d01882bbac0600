"""What goes into a core, in people's words and in mission time."""

from collections.abc import Callable, Sequence
from typing import Any

from agents.tape import (
    Autopilot,
    Bus,
    Command,
    CoreInput,
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
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    PeerMessage,
    StartProposal,
    TargetPackage,
    decode,
)
from estimation.state import Sighting, Telemetry

Time = Callable[[float], str]
"""Says a time on a core's clock."""


def mission_time(time_s: float, start_s: float | None) -> str:
    """Return a time on a core's clock as seconds of the mission; before its start they are negative."""
    return f"{time_s:.3f} s on its clock" if start_s is None else f"{time_s - start_s:.3f} s"


def input_words(item: CoreInput, time: Time) -> str:
    """Return an input in people's words."""
    return _WORDS[type(item)](item, time)


def place(values: Sequence[float], digits: int = 2) -> str:
    """Return coordinates as people write them."""
    return f"({', '.join(f'{round(value, digits) + 0.0:.{digits}f}' for value in values)})"


def _telemetry(item: Telemetry, time: Time) -> str:
    motion = f"at {place(item.position_m, 3)} m, flying {place(item.velocity_m_s, 3)} m/s"
    return f"telemetry of {time(item.time_s)}: {motion}"


def _sighting(item: Sighting, time: Time) -> str:
    return f"own sighting of {time(item.time_s)}: {_target(item)}"


def _target(item: Sighting | TargetPackage) -> str:
    xx, _, yy = item.covariance_m2
    spread_m = max(xx, yy, 0.0) ** 0.5
    worth = f"importance {item.importance:.3f}, threat {item.threat:.3f}"
    height = "" if item.altitude_m is None else f"altitude {item.altitude_m:.3f} m, to {item.altitude_sigma_m:.2f} m, "
    return f"target at {place(item.position_m, 3)} m, to {spread_m:.2f} m, {height}{worth}"


def _message(item: Message, time: Time) -> str:
    return f"heard at {time(item.now_s)}: {_said(item.payload, time)}"


def _said(payload: bytes, time: Time) -> str:
    try:
        message = decode(payload)
    except ValueError as error:
        return f"{len(payload)} bytes that are no message: {error}"
    if isinstance(message, OperatorCommand):
        return _order(message)
    return f"vehicle {message.sender} of {time(message.time_s)}: {_news(message)}"


def _news(message: PeerMessage) -> str:
    match message:
        case MemberState():
            where = f"at {place(message.position_m)} m, flying {place(message.velocity_m_s)} m/s"
            alert = f", alert {message.alert}" if message.alert else ""
            return f"{message.tactic}, {where}{alert}"
        case NeighbourAngle():
            return f"on the ring at {message.bearing_rad:.3f} rad"
        case TargetPackage():
            return f"sighted: {_target(message)}"
        case StartProposal():
            return "it is there"
        case CommandAnswer():
            return f"answers command {message.number}: {message.did}"


def _order(command: OperatorCommand) -> str:
    whom = "all vehicles" if command.vehicle is None else f"vehicle {command.vehicle}"
    return f"{command.origin} tells {whom}: {_verb(command)} (command {command.number})"


def _verb(command: OperatorCommand) -> str:
    return command.verb if command.shape is None else f"{command.verb} {command.shape}"


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


_WORDS: dict[type, Callable[[Any, Time], str]] = {
    TimeScale: lambda item, _: f"what comes over links may take {item.factor:g} times as long",
    Start: lambda item, time: f"the mission starts at {time(item.at_s)}",
    TacticEvent: lambda item, _: f"its shell says: {item.event.value}",
    Autopilot: _autopilot,
    LateTicks: lambda item, _: f"{item.count} ticks were skipped",
    Bus: lambda item, _: "the bus works" if item.alive else "the bus does not work",
    Telemetry: _telemetry,
    Sighting: _sighting,
    Message: _message,
    Command: lambda item, time: f"told at {time(item.now_s)}: {_order(item.command)}",
    Killed: lambda item, _: f"motors: {item.refusal}" if item.refusal else "motors: cut",
    Presence: lambda item, _: f"vehicle {item.vehicle_id} has {'come' if item.present else 'gone'}",
    Tick: lambda item, time: f"tick at {time(item.now_s)}",
}
