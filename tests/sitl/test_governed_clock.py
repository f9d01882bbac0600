"""The governed clock: nobody is passed, whatever the computer does, and nobody who hangs or ends stops the others."""

import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from math import inf
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.server import shared_clock
from sitl.server.clock_memory import NEVER_US
from sitl.server.governed_clock import GovernedClock
from sitl.server.shared_clock import ClockError, ClockName, Rank, Seat, clock_of, new_clock
from sitl.server.wall_limit import WallLimit
from tests.support.wire import PATIENCE_S, until

MOTION = (1.0, 2.0, -3.0, 0.1, 0.2, 0.3)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(shared_clock.FOLDER_VARIABLE, str(tmp_path))
    return tmp_path


@pytest.fixture
def fast() -> Iterator[ClockName]:
    with new_clock(inf) as name:
        yield name


@settings(max_examples=10)
@given(st.lists(st.lists(st.integers(1, 50), min_size=1, max_size=8), min_size=2, max_size=5), st.randoms())
def test_events_happen_in_their_order_whoever_looks_first(
    periods_us: list[list[int]],
    chance: "st.randoms.__class__",  # type: ignore[name-defined]
) -> None:
    """The truth: all events sorted by time, and by seat where they are simultaneous."""
    times = {who: [sum(each[: k + 1]) for k in range(len(each))] for who, each in enumerate(periods_us)}
    expected = sorted((at_us, who) for who, events in times.items() for at_us in events)
    happened: list[tuple[int, int]] = []
    with new_clock(inf) as name, ExitStack() as stack:
        seats = {who: stack.enter_context(Seat(name, Rank.GUEST)) for who in times}
        for who, seat in seats.items():
            seat.state(times[who][0])
        left = {who: list(events) for who, events in times.items()}
        while any(left.values()):
            who = chance.choice([each for each, events in left.items() if events])
            if seats[who].turn() == 0.0:
                at_us = left[who].pop(0)
                assert seats[who].now_us == at_us
                happened.append((at_us, who))
                seats[who].state(left[who][0] if left[who] else NEVER_US)
    assert happened == expected


def test_a_clock_runs_at_its_speed_and_does_not_catch_up(fast: ClockName) -> None:
    with Seat(fast, Rank.STUBS) as seat:
        seat.speed = 20.0
        began_s = time.monotonic()
        for step in range(1, 101):
            seat.wait_until(20_000 * step)
            if step == 50:
                time.sleep(0.3)
        took_s = time.monotonic() - began_s
    assert took_s >= 2.0 / 20.0 + 0.3 - shared_clock.LATE_MAX_S - 0.02
    assert seat_epoch_is_whole(fast)


def seat_epoch_is_whole(name: ClockName) -> bool:
    with Seat(name, Rank.GUEST) as seat:
        return seat.epoch_s == int(seat.epoch_s) and abs(seat.epoch_s - time.time()) < 60.0


def test_one_that_hangs_is_passed_over_until_it_goes_on(fast: ClockName, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_clock, "HUNG_S", 0.1)
    with Seat(fast, Rank.AGENTS) as hangs, Seat(fast, Rank.SUPERVISOR) as other:
        hangs.state(1_000)
        assert hangs.turn() == 0.0  # it handles its event, and hangs
        began_s = time.monotonic()
        other.wait_until(2_000)
        assert time.monotonic() - began_s >= 0.1
        monkeypatch.setattr(shared_clock, "HUNG_S", inf)
        for event_us in (3_000, 4_000):  # at once: it is known to hang
            other.wait_until(event_us)
        other.state(9_000)
        hangs.state(1_500)  # it goes on, at the present time
        assert hangs.waits_us == 4_000
        assert other.turn() > 0.0
        assert hangs.turn() == 0.0
        hangs.state(NEVER_US)
        assert other.turn() == 0.0


