"""Flights that a Python program operates: over MAVLink and Zenoh, of real vehicles, simulators or bundled stubs."""

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from inspect import iscoroutinefunction
from itertools import count
from math import inf
from os import getpid
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self, get_args

from agents.ports import VehicleRefusedError
from agents.tactics import Tactic
from agents.team.messages import RingValues
from agents.team.verbs import VERBS, CommandVerb, Verb
from cordon.arguments import is_whole, range_faults
from cordon.simulation import load
from gcs.console.command_client import CommandResult
from gcs.console.verb_arguments import GivenCommand, given_command
from gcs.errors import InputError
from gcs.flight.live.exchange import Answers, Asked, Begun, Failed, LiveRequest, LiveVehicle, Message, News, Over
from gcs.flight.live.process import FlyingProcess
from gcs.flight.recording import RecordingOptions
from gcs.flight.request import FlightRequest
from gcs.flight.simulated_events import Commanded, SimulatedEvents
from gcs.keys.team_keys import security_faults
from gcs.link.ports import free_ports
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import FlightEvent, FlightRecord
from gcs.metrics.result import FlightResult
from gcs.mission.mission import Mission
from gcs.mission.simulation import only_simulated
from gcs.preflight.mission import ring_change_faults

_TACTICS = {each.value for each in Tactic}
_ARGUMENTS = {
    "speed": "speed",
    "sitl": "stubs",
    "fault": "faults",
    "log": "log",
    "allow-plugins": "allow_plugins",
    "checklist-done": "checklist_done",
    "vehicle": "vehicle",
}
"""The arguments of `fly`, and of `LiveFlight.command`, by the options of the command line."""
_OPTION = re.compile(rf"--({'|'.join(_ARGUMENTS)})\b")


