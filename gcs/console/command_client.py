"""Client that sends commands and sightings to a running team over its bus, and collects the answers.

A command that does not depend on the mission's content, such as hold and kill, is sent at once and repeated: no
message of one vehicle, and no silence, keeps it from the others.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from random import randrange
from statistics import median_low
from time import monotonic
from typing import Literal

import msgspec

from agents.ports import VehicleRefusedError
from agents.settings.shapes import Shape
from agents.team.messages import (
    TIME_MAX_S,
    BusMessage,
    CommandAnswer,
    CommandedRing,
    CommandKey,
    Goal,
    MemberState,
    OperatorCommand,
    RingValues,
    StartProposal,
    VehicleReport,
)
from agents.team.perception import TOPIC, ExternalSighting, encode_sighting
from agents.team.verbs import VERBS, Verb
from gcs.console.rings import CommandedRings, commanded_rings, newest_commanded
from gcs.console.team_bus import guest_bus, send_command
from gcs.console.team_state import TeamMissions
from gcs.console.verb_arguments import GivenCommand
from gcs.errors import InputError
from gcs.keys.identity import Identity
from gcs.keys.team_keys import team_keys
from gcs.mission.mission import Mission

_RECEIVED_TIMEOUT_S = 3.0
_MISSION_TIMEOUT_S = 0.5
"""Wait for a vehicle's mission before a command that does not depend on its content: one that names the mission of
another team is refused, if every vehicle has told by then that it flies another one.
"""
_ALL_RECEIVED_TIMEOUT_S = 0.5
"""Wait for the other vehicles after the first message from one: a dead vehicle must not delay a command."""
_ANSWER_TIMEOUT_S = 4.0
_DONE_TIMEOUT_S = 12.0
"""For a second answer: a heartbeat (1 Hz) confirms that a vehicle is disarmed, and an agent repeats a failed kill."""
_LAST_ANSWER_TIMEOUT_S = 1.0
"""Wait for the second answer of a vehicle whose flight has ended: the report of the end may arrive before it."""
_POLL_S = 0.005
_REPEAT_S = 0.1
_SIGHTING_PERIOD_S = 0.5
_CLOCK_AGE_MAX_S = 1.0
"""A vehicle's clock is ignored once its last message is this much older than the newest of the team [wall s]."""


@dataclass(frozen=True, slots=True)
class CommandResult:
    """A vehicle's answer to a command, and its reception after the first transmission to a vehicle [wall s]."""

    did: str
    after_s: float
    obeyed: bool
    """Whether the vehicle carries out the command."""
    is_final: bool


OnAnswer = Callable[[int, CommandResult], None]
"""Called with each new answer of a vehicle."""
RingFaults = Callable[[Sequence[CommandedRing]], Sequence[str]]
"""Returns why a command of the ring must not be sent to a team, from the values that were commanded before."""


@dataclass(slots=True)
class _Sent:
    """A command under way: when it was first sent to a vehicle [wall s], and each vehicle's latest answer."""

    first_s: float
    on_answer: OnAnswer
    awaits_landed: bool = False
    """Whether vehicles whose flight has ended answer."""
    answers: dict[int, CommandResult] = field(default_factory=dict)

    def is_done(self, vehicle: int) -> bool:
        """Return whether a vehicle has sent its final answer."""
        return vehicle in self.answers and self.answers[vehicle].is_final

    def receive(self, message: CommandAnswer) -> None:
        """Store an answer; answers are repeated on the bus."""
        before = self.answers.get(message.sender)
        if before is None or (before.did != message.did and message.is_final >= before.is_final):
            answer = CommandResult(message.did, monotonic() - self.first_s, message.is_obeyed, message.is_final)
            self.answers[message.sender] = answer
            self.on_answer(message.sender, answer)


