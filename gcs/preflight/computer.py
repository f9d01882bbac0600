"""How late this computer wakes a control loop: timers at the loop's rate on the flight's event loop, under its load.

The load is that of the links, whatever they send, and of cores that plan a flight at rest (`Rehearsal`). Left out are
the messages of other processes, the ring's planner, the log and the live view.
"""

import asyncio
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import NamedTuple

import psutil

from agents.core import VehicleCore
from agents.inputs import Message, Start
from agents.outputs import TickOutput
from agents.shell.clock import WallClock
from agents.shell.ticker import Ticker, TickerClock, TickTiming
from estimation.state import Telemetry
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import COMPUTER, Finding, Grade, tolerated
from gcs.preflight.priority import NICENESS, Privileges, Scheduling


class Rehearsal:
    """The cores of some vehicles of a mission, each with telemetry of a hover above its start.

    They estimate, plan and guard their formation. What they return goes to the others of them only.
    """

    def __init__(self, mission: Mission, vehicles: Sequence[MissionVehicle]) -> None:
        self._vehicles = vehicles
        self._cores = [VehicleCore(mission.agent_config(vehicle)) for vehicle in vehicles]
        for core in self._cores:
            core.take(Start(0.0))

    def tick(self, index: int, time_s: float) -> TickOutput:
        """Tick the core of a vehicle, by its place in the list, `time_s` after the mission's start."""
        vehicle, core = self._vehicles[index], self._cores[index]
        core.take(Telemetry(time_s, (*vehicle.section.start_m, vehicle.section.altitude_m), (0.0, 0.0, 0.0)))
        output = core.tick(time_s)
        for packet in output.messages:
            message = packet.received()
            for other in self._cores:
                if other is not core:
                    other.take(Message(time_s, message))
        return output


NAMED = 3
NAMED_FROM = 0.05
"""A program that uses a smaller share of a processor is not named."""


@dataclass(frozen=True, slots=True)
class Program:
    """A process and the share of one processor that it used: 1.8 are nearly two processors."""

    name: str
    pid: int
    share: float

    def __str__(self) -> str:
        """Return its name, process id and share, such as `chrome (4312) 180 %`."""
        own = ", this program" if self.pid == os.getpid() else ""
        return f"{self.name} ({self.pid}{own}) {100.0 * self.share:.0f} %"


class Processes(NamedTuple):
    """All processes at one time [s, monotonic]: name and processor seconds by process id and time of start."""

    time_s: float
    used: Mapping[tuple[int, float], tuple[str, float]]


def processes() -> Processes:
    """Return the processes that this user can see. Takes some 10 ms, with the interpreter lock."""
    used = {}
    for process in psutil.process_iter(["name", "create_time", "cpu_times"]):
        times = process.info["cpu_times"]
        if times is not None:  # None where access is denied
            key = process.pid, process.info["create_time"]
            used[key] = process.info["name"] or "?", times.user + times.system
    return Processes(monotonic(), used)


def busiest(before: Processes, after: Processes) -> Sequence[Program]:
    """Return the processes that used the most processor time between two looks, at most three, the busiest first.

    A process that began between them counts from its start; one that ended is not known any more.
    """
    elapsed_s = after.time_s - before.time_s
    programs = [
        Program(name, key[0], (used_s - before.used.get(key, (name, 0.0))[1]) / elapsed_s)
        for key, (name, used_s) in after.used.items()
    ]
    programs.sort(key=lambda program: -program.share)
    return [program for program in programs[:NAMED] if program.share >= NAMED_FROM]


MEASURED_S = 3.0


@dataclass(frozen=True, slots=True)
class Lateness:
    """How late timers of `rate_hz` were: `count` deadlines, of which `missed` passed while the one before was late."""

    rate_hz: float
    count: int
    missed: int
    mean_s: float
    max_s: float


def lateness(ticks: Sequence[TickTiming], rate_hz: float) -> Lateness:
    """Return the lateness of ticks [wall s]; raises ValueError without a tick.

    Deadlines that passed before a tick are counted, each with its own lateness: a pause of 0.5 s at 10 Hz makes five
    deadlines late, the first by 0.5 s.
    """
    late_s = [tick.late_s + before / rate_hz for tick in ticks for before in range(tick.skipped + 1)]
    count = len(late_s)
    if not count:
        raise ValueError("no tick was measured")
    return Lateness(rate_hz, count, count - len(ticks), sum(late_s) / count, max(late_s))