class LiveFlight:
    """A flight that the program operates, for `async with`; `cordon.fly` makes it.

    It begins with the vehicles' take-off, and ends by itself with the mission. When the block is left before that, or
    by Ctrl-C, the vehicles hold, then land; at a second Ctrl-C they land at once. They do the same when the program
    ends in any other way, kill -9 included. A program that computes, or hangs, keeps no vehicle waiting: the flight has
    a process of its own, with the supervisor of `cordon fly`.
    """

    def __init__(self, request: LiveRequest) -> None:
        self.mission = request.flight.mission
        self.log: Path | None = None
        """The flight's log, None if it is not recorded; complete once the flight is over."""
        self._request = request
        self._process: FlyingProcess | None = None
        self._news: News | None = None
        self._events: list[FlightEvent] = []
        self._taken = 0
        self._answers: dict[int, Answers] = {}
        self._numbers = count()
        self._record: FlightRecord | None = None
        self._error: InputError | VehicleRefusedError | None = None
        self._begun = self._over = False
        self._changed = asyncio.Event()

    @property
    def vehicles(self) -> Mapping[int, LiveVehicle]:
        """The vehicles' newest states by id, ten a second."""
        return MappingProxyType({} if self._news is None else self._news.vehicles)

    @property
    def time_s(self) -> float | None:
        """The newest known time since the mission's start [s], None before the start."""
        return None if self._news is None else self._news.time_s

    @property
    def is_over(self) -> bool:
        """Whether the flight has ended: each vehicle has landed, was handed over, or is lost."""
        return self._over

    @cached_property
    def result(self) -> FlightResult:
        """Metrics and verdicts, as printed by `cordon fly --json`. Raises VehicleRefusedError without any."""
        if self._error is not None:
            raise self._error
        if self._record is None:
            why = "the mission did not begin" if self._over else "the flight is not over"
            raise VehicleRefusedError(f"there is no result: {why}", "await flight.complete() first")
        return evaluated(self.mission, self._record)

    async def until(
        self, condition: str | Callable[[], bool], *, vehicles: int | None = None, within_s: float = inf
    ) -> float | None:
        """Wait until so many `vehicles` (None: all) fly a tactic, such as "encircle", or a condition holds.

        Returns `time_s`. The flight does not wait for the program: a condition is checked ten times a second of the
        mission clock, at most. Raises TimeoutError with the vehicles' states after `within_s` of that clock,
        VehicleRefusedError if the flight ends before, and InputError.
        """
        holds = self._tactic_condition(condition, vehicles) if isinstance(condition, str) else condition
        if not _is_condition(holds):
            raise InputError([f"condition: {condition!r}: give the name of a tactic, or a function without arguments"])
        if faults := range_faults("within_s", within_s, 0.0, inf):
            raise InputError(faults)
        began_s: float | None = None
        while not holds():
            self._require_flight(f"before {condition!r}" if isinstance(condition, str) else "before the condition held")
            if self._news is not None:
                began_s = self._news.clock_s if began_s is None else began_s
                if self._news.clock_s - began_s > within_s:
                    raise TimeoutError(f"not within {within_s:g} s: {condition}: {self._states()}")
            await self._change()
        return self.time_s

    async def command(self, verb: str, *arguments: object, **values: float) -> Mapping[int, CommandResult | None]:
        """Command the vehicles as `cordon command` does; return their answers by id, None of one without an answer.

        `command("hold")` is for all vehicles, `command("hold", 2)` for one. Others take arguments:
        `command("formation", "wedge")`, `command("ring", radius=12.0, rate=0.08)`; in a mission of several rings
        `command("ring", "left", radius=12.0)` and `command("assign", 3, "left")`. A kill is not asked for twice: the
        vehicles fall.

        Raises InputError for what no vehicle could do, VehicleRefusedError if the flight is over.
        """
        return await self._send(*self._given(verb, arguments, values))

    async def _send(self, verb: Verb, given: GivenCommand) -> Mapping[int, CommandResult | None]:
        self._require_flight(f"before {verb}")
        if isinstance(given.argument, RingValues):
            rings = () if self._news is None else self._news.rings
            of_ring = self.mission, given.argument, rings, given.ring_number or 0
            if faults := await asyncio.to_thread(ring_change_faults, *of_ring):
                raise InputError(faults)
        number = next(self._numbers)
        self._running().command(Asked(number, verb, given))
        while number not in self._answers:
            self._require_flight(f"before {verb} was answered")
            await self._change()
        return self._answers.pop(number).answers

    async def events(self) -> AsyncIterator[FlightEvent]:
        """Yield the events from the beginning of the flight to its end: tactics, commands, failsafes, guard, ring.

        Their `time_s` is that since the mission's start, NaN before it is known.
        """
        self._running()
        for at in count():
            while at >= len(self._events):
                if self._over:
                    return
                await self._change()
            yield self._events[at]

    def new_events(self) -> Sequence[FlightEvent]:
        """Return the events since the last call."""
        new, self._taken = self._events[self._taken :], len(self._events)
        return new

    async def complete(self) -> FlightResult:
        """Wait until the flight is over; return its result. Raises VehicleRefusedError if there is none."""
        self._running()
        while not self._over:
            await self._change()
        return self.result

    async def __aenter__(self) -> Self:
        """Connect, check, and take off; raises VehicleRefusedError and InputError."""
        if self._process is not None:
            raise VehicleRefusedError("this flight was begun before", "make another one by cordon.fly")
        loop = asyncio.get_running_loop()

        def receive(message: Message | None) -> None:
            with suppress(RuntimeError):  # the program's event loop is closed
                loop.call_soon_threadsafe(self._take, message)

        self._process = FlyingProcess(self._request, receive)
        try:
            while not (self._begun or self._over):
                await self._change()
        except BaseException:
            await self._end()
            raise
        if self._error is not None:
            raise self._error
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the flight, and wait until its vehicles have landed; raises VehicleRefusedError if it was lost."""
        await self._end()
        if kind is None and self._error is not None:
            raise self._error

    async def _end(self) -> None:
        """End the flight; Ctrl-C meanwhile lets the vehicles land at once, and is passed on once they have."""
        process, interrupted = self._running(), None
        if not self._over:
            process.end()
        while not self._over:
            try:
                await self._change()
            except asyncio.CancelledError as again:
                interrupted = again
                process.end()
        if interrupted is not None:
            raise interrupted

    def _take(self, message: Message | None) -> None:
        match message:
            case Begun(log):
                self._begun, self.log = True, log
            case News():
                self._news = message
                self._events += message.events
            case Answers():
                self._answers[message.number] = message
            case Over(record):
                self._record, self._over = record, True
            case Failed(error) if not self._over:  # of a flight that is over the supervisor tells who is missing
                self._error = as_arguments(error) if isinstance(error, InputError) else error
                self._over = True
            case None if not self._over:
                self._error, self._over = self._lost(), True
        self._changed.set()

    async def _change(self) -> None:
        self._changed.clear()
        await self._changed.wait()

    def _lost(self) -> VehicleRefusedError:
        """Return the error of a flight whose process and supervisor have ended without a word."""
        if not self._begun:
            why = "the flying process ended before the vehicles took off"
            return VehicleRefusedError(why, "see its output on standard error")
        why = f"the flying process and its supervisor ended in flight: {self._states()}"
        return VehicleRefusedError(why, "only the autopilots control the vehicles now: run `cordon recover`")

    def _running(self) -> FlyingProcess:
        if self._process is None:
            raise VehicleRefusedError("the flight has not begun", "use it with `async with`")
        return self._process

    def _require_flight(self, before: str) -> None:
        self._running()
        if self._over:
            raise self._error or VehicleRefusedError(f"the flight ended {before}: {self._states()}", "see its log")

    def _states(self) -> str:
        return "; ".join(f"vehicle {each.id}: {each.ended or each.tactic}" for each in self.vehicles.values())

    def _tactic_condition(self, tactic: str, vehicles: int | None) -> Callable[[], bool]:
        most = len(self.mission.ids)
        if tactic not in _TACTICS:
            raise InputError([f"condition: there is no tactic {tactic!r} (tactics: {', '.join(sorted(_TACTICS))})"])
        if not (vehicles is None or (is_whole(vehicles) and 1 <= vehicles <= most)):
            raise InputError([f"vehicles: it must be from 1 to {most}, which the mission has (given: {vehicles!r})"])
        wanted = most if vehicles is None else int(vehicles)
        return lambda: sum(each.tactic == tactic and not each.ended for each in self.vehicles.values()) >= wanted

    def _given(
        self, verb: str, arguments: Sequence[object], values: Mapping[str, float]
    ) -> tuple[CommandVerb, GivenCommand]:
        verbs = get_args(CommandVerb)
        known = next((each for each in verbs if each == verb), None)
        if known is None:
            raise InputError([f"verb: there is no {verb!r} (verbs: {', '.join(verbs)})"])
        texts = [*map(str, arguments), *(f"{name}={value}" for name, value in values.items())]
        vehicle: int | None = None
        if not VERBS[known].takes and len(texts) == 1:
            if texts[0] not in map(str, self.mission.ids):
                ids = ", ".join(map(str, self.mission.ids))
                raise InputError([f"vehicle: the mission has no vehicle {texts[0]} (it has {ids})"])
            vehicle, texts = int(texts[0]), []
        try:
            return known, given_command(self.mission, known, texts, vehicle)
        except InputError as error:
            raise as_arguments(error) from error


def fly(
    mission: Mission | str | Path,
    *,
    stubs: bool | Collection[int] = False,
    speed: float | None = None,
    duration_s: float | None = None,
    faults: Sequence[str] = (),
    wait_s: float = 60.0,
    log: str | Path | None = None,
    recorded: bool = True,
    allow_plugins: bool = False,
    checklist_done: str | None = None,
    weather: str = "",
) -> LiveFlight:
    """Return a flight of a mission over MAVLink and Zenoh, for `async with`, as `cordon fly` flies it.

    - `mission`: a mission from `cordon.load`, or an argument of it. Its vehicles are at their urls.
    - `stubs`: True for all vehicles, or the ids of those that are bundled stubs and start with the flight.
    - `speed`: of the mission clock, as a multiple of the wall's; of stubs at most. None: 1 with stubs, else measured.
      Infinity, where all vehicles are stubs: as fast as the computer can.
    - `duration_s`: replaces the mission's.
    - `faults`: to inject into stubs, such as "link-cut@120:2".
    - `wait_s`: how long to wait on the ground for vehicles that are not ready [wall s].
    - `log`: a new file; None: one in the folder of logs, unless `recorded` is False.
    - `allow_plugins`: whether code that the mission names, its planner, may run.
    - `checklist_done`: the name of who has done the mission's checklist, if it has one; else the flight waits for ticks
      on the operator's page.
    - `weather`: as people see it, for log and report.

    Raises InputError with every fault.

    >>> import asyncio, cordon
    >>> async def flown():
    ...     async with cordon.fly("case2", stubs=True, speed=10.0, duration_s=20.0, recorded=False) as flight:
    ...         await flight.until("formation", within_s=60.0)
    ...         answers = await flight.command("hold", 2)
    ...     return answers[2].did
    >>> asyncio.run(flown())  # doctest: +SKIP
    'holds'
    """
    mission = mission if isinstance(mission, Mission) else load(mission)
    problems = [*security_faults(mission), *only_simulated(mission)]
    chosen = _stub_ids(mission, stubs, problems)
    problems += [] if speed is None else range_faults("speed", speed, 0.1, inf)
    problems += [] if duration_s is None else range_faults("duration_s", duration_s, 1e-3, 1e6)
    problems += [*range_faults("wait_s", wait_s, 0.0, 3600.0), *_log_faults(log)]
    texts = _texts(faults)
    if texts is None:
        problems.append(f'faults: give a list of texts, such as ["link-cut@120:2"] (given: {faults!r})')
    if problems:
        raise InputError(problems)
    request = FlightRequest(
        mission=mission,
        stubs=chosen,
        speed=None if speed is None else float(speed),
        duration_s=None if duration_s is None else float(duration_s),
        faults=texts or (),
        wait_s=float(wait_s),
        allow_plugins=allow_plugins,
        checklist_done=checklist_done,
        weather=weather,
    )
    try:
        request.plan()
    except InputError as error:
        raise as_arguments(error) from error
    path = None if log is None else Path(log).absolute()
    return LiveFlight(LiveRequest(request, RecordingOptions(path, recorded), getpid()))


async def flown_on_stubs(
    mission: Mission | str | Path, commands: Sequence[Commanded] = (), **named: Any
) -> FlightResult:
    """Fly a mission on stubs, with a team and ports of its own and commands by mission time; return its result.

    `named` are arguments of `fly`. Raises InputError and VehicleRefusedError.
    """
    mission = on_own_ports(mission if isinstance(mission, Mission) else load(mission))
    if "stubs" in named:
        raise InputError(["stubs: all vehicles are stubs here; leave this argument out"])
    duration_s = named.get("duration_s") or mission.mission.duration_s
    due = SimulatedEvents(mission, commands, duration_s=duration_s).commands
    async with fly(mission, stubs=True, **named) as flight:
        for each in due:
            await flight.until(partial(_is_reached, flight, each.time_s))
            await flight._send(each.verb, GivenCommand(each.ring or each.shape, each.ring_number, each.vehicle))
        return await flight.complete()


def _is_reached(flight: LiveFlight, time_s: float) -> bool:
    return flight.time_s is not None and flight.time_s >= time_s


def on_own_ports(mission: Mission) -> Mission:
    """Return the mission as a team of its own: with vehicles and a bus at ports that no other process of cordon has."""
    first, *_ = found = free_ports(2 * len(mission.ids))
    ports = iter(found)
    vehicles = {
        each: {"url": f"udpin://127.0.0.1:{next(ports)}", "endpoint": f"tcp/127.0.0.1:{next(ports)}"}
        for each in mission.ids
    }
    return mission.replace(vehicles=vehicles, network={"team": f"{mission.network.team}-{first}"})


def _stub_ids(mission: Mission, stubs: object, problems: list[str]) -> tuple[int, ...]:
    if isinstance(stubs, bool):
        return mission.ids if stubs else ()
    ids = tuple(stubs) if isinstance(stubs, Collection) and not isinstance(stubs, str) else None
    if ids is None or not all(map(is_whole, ids)) or len({*ids}) < len(ids) or not {*ids} <= {*mission.ids}:
        known = ", ".join(map(str, mission.ids))
        problems.append(f"stubs: give True, or ids of the mission's vehicles, {known} (given: {stubs!r})")
        return ()
    return ids


def _is_condition(given: object) -> bool:
    return callable(given) and not iscoroutinefunction(given)


def _texts(given: object) -> tuple[str, ...] | None:
    """Return texts; None for anything else, such as a single one."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        return None
    texts = tuple(given)
    return texts if all(isinstance(each, str) for each in texts) else None


def _log_faults(log: object) -> list[str]:
    """Return why a log cannot be written, as far as that is seen before the flight."""
    if log is None:
        return []
    if not isinstance(log, str | Path) or not Path(log).name or "\0" in str(log):
        return [f"log: give the path of a new file (given: {log!r})"]
    if Path(log).exists():
        return [f"log: {str(log)!r} exists already, and is not overwritten; name another"]
    folder = Path(log).absolute().parent
    return [] if folder.is_dir() else [f"log: {str(log)!r}: there is no folder {str(folder)!r}"]


def as_arguments(error: InputError) -> InputError:
    """Return faults of command-line options as those of arguments."""

    return InputError([_OPTION.sub(lambda option: _ARGUMENTS[option[1]], fault) for fault in error.faults])