class CommandClient:
    """Sends commands and sightings to the vehicles of one mission.

    From `open` to `close` it stays on the team's bus and sends commands without delay, several at a time. Otherwise it
    joins the bus for one command or sighting, and leaves it. It can be opened once.
    """

    def __init__(
        self,
        mission: Mission,
        identity: Identity | None = None,
        on_message: Callable[[BusMessage], None] = lambda _message: None,
    ) -> None:
        """Take the identity to send as: a sensor or an operator, by default the operator whose keys are here.

        `on_message` is called with every message on the bus.

        Raises InputError without keys, VehicleRefusedError if no flight runs.
        """
        self._identity = identity or team_keys(mission).identity("operator")
        self._bus = guest_bus(mission, self._identity)
        self._vehicles, self._ring_count = mission.ids, max(1, len(mission.rings))
        self._clocks = TeamClock()
        self._missions = TeamMissions(mission)
        self._on_message = on_message
        self.present: set[int] = set()
        """The vehicles on the bus."""
        self._sent: dict[CommandKey, _Sent] = {}
        self._is_open = False
        self._first_message_s: float | None = None
        self._rings: dict[int, CommandedRings] = {}
        self.tactics: dict[int, str] = {}
        """The latest tactic received from each vehicle."""
        self.ended: dict[int, str] = {}
        """How the flights of vehicles have ended: they answer no more."""
        self.in_reserve: set[int] = set()
        """Those of them that stay on the ground in reserve, and have not flown."""
        self._ended_s: dict[int, float] = {}
        """When each of these ends was received [wall s]."""
        self.joined_after_s = 0.0
        """Time to join the bus and to receive the vehicles, before the first transmission [wall s]."""

    async def open(self) -> None:
        """Join the bus until `close`; raises VehicleRefusedError if that is not possible."""
        await self._bus.open(self._receive, lambda *_: None, self._on_presence)
        self._is_open = True

    async def close(self) -> None:
        """Leave the bus."""
        self._is_open = False
        await self._bus.close()

    async def command(
        self,
        verb: Verb,
        vehicles: Collection[int],
        vehicle: int | None,
        argument: Shape | RingValues | Goal | None = None,
        on_answer: OnAnswer = lambda _vehicle, _answer: None,
        number: int | None = None,
        ring_faults: RingFaults = lambda _flown: (),
        ring_number: int | None = None,
    ) -> dict[int, CommandResult | None]:
        """Send a command to one vehicle, or to all (None); return each vehicle's answer, None after a timeout.

        Of all, those whose flight has ended are not waited for, and not in the result. `number` is that of a command
        that vehicles have received elsewhere already, None of a new one. `ring_faults` checks a command of the ring.
        In a mission of several rings `ring_number` is that of the ring that is changed or assigned; None assigns none.

        Raises VehicleRefusedError if no vehicle of the team is on the bus, or the team flies another mission;
        InputError if the ring has faults.
        """
        async with self._joined():
            if VERBS[verb].needs_mission:
                await self._wait_for_team(vehicles, verb)
                if isinstance(argument, RingValues):
                    await self._require_ring(vehicles, ring_faults)
            else:
                await self._until(lambda: self._missions.is_same or self._missions.is_other, _MISSION_TIMEOUT_S)
                self._missions.refuse_other()
            number = randrange(2**32) if number is None else number
            given = GivenCommand(argument, ring_number, vehicle)
            command = given.command(0.0, verb, self._identity.participant.name, number)
            sent = self._sent[command.key] = _Sent(monotonic(), on_answer, VERBS[verb].is_for_landed)
            try:
                await self._repeat(command, sent, vehicles)
            finally:
                del self._sent[command.key]
            self._require_any()
            asked = [each for each in vehicles if vehicle == each or each in sent.answers or each not in self.ended]
            return {each: sent.answers.get(each) for each in asked}

    async def _repeat(self, command: OperatorCommand, sent: _Sent, vehicles: Collection[int]) -> None:
        """Send a command until every vehicle has answered it or its time is over."""
        began_s = latest_s = monotonic() - _REPEAT_S
        timeout_s = _DONE_TIMEOUT_S if VERBS[command.verb].done else _ANSWER_TIMEOUT_S
        while not all(sent.is_done(each) or self._answers_no_more(each, sent) for each in vehicles):
            now_s = monotonic()
            if self._first_message_s is None:
                sent.first_s = now_s
            if now_s - began_s > (_RECEIVED_TIMEOUT_S if self._first_message_s is None else timeout_s):
                break
            if now_s - latest_s >= _REPEAT_S:
                latest_s = now_s
                times_s = self._clocks.times_s(now_s)
                send_command(self._bus, msgspec.structs.replace(command, time_s=self._team_s, times_s=times_s))
            await asyncio.sleep(_POLL_S)

    def _answers_no_more(self, vehicle: int, sent: _Sent) -> bool:
        """Return whether a vehicle's flight has ended and no last answer of it can be on its way."""
        if vehicle not in self.ended:
            return False
        if sent.awaits_landed:
            return False
        return vehicle not in sent.answers or monotonic() - self._ended_s[vehicle] > _LAST_ANSWER_TIMEOUT_S

    async def send_sighting(self, sighting: ExternalSighting, lasting_s: float) -> Collection[int]:
        """Send a sighting of the target to the team repeatedly for `lasting_s`; return the vehicles on the bus.

        Raises VehicleRefusedError if no vehicle of the team is on the bus, or the team flies another mission.
        """
        async with self._joined():
            await self._wait_for_team(self._vehicles, "target")
            end_s = monotonic() + lasting_s
            while True:
                # Sent twice against loss: vehicles ignore a second sighting of the same time and source.
                payload = encode_sighting(msgspec.structs.replace(sighting, time_s=self._team_s))
                for _ in range(2):
                    self._bus.publish(TOPIC, payload)
                    await asyncio.sleep(_REPEAT_S)
                if monotonic() >= end_s:
                    return self._clocks.members | self.present
                await asyncio.sleep(_SIGHTING_PERIOD_S - 2.0 * _REPEAT_S)

    @asynccontextmanager
    async def _joined(self) -> AsyncIterator[None]:
        """Join the bus; leave it afterwards unless it was open before."""
        stays, began_s = self._is_open, monotonic()
        try:
            if not stays:
                await self.open()
            self.joined_after_s = monotonic() - began_s
            yield
        finally:
            if not stays:
                await self.close()

    async def _wait_for_team(self, vehicles: Collection[int], verb: str) -> None:
        """Wait for these vehicles and for one that flies the mission on which a command or sighting depends."""
        await self._until(lambda: self._first_message_s is not None, _RECEIVED_TIMEOUT_S)
        first_s = self._require_any()
        await self._until(lambda: self._missions.is_same or self._missions.is_other, _RECEIVED_TIMEOUT_S)
        self._missions.require_version(verb)
        rest_s = first_s + _ALL_RECEIVED_TIMEOUT_S - monotonic()
        await self._until(lambda: self._clocks.members >= set(vehicles), rest_s)

    async def _require_ring(self, vehicles: Collection[int], ring_faults: RingFaults) -> None:
        """Raise InputError if a command has faults where the team flies the ring that was commanded last."""
        await self._until(lambda: self._rings.keys() >= {*vehicles} - self.ended.keys(), _ALL_RECEIVED_TIMEOUT_S)
        if faults := await asyncio.to_thread(ring_faults, self.commanded_rings):
            raise InputError(faults)

    def _require_any(self) -> float:
        """Return when the first vehicle was received [wall s]; raise VehicleRefusedError if none was."""
        if self._first_message_s is None:
            raise VehicleRefusedError(
                f"no vehicle found on the bus within {_RECEIVED_TIMEOUT_S:g} s",
                "check that the team is running, and that --mission names its mission",
            )
        return self._first_message_s

    @property
    def commanded_rings(self) -> list[CommandedRing]:
        """The values of the mission's rings, in order, that operators commanded last, by the team's states."""
        flying = [rings for vehicle, rings in self._rings.items() if vehicle not in self.ended]
        return [newest_commanded(flying, number) for number in range(self._ring_count)]

    @property
    def difference(self) -> str:
        """How the missions that vehicles report differ from the operator's; empty if they do not."""
        return self._missions.difference

    @property
    def _team_s(self) -> float:
        # Vehicles send no time before they have measured its rate.
        time_s = self._clocks.now_s(monotonic())
        return time.time() if time_s is None else time_s

    def _on_presence(self, vehicle_id: int, present: bool) -> None:
        (self.present.add if present else self.present.discard)(vehicle_id)
        if present:
            self._note_first_message()

    def _receive(self, message: BusMessage) -> None:
        self._missions.receive(message)
        self._on_message(message)
        if isinstance(message, MemberState | StartProposal | CommandAnswer):
            self._clocks.receive(message.sender, message.time_s, monotonic())
        if isinstance(message, MemberState):
            self.tactics[message.sender] = message.tactic
            self._rings[message.sender] = commanded_rings(message)
            self._note_first_message()
        if isinstance(message, VehicleReport):
            self.ended.pop(message.sender, None)
            (self.in_reserve.add if message.in_reserve else self.in_reserve.discard)(message.sender)
            if message.ended:
                self._ended_s.setdefault(message.sender, monotonic())
                self.ended[message.sender] = message.ended
            else:
                self._ended_s.pop(message.sender, None)
        if isinstance(message, CommandAnswer) and message.key in self._sent:
            self._note_first_message()
            self._sent[message.key].receive(message)

    def _note_first_message(self) -> None:
        """Record when the first vehicle was received."""
        if self._first_message_s is None:
            self._first_message_s = monotonic()

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        end_s = monotonic() + timeout_s
        while not condition() and monotonic() < end_s:
            await asyncio.sleep(_POLL_S)


