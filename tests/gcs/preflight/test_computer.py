"""How prompt this computer is: lateness, the busiest programs, what the system permits, and the findings about them."""

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from gcs.mission.file import load_mission
from gcs.preflight.computer import (
    ComputerFacts,
    Lateness,
    Processes,
    Program,
    Rehearsal,
    busiest,
    judge_computer,
    measured_lateness,
    processes,
)
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.priority import Privileges, Scheduling
from tests.support.paths import ROOT

CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23
NICE, POLICY = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0) if sys.platform == "linux" else 0
"""The nice value and the policy of the tests themselves, which their processes inherit."""


class Computer:
    """A computer that sleeps exactly, but does nothing during its pauses, from one time to another [s]."""

    def __init__(self, *pauses_s: tuple[float, float]) -> None:
        self.time_s = 0.0
        self.pauses_s = pauses_s

    def now_s(self) -> float:
        return self.time_s

    async def sleep_until(self, time_s: float) -> float:
        self.time_s = max(self.time_s, time_s)
        for from_s, to_s in self.pauses_s:
            if from_s <= self.time_s < to_s:
                self.time_s = to_s
        return self.time_s


def measured(*pauses_s: tuple[float, float], duration_s: float = 3.0) -> Lateness:
    mission = load_mission("case2")
    return asyncio.run(
        measured_lateness(mission, mission.vehicles[:1], duration_s=duration_s, clock=Computer(*pauses_s))
    )


def test_timers_are_as_late_as_the_computer_pauses() -> None:
    """At 10 Hz with deadlines at 0.1, 0.2 ... s: by the pauses' own ends."""
    exact = measured()
    assert (exact.rate_hz, exact.count, exact.missed) == (10.0, 30, 0)
    assert exact.max_s == pytest.approx(0.0, abs=1e-9)
    short = measured((0.95, 1.07))  # late: 1.0 by 0.07
    assert (short.count, short.missed) == (30, 0)
    assert (short.max_s, short.mean_s) == pytest.approx((0.07, 0.07 / 30))
    long = measured((0.95, 1.42))  # late: 1.0 by 0.42, 1.1 by 0.32, 1.2 by 0.22, 1.3 by 0.12, 1.4 by 0.02
    assert (long.count, long.missed) == (30, 4)
    assert (long.max_s, long.mean_s) == pytest.approx((0.42, 1.1 / 30))
    end = measured((2.95, 3.95))  # the last deadline, 3.0, and nine more
    assert end.max_s == pytest.approx(0.95)
    assert end.missed == 9


def test_the_rehearsal_plans_a_formation_with_the_messages_of_the_others() -> None:
    mission = load_mission("case2")
    rehearsal = Rehearsal(mission, mission.vehicles)
    outputs = [rehearsal.tick(index, tick / 10.0) for tick in range(30) for index in range(3)]
    last = {output.status.vehicle_id: output for output in outputs}
    assert [output.status.tactic.value for output in last.values()] == ["formation"] * 3
    assert all(output.setpoint is not None for output in last.values())
    assert {i: {peer.sender for peer in output.status.peers} for i, output in last.items()} == {
        1: {2, 3},
        2: {1, 3},
        3: {1, 2},
    }


def test_the_busiest_programs_are_named_by_what_they_used_in_between() -> None:
    before = {(1, 0.0): ("init", 50.0), (7, 1.0): ("compiler", 10.0), (8, 1.0): ("ended", 5.0), (9, 1.0): ("idle", 1.0)}
    after = {
        (1, 0.0): ("init", 50.06),  # 2 %: not named
        (7, 1.0): ("compiler", 15.4),
        (9, 1.0): ("idle", 1.0),
        (8, 99.0): ("another with the same id", 1.5),
        (20, 99.0): ("new", 0.6),
        (21, 99.0): ("newer", 0.3),
    }
    found = busiest(Processes(10.0, before), Processes(13.0, after))
    assert list(map(str, found)) == ["compiler (7) 180 %", "another with the same id (8) 50 %", "new (20) 20 %"]


