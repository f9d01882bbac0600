"""When a control loop counts as dead: what a supervisor concludes from heartbeats and polls, without processes."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from math import inf

import pytest

from gcs.flight import supervisor
from gcs.flight.heartbeat import TICK_PERIOD_MIN_S, SupervisorHeartbeat
from gcs.flight.supervision_protocol import (
    ALIVE,
    HEARTBEAT_VARIABLE,
    JOINED,
    POLL_PERIOD_S,
    Beat,
    LoopMonitor,
    encode_beat,
    encode_position,
)
from gcs.metrics.ending import Unaccounted
from sitl.server import shared_clock
from sitl.server.governed_clock import GovernedClock
from sitl.server.shared_clock import US_PER_S, ClockName, Rank, Seat, new_clock
from tests.support.wire import PATIENCE_S, until_now

PERIOD_S = 0.1


def tick(vehicle_id: int, due_s: float = PERIOD_S) -> bytes:
    return encode_beat(Beat.TICK, vehicle_id, due_s)


def polls_to_death(monitor: LoopMonitor, limit: int = 1000) -> int:
    """Return how many polls without a heartbeat it takes."""
    return next(count for count in range(1, limit) if monitor.poll())


# The supervisor's judgement


@pytest.mark.parametrize(
    ("rate_hz", "speed", "dead_after_s"),
    [(10.0, 1.0, 0.7), (2.0, 1.0, 0.9), (10.0, 50.0, 0.7), (10.0, 0.1, 1.4)],
)
def test_a_loop_is_dead_when_its_silence_is_long_on_the_walls_clock(
    rate_hz: float, speed: float, dead_after_s: float
) -> None:
    monitor = LoopMonitor()
    monitor.receive(tick(1, 1.0 / rate_hz / speed))
    # One poll hears the tick, which may be a poll's period old by then; the following ones hear nothing.
    assert polls_to_death(monitor) * POLL_PERIOD_S == pytest.approx(dead_after_s)


def test_the_dead_are_named_with_their_silence_and_the_living_are_not() -> None:
    monitor = LoopMonitor()
    monitor.receive(tick(1) + tick(2) + tick(3))
    for _ in range(6):
        assert monitor.poll() == {}
        monitor.receive(tick(2))
    assert monitor.poll() == {1: pytest.approx(0.6), 3: pytest.approx(0.6)}
    assert monitor.flying == (1, 2, 3)


def test_who_has_not_ticked_yet_or_has_ended_is_not_watched() -> None:
    monitor = LoopMonitor()
    monitor.receive(encode_beat(Beat.RISING, 1) + tick(2) + encode_beat(Beat.ENDED, 2))
    assert not any(monitor.poll() for _ in range(100))
    assert monitor.flying == (1,), "it takes off: in no offboard, but in the air"


def test_of_a_flight_that_is_over_those_unaccounted_for_are_known() -> None:
    monitor = LoopMonitor()
    monitor.receive(tick(1) + tick(2) + encode_beat(Beat.ENDED, 1) + encode_beat(Beat.ENDED, 2))
    for _ in range(2):
        monitor.receive(encode_beat(Beat.UNACCOUNTED, 2))
    assert (LoopMonitor().has_flown, monitor.has_flown) == (False, True)
    assert (monitor.flying, monitor.unaccounted) == ((), (2,))


@pytest.mark.parametrize("degrees", [(47.397742, 8.545594), (None, None)], ids=["geodetic", "local"])
def test_a_killed_flight_has_the_last_place_also_of_one_whose_link_was_lost_before(
    degrees: tuple[float | None, float | None],
) -> None:
    sent = Unaccounted(2, *degrees, (7.0, -8.0, 9.5), age_s=3.0)
    older, newest = replace(sent, position_m=(0.0, 0.0, 0.0)), encode_position(sent, time.monotonic() - 30.0)
    monitor = silent(1, 2)
    for byte in encode_position(older, 0.0) + newest + encode_beat(Beat.ENDED, 2) + encode_beat(Beat.UNACCOUNTED, 2):
        monitor.receive(bytes([byte]))
    lines, lost = supervisor._report(77, -9, {}, monitor, supervisor._EndRequest())
    assert lost is not None
    assert lost.vehicles == (1, 2)
    at = "x 7.0 m, y -8.0 m" if degrees[0] is None else "47.397742, 8.545594"
    assert lines[:3] == [
        "Vehicle 1 is unaccounted for: its last position is in the flight log",
        f"Vehicle 2 is unaccounted for: last at {at}, height 9.5 m, 33 s ago",
        "Ended by signal 9: vehicles 1 and 2",
    ]
    assert "`cordon recover`" in lines[-1]
    theirs = supervisor._report(77, -9, {}, monitor, supervisor._EndRequest(), "cordon recover case1 --add 2")[0]
    assert "`cordon recover case1 --add 2`" in theirs[-1]
    monitor.receive(encode_beat(Beat.ENDED, 1))
    assert supervisor._report(77, 4, {}, monitor, supervisor._EndRequest()) == ([], None), "told by that process"
    assert supervisor._report(77, -9, {}, monitor, supervisor._EndRequest())[0][0] == lines[1]


def test_heartbeats_may_arrive_in_pieces() -> None:
    monitor = LoopMonitor()
    for byte in tick(1) + tick(254) + encode_beat(Beat.ENDED, 1):
        monitor.receive(bytes([byte]))
    assert monitor.flying == (254,)


def test_what_is_no_heartbeat_is_an_error() -> None:
    with pytest.raises(ValueError, match="99"):
        LoopMonitor().receive(bytes([99, 1, 0, 0, 0, 0]))


# What it says of a flight that it ended


def silent(*vehicle_ids: int) -> LoopMonitor:
    monitor = LoopMonitor()
    monitor.receive(b"".join(map(tick, vehicle_ids)))
    return monitor


@pytest.mark.parametrize(("load", "overloaded"), [(3.0, False), (6.2, True)])
def test_an_overloaded_computer_is_named(load: float, overloaded: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    (*_, headline, reason, alone, next_step), lost = supervisor._report(
        77, -9, {1: 0.6, 2: 0.7}, silent(1, 2), supervisor._EndRequest()
    )
    assert headline == "Ended by the watchdog: vehicles 1 and 2"
    assert reason.startswith(
        "no tick of the control loop of vehicle 1 for 0.6 s, vehicle 2 for 0.7 s: the flying process 77"
    )
    assert ("overloaded (load 6.2 on 2 cores)" in reason) is overloaded
    assert lost is not None
    assert (lost.reason, lost.vehicles) == (reason, (1, 2))
    assert [alone, next_step] == [f"vehicles 1 and 2, unaccounted for: {lost.autopilots}", f"next: {lost.next_step}"]
    assert time.time() - lost.ended_s < 60.0


class Ending(subprocess.Popen[bytes]):
    """Stands for a process that was killed and has not ended yet."""

    def __init__(self) -> None:
        self.killed = self.is_over = False

    def poll(self) -> int | None:
        return -signal.SIGKILL if self.is_over else None

    def wait(self, timeout: float | None = None) -> int:
        self.is_over = True
        return -signal.SIGKILL

    def kill(self) -> None:
        self.killed = True

    def __del__(self) -> None:
        pass


def test_a_process_that_is_about_to_end_is_not_called_silent(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = pair
    ours.setblocking(False)
    theirs.send(tick(1))
    flying = Ending()
    assert supervisor._watch(flying, ours, LoopMonitor(), supervisor._EndRequest()) == {}
    assert not flying.killed


def test_a_flight_that_ended_as_it_should_has_no_words_of_the_watchdog() -> None:
    assert supervisor._report(77, 0, {}, LoopMonitor(), supervisor._EndRequest()) == ([], None)
    lines, lost = supervisor._report(77, -9, {}, LoopMonitor(), supervisor._EndRequest())
    assert "while no vehicle flew" in lines[0]
    assert lost is None


def test_a_supervisor_does_not_wait_for_a_clock_whose_program_was_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next flight removes what the killed one left, and those that still use it take each other for ended."""
    monkeypatch.setattr(shared_clock, "HUNG_S", 0.2)
    program = (
        "import time\n"
        "from sitl.server.shared_clock import new_clock\n"
        "with new_clock(1.0) as name:\n"
        "    print(name.number, flush=True)\n"
        "    time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as owner:
        assert owner.stdout is not None
        name = ClockName(int(owner.stdout.readline()))
        pace = supervisor._PollPace()
        assert pace.follow(name.number)
        pace.wait()
        period_us = round(POLL_PERIOD_S * US_PER_S)
        with Seat(name, Rank.AGENTS) as flying:
            flying.state(period_us)
            owner.kill()
            owner.wait()
            with new_clock(inf):
                assert not name.folder.exists()
            waiting = threading.Thread(target=pace.wait, daemon=True)
            waiting.start()
            seat = pace._seat
            assert seat is not None
            until_now(lambda: seat.waits_us > period_us, "the supervisor's next event")
            flying.state(100 * period_us)  # it cannot wake the supervisor, whose turn it is
            waiting.join(PATIENCE_S / 10.0)
            assert not waiting.is_alive()
            assert not pace.follow(name.number), "by the wall's from now on"
            began_s = time.monotonic()
            pace.wait()
            assert POLL_PERIOD_S <= time.monotonic() - began_s < PATIENCE_S


# The flying process's end


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """A supervisor's end and a flying process's."""
    ours, theirs = socket.socketpair()
    ours.settimeout(5.0)
    with ours, theirs:
        yield ours, theirs


def test_a_fast_loop_tells_of_a_few_ticks_only(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, theirs = pair
    heartbeat = SupervisorHeartbeat(theirs, lambda: None).heartbeat(1)
    for _ in range(10_000):
        heartbeat.tick(0.002)
    assert len(ours.recv(1 << 20)) <= len(tick(1)) * (5.0 / TICK_PERIOD_MIN_S)
    for _ in range(100_000):  # nobody reads, and nothing waits
        heartbeat.rising()


async def test_on_a_clock_that_runs_ahead_of_the_listening_thread_a_supervisor_that_lives_is_not_lost(
    pair: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared_clock, "HUNG_S", PATIENCE_S)
    ours, theirs = pair
    calls: list[str] = []
    is_over = threading.Event()

    def supervise(name: ClockName) -> None:
        with Seat(name, Rank.SUPERVISOR) as seat, suppress(BrokenPipeError):  # the flight may end first
            seat.state(seat.now_us)
            ours.send(JOINED)
            time.sleep(3 * POLL_PERIOD_S)  # as on a busy computer
            while not is_over.is_set():
                seat.wait_until(seat.now_us + round(POLL_PERIOD_S * US_PER_S))
                ours.send(ALIVE)

    with (
        new_clock(inf) as name,
        GovernedClock(name, Rank.AGENTS) as clock,
        SupervisorHeartbeat(theirs, lambda: calls.append("orphaned")) as heartbeat,
    ):
        supervisor = threading.Thread(target=supervise, args=(name,))
        heartbeat.relay(lambda: calls.append("ask"))
        supervisor.start()
        async with heartbeat.follow(clock):
            for _ in range(3_000):
                await clock.sleep(POLL_PERIOD_S)
        is_over.set()
    supervisor.join()
    assert calls == []


def test_a_flight_that_is_over_wants_nothing_more(pair: tuple[socket.socket, socket.socket]) -> None:
    calls: list[str] = []
    with SupervisorHeartbeat(pair[1], lambda: calls.append("orphaned")) as heartbeat:
        heartbeat.relay(lambda: calls.append("ask"))
    pair[0].close()
    assert calls == []


def test_the_link_to_the_supervisor_is_inherited_once(
    pair: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(HEARTBEAT_VARIABLE, str(os.dup(pair[1].fileno())))
    with SupervisorHeartbeat.inherited(lambda: None) as heartbeat:
        assert HEARTBEAT_VARIABLE not in os.environ, "processes started by this one have none"
        heartbeat.heartbeat(1).rising()
    assert pair[0].recv(64) == encode_beat(Beat.RISING, 1)