class TeamClock:
    """The clocks of a team's members from their messages, and the team's: their median.

    It may run faster than wall time. Between messages, which come every tick, it advances at the wall clock's rate.
    """

    def __init__(self) -> None:
        self._received: dict[int, tuple[float, float]] = {}

    @property
    def members(self) -> set[int]:
        """The vehicles whose clock has been received."""
        return set(self._received)

    def receive(self, vehicle_id: int, time_s: float, received_s: float) -> None:
        """Store the time in a vehicle's message, received at `received_s` [wall s]."""
        self._received[vehicle_id] = time_s, received_s

    def times_s(self, at_s: float) -> tuple[tuple[int, float], ...]:
        """Return the time at `at_s` [wall s] by the clock of each vehicle that has been received."""
        return tuple((vehicle, self._time_s(vehicle, at_s)) for vehicle in self._received)

    def now_s(self, at_s: float) -> float | None:
        """Return the team's time at `at_s` [wall s], None if no clock has been received."""
        if not self._received:
            return None
        newest_s = max(received_s for _, received_s in self._received.values())
        return median_low(
            self._time_s(vehicle, at_s)
            for vehicle, (_, received_s) in self._received.items()
            if newest_s - received_s <= _CLOCK_AGE_MAX_S
        )

    def _time_s(self, vehicle: int, at_s: float) -> float:
        time_s, received_s = self._received[vehicle]
        return min(time_s + at_s - received_s, TIME_MAX_S)  # beyond it the command of which it is a part is malformed