def test_a_program_that_computes_is_found_among_those_of_this_computer() -> None:
    """The system's own account of its processor time is the truth."""
    command = "import sys, time\nwhile time.process_time() < 0.2: pass\nsys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", command], stdin=subprocess.PIPE) as spinner:
        while _used_s(spinner.pid) < 0.15:
            time.sleep(0.05)
        after = processes()
        name, used_s = next(used for (pid, _), used in after.used.items() if pid == spinner.pid)
        assert spinner.stdin is not None
        spinner.stdin.close()
    assert 0.149 < used_s < 0.3
    only = Processes(1.0, {key: used for key, used in after.used.items() if key[0] == spinner.pid})
    assert busiest(Processes(0.0, {}), only) == [Program(name, spinner.pid, used_s)]


def _used_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


RAISED = """
import os, sys, threading
from sitl.server import one_core
from gcs.preflight.priority import RaisedPriority
one_core._CLAIMS = f"test-{os.getppid()}"  # flights of other tests have claims
if sys.argv[2:]: os.sched_setaffinity(0, map(int, sys.argv[2:]))
def refuse(*_): raise PermissionError
if "no real time" in sys.argv: os.sched_setscheduler = refuse  # a limit of the nice value alone cannot be set here
if "no rights" in sys.argv and os.geteuid() == 0:
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
wait = threading.Event()
def start(): threading.Thread(target=wait.wait, daemon=True).start()
start()
if "simulated" in sys.argv:
    with one_core.OneCore() as kept:
        start()
        print(kept.core, flush=True)
        input()
    raise SystemExit
with RaisedPriority() as raised:
    start()
    print(raised.privileges.scheduling.name, raised.privileges.memory_locked, raised.privileges.core, flush=True)
    input()
print("restored", flush=True)
input()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="priority and memory are those of Linux")
@pytest.mark.parametrize(
    ("who", "scheduling", "policy"),
    [
        ("root", "REAL_TIME", (2, NICE, 1)),
        ("no real time", "RAISED", (POLICY, -10, 0)),
        ("no rights", "NORMAL", (POLICY, NICE, 0)),
    ],
)
def test_all_threads_are_raised_as_far_as_the_system_permits(
    who: str, scheduling: str, policy: tuple[int, int, int]
) -> None:
    """Judged by the kernel's own account of each thread: policy, nice value, real-time priority, and cores."""
    if not (who == "no rights" or _has_capabilities(CAP_SYS_NICE, CAP_IPC_LOCK)):
        pytest.skip("this user has no right to raise a priority")
    locks, cores = who != "no rights", os.sched_getaffinity(0)
    process = _started(who)
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        reported, locked, core = process.stdout.readline().split()
        assert (reported, locked) == (scheduling, str(locks))
        assert _scheduled(process.pid) == [policy] * 3
        assert _cores(process.pid) == [{int(core)}] * 3
        assert (_locked_kb(process.pid) > 1000) == locks
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.stdout.readline() == "restored\n"
        assert _scheduled(process.pid) == [(POLICY, NICE, 0)] * 3
        assert _cores(process.pid) == [cores] * 3
        assert _locked_kb(process.pid) == 0
        process.stdin.close()


@pytest.mark.skipif(sys.platform != "linux", reason="cores are those of Linux")
@pytest.mark.parametrize("who", ["no rights", "simulated"])
def test_no_two_flying_processes_are_kept_to_one_core(who: str) -> None:
    """The third on two cores runs on both."""
    cores = _two_cores()
    with ExitStack() as stack:
        first, second, third = [stack.enter_context(_raised(who, cores)) for _ in range(3)]
        assert (len(first), len(second)) == (1, 1)
        assert first | second == third == set(cores)