def test_one_that_says_that_it_waits_does_not_hang(fast: ClockName, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_clock, "HUNG_S", 0.1)
    with Seat(fast, Rank.AGENTS) as waits, Seat(fast, Rank.SUPERVISOR) as other:
        waits.state(1_000)
        other.state(2_000)
        for _ in range(50):
            waits.note_wait()
            assert other.turn() > 0.0
            time.sleep(0.01)
        assert waits.turn() == 0.0
        end_s = time.monotonic() + 5.0
        while other.turn() > 0.0:  # without a word it hangs
            assert time.monotonic() < end_s
            time.sleep(0.01)


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="the system does not tell who waits")
def test_a_message_behind_others_is_not_lost_while_a_thread_computes() -> None:
    def spin() -> None:
        end_s = time.thread_time() + 0.5
        while time.thread_time() < end_s:
            pass

    def waited_s(*, hand_over: bool) -> float:
        began_s = time.monotonic()
        limit = WallLimit(0.1, 20.0, os.getpid(), began_s, hand_over=hand_over)
        while not limit.is_over(time.monotonic()):
            time.sleep(0.005)
        return time.monotonic() - began_s

    for hand_over, at_least_s in ((False, 0.1), (True, 0.5)):
        worker = threading.Thread(target=spin)
        worker.start()
        assert waited_s(hand_over=hand_over) >= at_least_s
        assert worker.is_alive() is not hand_over
        worker.join()


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="the system does not tell who waits")
@pytest.mark.skipif(
    sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_IDLE and os.geteuid() != 0,
    reason="no class is lower, and only root may leave it",
)
def test_one_that_still_lacks_the_processor_does_not_hang() -> None:
    """The system counts the time for which a thread lacks it only once the thread computes."""
    pinned = (
        "import os\n"
        "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))\n"
    )
    spins, yields = (
        "print(flush=True)\nwhile True: pass\n",
        "os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\n",
    )
    with ExitStack() as stack:
        started = []
        for program in (pinned + spins, pinned + yields + spins):
            process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
            started.append(stack.enter_context(process))
            stack.callback(process.kill)
            assert process.stdout is not None
            process.stdout.readline()
        busy, starved = started
        statistics = Path(f"/proc/{starved.pid}/schedstat")
        before = ""
        while statistics.read_text() != before:  # until it has lacked it all the time
            before, over = statistics.read_text(), False
            limit = WallLimit(0.1, 60.0, starved.pid, time.monotonic())
            end_s = time.monotonic() + 0.5
            while time.monotonic() < end_s:
                over = over or limit.is_over(time.monotonic())
                time.sleep(0.01)
        assert not over
        busy.send_signal(signal.SIGSTOP)
        while not limit.is_over(time.monotonic()):  # it computes, and does not come on
            time.sleep(0.01)


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="the system does not tell who waits")
def test_one_that_lacks_the_processor_is_waited_for(fast: ClockName, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_clock, "HUNG_S", 0.5)
    program = (
        "import os, sys, time\n"
        "from sitl.server.shared_clock import ClockName, Rank, Seat\n"
        "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "with Seat(ClockName(int(sys.argv[1])), Rank.AGENTS) as seat:\n"
        "    seat.wait_until(1000)\n"
        "    print('works', flush=True)\n"
        "    end_s = time.process_time() + 0.06\n"
        "    while time.process_time() < end_s:\n"
        "        pass\n"
        "    print(seat.now_us, flush=True)\n"
    )
    idle = "import os\nos.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\nwhile True: pass\n"
    with ExitStack() as stack:
        for _ in range(9):
            busy = stack.enter_context(subprocess.Popen([sys.executable, "-c", idle]))
            stack.callback(busy.kill)
        command = [sys.executable, "-c", program, str(fast.number)]
        works = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(works.kill)
        other = stack.enter_context(Seat(fast, Rank.SUPERVISOR))
        assert works.stdout is not None
        assert works.stdout.readline() == "works\n"
        other.wait_until(2_000)
        assert works.stdout.readline() == "1000\n", "the time passed it"