_START_POLL_S = 0.1
_IN_RESERVE = "it is in reserve, and stays on the ground until `cordon rejoin`"
_NO_AGENT = "no agent is on the bus: its computer is off, out of reach, or does not run its agent"
_NO_REPORT = "its agent is on the bus, but has not found its autopilot yet"
_OTHER_MISSION = "it has another mission, or another version of this one: copy one mission file to all computers"
_NOT_WAITING = "it is not waiting for the start: it runs its first checks, or runs without --wait-for-start"

State = Literal["ready", "flying", "missing"]


@dataclass(frozen=True, slots=True)
class StartState:
    """The state of one vehicle before the start: why it is missing, and its clock's offset to its peers' [s]."""

    vehicle: int
    state: State
    reason: str = ""
    clock_off_s: float | None = None


@dataclass(slots=True)
class StartReports:
    """The vehicles' reports received so far."""

    mission: Mission
    _reports: dict[int, VehicleReport] = field(default_factory=dict)
    _of_another: dict[int, bool] = field(default_factory=dict)

    def receive(self, message: BusMessage) -> None:
        """Process a message from the bus."""
        match message:
            case VehicleReport():
                self._reports[message.sender] = message
            case StartProposal(mission=flown) if flown is not None:
                self._of_another[message.sender] = flown != self.mission.identity
            case _:
                pass

    def states(self, present: Collection[int]) -> Sequence[StartState]:
        """Return the state of each vehicle; `present` are those on the bus."""
        return [self._state(each, present=each in present) for each in self.mission.ids]

    def _state(self, vehicle: int, *, present: bool) -> StartState:
        report = self._reports.get(vehicle)
        if not present:
            return StartState(vehicle, "missing", _NO_AGENT)
        if report is None:
            return StartState(vehicle, "missing", _NO_REPORT)
        if self._of_another.get(vehicle):
            return StartState(vehicle, "missing", _OTHER_MISSION)
        if report.ended:
            why = _IN_RESERVE if report.in_reserve else f"its flight has ended: {report.ended}"
            return StartState(vehicle, "missing", why)
        if report.start_blockers is not None:
            return StartState(
                vehicle, "missing" if report.start_blockers else "ready", report.start_blockers, report.clock_off_s
            )
        return StartState(vehicle, "flying") if report.armed else StartState(vehicle, "missing", _NOT_WAITING)


@dataclass(frozen=True, slots=True)
class StartResult:
    """The vehicles' states, and their answers to the start; no answers if it was not sent."""

    states: Sequence[StartState]
    answers: Mapping[int, CommandResult | None] = field(default_factory=dict)

    @property
    def started(self) -> bool:
        """Whether every vehicle takes off or is flying."""
        return bool(self.answers) and all(answer and answer.obeyed for answer in self.answers.values())


async def start_team(mission: Mission, operator: Identity, wait_s: float) -> StartResult:
    """Start the team once no vehicle is missing; after `wait_s` give up.

    Raises VehicleRefusedError if the bus cannot be joined, or the team flies another mission.
    """
    reports = StartReports(mission)
    client = CommandClient(mission, operator, reports.receive)
    try:
        await client.open()
        end_s = asyncio.get_running_loop().time() + wait_s
        while True:
            states = reports.states(client.present)
            complete = all(each.state != "missing" for each in states)
            if complete or asyncio.get_running_loop().time() >= end_s:
                break
            await asyncio.sleep(_START_POLL_S)
        return StartResult(states, await client.command("start", mission.ids, None) if complete else {})
    finally:
        await client.close()
