"""Findings about this computer: whether it wakes the control loops in time, and at which priority they run."""

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.computer.lateness import Lateness, measured_lateness
from gcs.preflight.computer.priority import NICENESS, Privileges, Scheduling
from gcs.preflight.computer.programs import Program, busiest, processes
from gcs.preflight.findings import COMPUTER, Finding, Grade, tolerated

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
    scheduling, locked = privileges
    memory = "its memory is locked" if locked else "its memory is not locked"
    permitted = locked and scheduling in (Scheduling.REAL_TIME, Scheduling.RAISED)
    well = permitted or scheduling is Scheduling.UNAVAILABLE
    return Finding.graded(
        Grade.PASS if well else Grade.WARNING,
        COMPUTER,
        "priority",
        f"the flying process runs {scheduling.value}; {memory}",
        "other programs delay a process of normal priority; the system may swap out memory that is not locked",
        _ALLOW,
    )