def test_one_whose_process_is_killed_keeps_nobody_waiting(fast: ClockName, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_clock, "HUNG_S", inf)  # who does not go on is waited for, unless it is dead
    program = (
        "import sys, time\n"
        "from sitl.server.shared_clock import ClockName, Rank, Seat\n"
        "seat = Seat(ClockName(int(sys.argv[1])), Rank.AGENTS)\n"
        "seat.state(1000)\n"
        "print('here', flush=True)\n"
        "time.sleep(60)\n"
    )
    command = [sys.executable, "-c", program, str(fast.number)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as child, Seat(fast, Rank.SUPERVISOR) as seat:
        assert child.stdout is not None
        assert child.stdout.readline() == b"here\n"
        seat.state(2_000)
        assert seat.turn() > 0.0
        os.kill(child.pid, signal.SIGKILL)  # not reaped yet: a zombie
        seat.wait_until(2_000)


def test_clocks_of_one_computer_are_their_own_and_leave_nothing(folder: Path) -> None:
    with new_clock(inf) as one, new_clock(inf) as other:
        with Seat(one, Rank.STUBS) as here, Seat(other, Rank.STUBS) as there:
            here.wait_until(5_000_000)
            assert (here.now_us, there.now_us) == (5_000_000, 0)
        abandoned = folder / one.folder.name.replace(f"{one.number:08x}", "0badc10c")
        abandoned.mkdir()
        (abandoned / "owner").touch()
        with new_clock(inf):
            assert not abandoned.exists()
            assert one.folder.exists()
    assert list(folder.iterdir()) == []
    with pytest.raises(ClockError, match="there is no clock"):
        Seat(one, Rank.STUBS)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a folder to another user")
def test_the_clock_of_another_user_is_not_joined(folder: Path) -> None:
    with new_clock(inf, (14540,)) as name:
        assert clock_of((14540,)) == name
        os.chown(name.folder, 12345, 12345)
        assert clock_of((14540,)) is None
        with pytest.raises(ClockError, match="another user"):
            Seat(name, Rank.GUEST)
    left = folder / f"cordon-clock-{os.getuid()}-00000001"
    left.mkdir()
    os.mkfifo(left / "owner")
    os.mkfifo(left / "ports")
    os.chown(left, 12345, 12345)
    assert clock_of((14540,)) is None, "a pipe without a writer is not read"


def test_memory_that_cannot_be_shared_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(shared_clock.FOLDER_VARIABLE, str(folder / "missing"))
    with pytest.raises(ClockError, match="missing"), new_clock(1.0):
        pass
    for speed in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="must be positive"), new_clock(speed):
            pass


async def test_a_loop_sleeps_and_calls_at_exact_times(fast: ClockName) -> None:
    with GovernedClock(fast, Rank.AGENTS) as clock:
        began_s, times = clock.now_s(), list[tuple[str, float]]()

        def note(what: str) -> None:
            times.append((what, round(clock.now_s() - began_s, 6)))

        async def slept(what: str, duration_s: float) -> None:
            await clock.sleep(duration_s)
            note(what)
            await asyncio.sleep(0.0)  # further steps of a task belong to the same event
            note(what)

        clock.call_at(began_s + 0.25, lambda: note("call"))
        clock.call_at(began_s + 0.1, lambda: note("never")).cancel()
        await asyncio.gather(slept("b", 0.3), slept("a", 0.2))
        assert await clock.sleep_until(began_s - 5.0) == clock.now_s()
    assert times == [("a", 0.2), ("a", 0.2), ("call", 0.25), ("b", 0.3), ("b", 0.3)]


async def test_the_time_stands_still_while_work_of_this_computer_is_awaited(fast: ClockName) -> None:
    with GovernedClock(fast, Rank.AGENTS) as clock, Seat(fast, Rank.SUPERVISOR) as other:
        other.state(1_000_000)
        began_s = clock.now_s()
        with clock.held():
            await asyncio.sleep(0.05)
            assert clock.now_s() == began_s
            assert other.turn() > 0.0
        await until(lambda: other.turn() == 0.0)