@pytest.mark.skipif(sys.platform != "linux", reason="cores are those of Linux")
def test_simulated_flights_leave_the_cores_to_the_others() -> None:
    cores = _two_cores()
    with ExitStack() as stack:
        first, second = [stack.enter_context(_raised("simulated", cores)) for _ in range(2)]
        assert first | second == set(cores)
        assert stack.enter_context(_raised("no rights", cores)) == first, "as if none were simulated"
    with _raised("no rights", cores) as real, _raised("simulated", cores) as simulated:
        assert (real, simulated) == (first, second)


def _two_cores() -> list[int]:
    """Return two cores that this process may use."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        pytest.skip("this computer has one core")
    return cores


def _started(*arguments: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", RAISED, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    )


@contextmanager
def _raised(who: str, cores: Sequence[int]) -> Iterator[set[int]]:
    """Raise a process that may run on some cores, and return those that its threads run on."""
    with _started(who, *map(str, cores)) as process:
        assert process.stdout is not None
        process.stdout.readline()
        (used,) = set(map(frozenset, _cores(process.pid)))
        yield set(used)
        process.kill()


def _cores(pid: int) -> list[set[int]]:
    """Return the cores that each thread may run on, by the kernel."""
    return [os.sched_getaffinity(int(thread.name)) for thread in Path(f"/proc/{pid}/task").iterdir()]


def _has_capabilities(*bits: int) -> bool:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    held = int(status.partition("CapEff:")[2].split()[0], 16)
    return all(held >> bit & 1 for bit in bits)


def _scheduled(pid: int) -> list[tuple[int, int, int]]:
    """Return the policy, the nice value and the real-time priority of each thread, by the kernel."""
    texts = [path.read_text(encoding="ascii") for path in Path(f"/proc/{pid}/task").glob("*/stat")]
    rows = [text.rpartition(")")[2].split() for text in texts]
    return [(int(row[38]), int(row[16]), int(row[37])) for row in rows]


def _locked_kb(pid: int) -> int:
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(status.partition("VmLck:")[2].split()[0])


def found(late_s: float, privileges: Privileges) -> dict[str, Finding]:
    late = Lateness(20.0, 180, 3, late_s / 10.0, late_s)
    programs = [Program("chrome", 4312, 1.8), Program("cc1plus", 77, 0.93)]
    return {each.check: each for each in judge_computer(ComputerFacts(late, programs, privileges))}


ALL = Privileges(Scheduling.REAL_TIME, memory_locked=True, core=3)


@pytest.mark.parametrize(("late_s", "grade"), [(0.05, Grade.PASS), (0.2, Grade.WARNING), (0.201, Grade.REFUSE)])
def test_a_late_computer_is_refused_with_the_programs_that_keep_it_busy(late_s: float, grade: Grade) -> None:
    finding = found(late_s, ALL)["lateness"]
    assert (finding.grade, finding.subject) == (grade, "this computer")
    assert finding.temporary == (grade is not Grade.PASS)
    for part in (f"{1000 * late_s:.0f} ms", "20 Hz", "3 of 180", "chrome (4312) 180 %", "cc1plus (77) 93 %"):
        assert part in finding.found


@pytest.mark.parametrize(
    ("privileges", "grade"),
    [
        (ALL, Grade.PASS),
        (Privileges(Scheduling.RAISED, memory_locked=True), Grade.PASS),
        (Privileges(Scheduling.REAL_TIME, memory_locked=False), Grade.WARNING),
        (Privileges(Scheduling.NORMAL, memory_locked=True), Grade.WARNING),
        (Privileges(Scheduling.UNAVAILABLE, memory_locked=False), Grade.PASS),
    ],
)
def test_what_the_system_does_not_permit_is_a_warning_with_what_to_permit(privileges: Privileges, grade: Grade) -> None:
    finding = found(0.0, privileges)["priority"]
    assert finding.grade is grade
    assert privileges.scheduling.value in finding.found
    assert ("on core 3" in finding.found) == (privileges is ALL)
    assert ("is locked" in finding.found) == privileges.memory_locked
    for part in ("rtprio", "nice -10", "memlock unlimited", "limits.d"):
        assert (part in finding.next_step) == (grade is Grade.WARNING)
