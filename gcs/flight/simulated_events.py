"""What happens in a simulated flight at given times: absences, operators' commands, disturbances and message loss."""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from math import inf, isfinite
from typing import Any, get_args

import numpy as np

from agents.inputs import Message
from agents.outputs import TickOutput
from agents.team.messages import MISSION_RING, OperatorCommand, RingValues
from agents.team.verbs import CommandVerb
from gcs.console.verb_arguments import given_command
from gcs.errors import InputError
from gcs.mission.mission import Mission
from sitl.simulation.simulation import Absence, NetworkModel, SimulatedVehicle
from sitl.vehicle.plant_step import Pair

_OPERATOR = "event"
"""The name of the operator in commands."""
_ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True)
class Absent:
    """A vehicle without agent from `from_s` until `until_s` of mission time: it leaves the team, or joins it late.

    From 0 on it joins at `until_s`; until infinity it does not come back. Its autopilot holds its place and lands it.
    A new agent begins with the vehicle at rest, at `at_m` (x, y) if given.
    """

    vehicle: int
    from_s: float = 0.0
    until_s: float = inf
    at_m: Pair | None = None


@dataclass(frozen=True, slots=True)
class Commanded:
    """An operator's command at a mission time, as for `cordon command`: "hold", "ring radius=15", "assign 3 left".

    It is for the whole team, or one `vehicle`. Absent vehicles do not receive it.
    """

    at_s: float
    text: str
    vehicle: int | None = None


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A constant acceleration (x, y) [m/s²] on all vehicles, or one, beside the mission's wind."""

    from_s: float
    acceleration_m_s2: Pair
    until_s: float = inf
    vehicle: int | None = None


@dataclass(frozen=True, slots=True)
class MessageLoss:
    """A share of messages that are lost, beside the mission's: of all, or of those from and to one `vehicle`."""

    from_s: float
    loss: float
    until_s: float = inf
    vehicle: int | None = None


SimulationEvent = Absent | Commanded | Disturbance | MessageLoss


@dataclass(frozen=True, slots=True)
class Link:
    """The radio link of two vehicles, both ways: the share of messages that are lost, and its range."""

    loss: float = 0.0
    range_m: float = inf


Links = Mapping[tuple[int, int], Link]
"""The links of a team by pairs of vehicles; pairs that it leaves out have none."""


class SimulatedEvents:
    """The checked events of one flight, and the links of its team; None: all within the mission's range."""

    def __init__(
        self,
        mission: Mission,
        events: Sequence[SimulationEvent] = (),
        links: Links | None = None,
        duration_s: float = inf,
    ) -> None:
        """Check them; raises InputError with every fault."""
        self._mission, self._links = mission, links
        events = [_plain(event) for event in events]
        faults = [fault for event in events for fault in _faults(mission, event, duration_s)]
        faults += _link_faults(mission, links or {})
        if faults:
            raise InputError(faults)
        absent = sorted((each for each in events if isinstance(each, Absent)), key=lambda each: each.from_s)
        faults += _overlaps(absent)
        self.absences = [Absence(each.vehicle, each.from_s, each.until_s, each.at_m) for each in absent]
        commands = sorted((each for each in events if isinstance(each, Commanded)), key=lambda each: each.at_s)
        self.commands = deque(_operator_commands(mission, commands, faults))
        """The commands that are not due yet, in order of mission time."""
        if faults:
            raise InputError(faults)
        self._disturbances = [each for each in events if isinstance(each, Disturbance)]
        self._losses = [each for each in events if isinstance(each, MessageLoss)]
        self._acting: tuple[MessageLoss, ...] = ()
        self.network = self._with_losses(())
        """The network as it is now."""

    def _with_losses(self, losses: Sequence[MessageLoss]) -> NetworkModel:
        network, ids, far_m = self._mission.network, self._mission.ids, self._mission.range_m
        if self._links is None and not losses:
            return NetworkModel(far_m, network.delay_s, network.loss)
        kept = np.full((len(ids), len(ids)), 1.0 - network.loss)
        range_m = np.full_like(kept, far_m if self._links is None else -1.0)
        for pair, link in (self._links or {}).items():
            one, other = map(ids.index, pair)
            for at in ((one, other), (other, one)):
                range_m[at] = min(far_m, link.range_m)
                kept[at] *= 1.0 - link.loss
        for each in losses:
            if each.vehicle is None:
                kept *= 1.0 - each.loss
            else:
                at_vehicle = np.array(ids) == each.vehicle
                kept[at_vehicle[:, None] | at_vehicle] *= 1.0 - each.loss
        return NetworkModel(range_m, network.delay_s, 1.0 - kept)

    def act(self, now_s: float, vehicles: Sequence[SimulatedVehicle[TickOutput]]) -> NetworkModel:
        """Command and disturb the mission's vehicles as it is due at a mission time, and return the network then."""
        while self.commands and self.commands[0].time_s <= now_s + _ROUNDING_S:
            received = Message(now_s, self.commands.popleft())
            for vehicle in vehicles:
                if vehicle.present:
                    vehicle.core.take(received)
        if self._disturbances:
            for vehicle_id, vehicle in zip(self._mission.ids, vehicles, strict=True):
                vehicle.push(self._push_m_s2(vehicle_id, now_s))
        acting = tuple(each for each in self._losses if each.from_s <= now_s < each.until_s)
        if acting != self._acting:
            self.network, self._acting = self._with_losses(acting), acting
        return self.network

    def _push_m_s2(self, vehicle_id: int, now_s: float) -> Pair:
        acting = [
            each.acceleration_m_s2
            for each in self._disturbances
            if each.vehicle in (None, vehicle_id) and each.from_s <= now_s < each.until_s
        ]
        return sum(x for x, _ in acting), sum(y for _, y in acting)