async def test_work_that_takes_longer_paces_the_time_by_the_walls(
    fast: ClockName, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.server.governed_clock.HELD_MAX_S", 0.1)
    stepped = 0

    async def step(clock: GovernedClock) -> None:
        nonlocal stepped
        while True:
            await clock.sleep(0.004)
            stepped += 1

    with GovernedClock(fast, Rank.STUBS) as stubs, GovernedClock(fast, Rank.AGENTS) as clock:
        stepping = asyncio.create_task(step(stubs))
        with clock.held():
            began_s, wall_s = clock.now_s(), time.monotonic()
            await clock.sleep(0.4)
            passed_s = clock.now_s() - began_s
            took_s = time.monotonic() - wall_s
            assert passed_s == pytest.approx(0.4)
            assert took_s >= 0.1 + 0.4 - 0.05, "it ran faster than the wall's"
            assert stepped in (100, 101), "the others have gone on with it"
        wall_s = time.monotonic()
        await clock.sleep(20.0)
        assert time.monotonic() - wall_s < 20.0 / 2.0, "it is fast again"
        stepping.cancel()


async def test_motions_and_setpoints_under_way_are_waited_for(fast: ClockName, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.server.governed_clock.TRANSIT_MAX_S", 0.2)
    with GovernedClock(fast, Rank.AGENTS) as client, GovernedClock(fast, Rank.STUBS) as stubs:
        link, motions, setpoints = client.transit(7), stubs.motions(7), stubs.setpoints(7)
        stubs.expect(setpoints)
        await stubs.sleep(0.1)
        sent_s = stubs.now_s()
        motions.send(MOTION)
        ticking = asyncio.create_task(client.sleep(1.0))
        await asyncio.sleep(0.05)
        assert not ticking.done()
        (north, east, down), velocity = MOTION[:3], MOTION[3:]
        assert link.sent_s(north, east, down, velocity) == sent_s
        await asyncio.wait_for(ticking, PATIENCE_S)
        link.send(1.5, 2.5, -3.5)
        stepping = asyncio.create_task(stubs.sleep(0.1))
        await asyncio.sleep(0.05)
        assert not stepping.done()
        setpoints.take(1.5, 2.5, -3.5)
        await asyncio.wait_for(stepping, PATIENCE_S)
        motions.send((*MOTION[:5], 9.0))  # lost
        began_s = time.monotonic()
        await client.sleep(0.1)
        assert time.monotonic() - began_s >= 0.2


async def test_states_on_the_bus_are_waited_for_once_one_has_arrived(fast: ClockName) -> None:
    with GovernedClock(fast, Rank.AGENTS) as sender, GovernedClock(fast, Rank.GUEST) as observer:
        outgoing, incoming = sender.bus_transit(), observer.bus_transit()
        outgoing.send(3)
        await asyncio.wait_for(observer.sleep(0.1), PATIENCE_S)  # not connected yet
        outgoing.send(3)
        incoming.take(3)
        outgoing.send(3)
        waiting = asyncio.create_task(observer.sleep(0.1))
        await asyncio.sleep(0.05)
        assert not waiting.done()
        incoming.take(3)
        await asyncio.wait_for(waiting, PATIENCE_S)


async def test_a_call_that_fails_affects_no_other(fast: ClockName) -> None:
    failures: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: failures.append(context["exception"]))
    with GovernedClock(fast, Rank.AGENTS) as clock:
        began_s = clock.now_s()
        clock.call_at(began_s + 0.1, lambda: 1 // 0)
        assert await asyncio.wait_for(clock.sleep_until(began_s + 0.1), PATIENCE_S) == pytest.approx(began_s + 0.1)
        assert await asyncio.wait_for(clock.sleep_until(began_s + 0.2), PATIENCE_S) == pytest.approx(began_s + 0.2)
    assert [type(each) for each in failures] == [ZeroDivisionError]


# Two participants on one event loop, as a flight beside stubs of its own process


async def test_two_clocks_of_one_event_loop_do_not_wait_for_each_other() -> None:
    with new_clock(50.0) as name, GovernedClock(name, Rank.STUBS) as stubs, GovernedClock(name, Rank.AGENTS) as agents:
        order: list[tuple[int, str]] = []

        async def tick(clock: GovernedClock, who: str, period_ms: int) -> None:
            began_s = clock.now_s()
            for number in range(1, 1 + 1000 // period_ms):
                await clock.sleep_until(began_s + 1e-3 * number * period_ms)
                order.append((round((clock.now_s() - began_s) * 1e3), who))

        await asyncio.wait_for(asyncio.gather(tick(agents, "agents", 100), tick(stubs, "stubs", 4)), PATIENCE_S)
    expected = [(ms, "stubs") for ms in range(4, 1001, 4)] + [(ms, "agents") for ms in range(100, 1001, 100)]
    assert order == sorted(expected, key=lambda each: (each[0], each[1] != "stubs"))


async def test_an_earlier_event_is_stated_before_another_clock_of_the_loop_looks() -> None:
    with new_clock(inf) as name, GovernedClock(name, Rank.STUBS) as stubs, GovernedClock(name, Rank.AGENTS) as agents:
        began_s = stubs.now_s()
        later = asyncio.create_task(stubs.sleep_until(began_s + 1.0))
        await asyncio.sleep(0)
        woken_s = await agents.sleep_until(began_s + 0.5)
        assert woken_s == pytest.approx(began_s + 0.5, abs=1e-6)
        await later