async def measured_lateness(
    mission: Mission,
    vehicles: Sequence[MissionVehicle],
    speed: float = 1.0,
    *,
    duration_s: float = MEASURED_S,
    clock: TickerClock | None = None,
) -> Lateness:
    """Measure `duration_s` [wall s] of one timer for each vehicle, spread over the period as in flight.

    `speed` is how many times as fast as the wall the mission clock runs; the `clock` is the wall's if none is given.
    """
    clock = clock or WallClock()
    rate_hz = mission.mission.rate_hz * speed
    rehearsal, began_s = Rehearsal(mission, vehicles), clock.now_s()
    count = round(duration_s * rate_hz)

    async def timed(index: int) -> list[TickTiming]:
        start_s = began_s + (1.0 + index / len(vehicles)) / rate_hz
        ticker = Ticker(1.0 / rate_hz, clock, start_s)
        ticks: list[TickTiming] = []
        while not ticks or ticks[-1].index < count - 1:
            ticks.append(await ticker.next())
            rehearsal.tick(index, ticks[-1].index / mission.mission.rate_hz)
        return ticks

    each = await asyncio.gather(*map(timed, range(len(vehicles))))
    return lateness([tick for ticks in each for tick in ticks], rate_hz)


LATE_TOLERANCE_S, LATE_LIMIT_S = 0.05, 0.2
"""The watchdog ends a flight without a tick for 0.6 s."""
LIMITS_FILE = "/etc/security/limits.d/cordon.conf"
_ALLOW = (
    f"write to {LIMITS_FILE}, for the user that flies: 'USER - rtprio 10', 'USER - nice {NICENESS}' and "
    "'USER - memlock unlimited', then log in again (docs/flying.md)"
)


@dataclass(frozen=True, slots=True)
class ComputerFacts:
    """How late timers were, the programs that were the busiest meanwhile, and what the system permits."""

    lateness: Lateness
    busiest: Sequence[Program]
    privileges: Privileges


async def computer_facts(
    mission: Mission, vehicles: Sequence[MissionVehicle], privileges: Privileges, speed: float = 1.0
) -> ComputerFacts:
    """Measure on the running event loop; `speed` is that of the mission clock. Takes some seconds."""
    before = await asyncio.to_thread(processes)
    late = await measured_lateness(mission, vehicles, speed)
    after = await asyncio.to_thread(processes)
    return ComputerFacts(late, busiest(before, after), privileges)


def judge_computer(facts: ComputerFacts) -> Iterator[Finding]:
    """Judge lateness and priority."""
    late, named = facts.lateness, ", ".join(map(str, facts.busiest))
    yield Finding.graded(
        tolerated(late.max_s, LATE_TOLERANCE_S, LATE_LIMIT_S),
        COMPUTER,
        "lateness",
        f"timers at {late.rate_hz:g} Hz were up to {late.max_s * 1e3:.0f} ms late, {late.mean_s * 1e3:.0f} ms on "
        f"average, and missed {late.missed} of {late.count} deadlines; processors used by {named or 'no program here'}",
        "setpoints come as late as the timers; without a tick for 0.6 s the watchdog ends the flight",
        "close these programs; where none is named, look at the computer that this one is a virtual machine of",
        temporary=True,
    )
    yield _priority(facts.privileges)


def _priority(privileges: Privileges) -> Finding:
    scheduling, locked, core = privileges
    memory = "its memory is locked" if locked else "its memory is not locked"
    permitted = locked and scheduling in (Scheduling.REAL_TIME, Scheduling.RAISED)
    well = permitted or scheduling is Scheduling.UNAVAILABLE
    return Finding.graded(
        Grade.PASS if well else Grade.WARNING,
        COMPUTER,
        "priority",
        f"the flying process runs {scheduling.value}{'' if core is None else f' on core {core}'}; {memory}",
        "other programs delay a process of normal priority; the system may swap out memory that is not locked",
        _ALLOW,
    )