def _plain(event: Any) -> Any:
    """Return an event with Python's own numbers and tuples in place of numpy's: drawn values are often numpy's."""
    if not isinstance(event, SimulationEvent):
        return event
    given = {each.name: getattr(event, each.name) for each in fields(event)}
    return replace(event, **{name: _without_numpy(value) for name, value in given.items()})


def _without_numpy(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = tuple(value)
    if isinstance(value, tuple | list):
        return tuple(map(_without_numpy, value))
    return value.item() if isinstance(value, np.generic) else value


def _faults(mission: Mission, event: object, duration_s: float) -> Iterator[str]:
    """Return the faults of one event, with its own text."""
    if not isinstance(event, SimulationEvent):
        kinds = ", ".join(f"cordon.{each.__name__}" for each in get_args(SimulationEvent))
        yield f"events: {event!r}: give {kinds}"
        return
    if event.vehicle is not None and event.vehicle not in mission.ids:
        yield f"events: {event}: the mission has no vehicle {event.vehicle!r} (it has {_named(mission.ids)})"
    begins_s, ends_s = (event.at_s, inf) if isinstance(event, Commanded) else (event.from_s, event.until_s)
    if not 0.0 <= begins_s <= duration_s:
        yield f"events: {event}: its time must be from 0 to {duration_s:g} s, the duration of the flight"
    if not begins_s < ends_s:
        yield f"events: {event}: until_s must be later than from_s"
    match event:
        case MessageLoss(loss=loss) if not 0.0 <= loss <= 1.0:
            yield f"events: {event}: loss must be from 0 to 1"
        case Disturbance(acceleration_m_s2=(float() | int() as x, float() | int() as y)) if isfinite(x) and isfinite(y):
            pass
        case Disturbance():
            yield f"events: {event}: acceleration_m_s2 must be (x, y), finite numbers"
        case Absent(from_s=0.0, until_s=until_s) if until_s == inf:
            yield f"events: {event}: give from_s for a vehicle that leaves, or until_s for one that joins"


def _overlaps(absent: Sequence[Absent]) -> list[str]:
    """Return the faults of absences of one vehicle, in the order of their times, that overlap."""
    return [
        f"events: {later}: vehicle {later.vehicle} is absent already ({earlier})"
        for earlier, later in combinations(absent, 2)
        if earlier.vehicle == later.vehicle and later.from_s <= earlier.until_s
    ]


def _link_faults(mission: Mission, links: Links) -> Iterator[str]:
    for pair, link in links.items():
        of = f"links: {pair!r}"
        if not (np.shape(pair) == (2,) and pair[0] != pair[1] and {*pair} <= {*mission.ids}):
            yield f"{of}: give two vehicles of the mission (it has {_named(mission.ids)})"
        elif pair[::-1] in links:
            yield f"{of}: a link is for both ways; leave {pair[::-1]!r} out"
        elif not isinstance(link, Link):
            yield f"{of}: {link!r}: give a cordon.Link"
        elif not (0.0 <= link.loss <= 1.0 and link.range_m >= 0.0):
            yield f"{of}: {link}: loss must be from 0 to 1, and range_m not negative"


def _operator_commands(mission: Mission, commands: Sequence[Commanded], faults: list[str]) -> Iterator[OperatorCommand]:
    """Return the commands, in order of time, as vehicles receive them; add what is wrong with them to the faults."""
    flown = [MISSION_RING] * max(len(mission.rings), 1)
    for number, event in enumerate(commands):
        verb, arguments = _parsed(event.text)
        if verb is None:
            faults.append(f"events: {event}: the text must begin with one of {', '.join(get_args(CommandVerb))}")
            continue
        try:
            given = given_command(mission, verb, arguments, event.vehicle)
        except InputError as error:
            faults += [f"events: {event}: {fault}" for fault in error.faults]
            continue
        ring = given.argument if isinstance(given.argument, RingValues) else None
        if ring is not None:
            from gcs.preflight.mission import ring_change_faults  # noqa: PLC0415 - MAVSDK

            at = given.ring_number or 0
            faults += [f"events: {event}: {each}" for each in ring_change_faults(mission, ring, flown, at)]
            flown[at] = flown[at].commanded(ring, event.at_s)
        yield given.command(event.at_s, verb, _OPERATOR, number)


def _parsed(text: str) -> tuple[CommandVerb | None, list[str]]:
    """Return the verb of a command, None if it is unknown, and its arguments."""
    words = text.split()
    return next((each for each in get_args(CommandVerb) if words[:1] == [each]), None), words[1:]


def _named(ids: Sequence[int]) -> str:
    return ", ".join(map(str, ids))
