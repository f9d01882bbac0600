"""The flying process's heartbeat to its supervisor; when the supervisor's own heartbeat stops, the vehicles land."""

import asyncio
import os
import select
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext, suppress
from dataclasses import dataclass
from math import inf
from typing import Protocol, Self

from agents.ports import Heartbeat
from agents.shell.clock import MissionClock
from gcs import signals
from gcs.flight.supervision_protocol import (
    HEARTBEAT_VARIABLE,
    JOINED,
    POLL_PERIOD_S,
    STOP,
    Beat,
    encode_beat,
    encode_clock,
    encode_position,
)
from gcs.metrics.ending import Unaccounted
from sitl.server.governed_clock import GovernedClock

TICK_PERIOD_MIN_S = 0.04
"""A faster loop sends fewer heartbeats than ticks: the supervisor polls ten times a second."""
SUPERVISOR_SILENCE_S, SILENT_POLL_S = 3.0, 1.5 * POLL_PERIOD_S
"""A supervisor without a heartbeat for this time counts as dead: it may be stopped."""
JOINED_WITHIN_S = 10.0
"""Wall time for the supervisor to join a governed clock; a stopped one never does."""


class SupervisorLink(Protocol):
    """The link to the supervisor process: heartbeats out, the operator's requests to end the flight in."""

    def heartbeat(self, vehicle_id: int) -> Heartbeat:
        """Return the heartbeat of a vehicle's agent."""

    @property
    def is_lost(self) -> bool:
        """Whether the supervisor has ended or stopped."""

    def relay(self, request: Callable[[], object]) -> None:
        """Call `request`, on another thread, for each request of the operator to end."""

    def report_unaccounted(self, vehicle_ids: Sequence[int]) -> None:
        """Report the vehicles that are unaccounted for although their flights have ended."""

    def report_positions(self, positions: Iterable[Unaccounted]) -> None:
        """Report vehicles with their newest positions, for the case that this process is killed."""

    def follow(self, clock: MissionClock) -> AbstractAsyncContextManager[None]:
        """Let silences be measured on the flight's clock within a context."""


class Unsupervised:
    """No supervisor: signals reach this process directly, as in a program that calls `gcs.flight.flight`."""

    is_lost = False

    def heartbeat(self, _vehicle_id: int) -> Heartbeat:
        """Return a heartbeat that is not sent."""
        return _Unsent()

    def relay(self, request: Callable[[], object]) -> None:
        """Call `request` for each signal."""
        signals.relay(request)

    def report_unaccounted(self, _vehicle_ids: Sequence[int]) -> None:
        """Do nothing: no supervisor keeps a page open."""

    def report_positions(self, _positions: Iterable[Unaccounted]) -> None:
        """Do nothing: no supervisor would print them."""

    def follow(self, _clock: MissionClock) -> AbstractAsyncContextManager[None]:
        """Return a context without effect."""
        return nullcontext()


class SupervisorHeartbeat:
    """This process's end of the socket pair, to be used as a context manager around the flight.

    `on_lost` is called, on another thread, when the supervisor has ended or stopped.
    """

    def __init__(self, connection: socket.socket, on_lost: Callable[[], object]) -> None:
        connection.setblocking(False)
        connection.set_inheritable(False)
        self._connection = connection
        self._on_lost = on_lost
        self._listener: threading.Thread | None = None
        self._closing = False
        self._time = _WALL
        self._joined = threading.Event()
        self.is_lost = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        if self._listener is not None:
            self._listener.join()
        self._connection.close()

    @classmethod
    def inherited(cls, on_lost: Callable[[], object]) -> Self:
        """Take the end that the supervisor passed to this process, and hide it from processes started by this one."""
        return cls(socket.socket(fileno=int(os.environ.pop(HEARTBEAT_VARIABLE))), on_lost)

    def heartbeat(self, vehicle_id: int) -> Heartbeat:
        """Return the heartbeat of a vehicle's agent."""
        return _HeartbeatSender(self._connection, vehicle_id, self._now_s)

    @asynccontextmanager
    async def follow(self, clock: MissionClock) -> AsyncIterator[None]:
        """Measure silences, here and in the supervisor, on a governed clock within a context.

        Waits until the supervisor has joined the clock, which from then on waits for it.
        """
        if not isinstance(clock, GovernedClock):
            yield
            return
        self._send_clock(clock.name.number)
        if await asyncio.to_thread(self._joined.wait, JOINED_WITHIN_S):
            self._time = _Time(clock.now_s, inf)
        try:
            yield
        finally:
            self._time = _WALL
            self._send_clock(None)

    def report_unaccounted(self, vehicle_ids: Sequence[int]) -> None:
        """Report the vehicles that are unaccounted for although their flights have ended."""
        for vehicle_id in vehicle_ids:
            self._send(encode_beat(Beat.UNACCOUNTED, vehicle_id))

    def report_positions(self, positions: Iterable[Unaccounted]) -> None:
        """Report vehicles with their newest positions, for the case that this process is killed."""
        for each in positions:
            self._send(encode_position(each, time.monotonic()))

    def _now_s(self) -> float:
        return self._time.now_s()

    def _send_clock(self, number: int | None) -> None:
        self._send(encode_clock(number))

    def _send(self, record: bytes) -> None:
        with suppress(OSError):  # the supervisor has ended: the listening thread handles it
            self._connection.send(record)

    def relay(self, request: Callable[[], object]) -> None:
        """Call `request` for each request of the operator to end, and once if the supervisor is lost before that."""

        def listen() -> None:
            with suppress(RuntimeError):  # the event loop is closed: the flight is over
                self._listen(request)

        self._listener = threading.Thread(target=listen, name="supervisor", daemon=True)
        self._listener.start()

    def _listen(self, request: Callable[[], object]) -> None:
        asked, silence = False, _Silence(self._time)
        while not self._closing:
            measured_on = self._time
            reached_s = measured_on.now_s()  # before it receives: what the supervisor sent until then has arrived
            received = self._received()
            silent_s = silence.take(measured_on, reached_s, received=bool(received))
            requests = received.count(STOP) if received else 0
            if received and JOINED in received:
                self._joined.set()
            lost = received == b"" or (silent_s > SUPERVISOR_SILENCE_S and not self.is_lost)
            if lost:
                self.is_lost = True
                requests = 0 if asked else 1  # a second request would mean: land at once
            for _ in range(requests):
                request()
            asked = asked or requests > 0
            if lost:
                self._on_lost()  # after the request: printing may fail if the terminal has closed, too
            if received == b"":
                return

    def _received(self) -> bytes | None:
        """Return what the supervisor sent; None when nothing arrived within a poll, b"" when it has ended."""
        if not select.select([self._connection], [], [], POLL_PERIOD_S)[0]:
            return None
        try:
            return self._connection.recv(4096)
        except OSError:  # it died with heartbeats unread
            return b""


@dataclass(frozen=True, slots=True)
class _Time:
    """What silences are measured on, and how much of it a poll counts for at most [s]."""

    now_s: Callable[[], float]
    poll_max_s: float


_WALL = _Time(time.monotonic, SILENT_POLL_S)
"""A poll counts for its usual time: while the whole computer stalls, the supervisor is silent as well.

A governed clock waits for the supervisor.
"""


class _Silence:
    """For how long the supervisor has been silent [s]."""

    def __init__(self, measured_on: _Time) -> None:
        self._time, self._polled_s = measured_on, measured_on.now_s()
        self._silent_s = 0.0

    def take(self, measured_on: _Time, reached_s: float, *, received: bool) -> float:
        """Take whether messages were received in a poll that began at a time; return the silence until then."""
        passed_s = max(reached_s - self._polled_s, 0.0) if measured_on is self._time else 0.0
        self._time, self._polled_s = measured_on, reached_s
        self._silent_s = 0.0 if received else self._silent_s + min(passed_s, measured_on.poll_max_s)
        return self._silent_s


class _Unsent:
    def rising(self) -> None:
        pass

    def tick(self, due_s: float) -> None:
        pass

    def ended(self) -> None:
        pass


class _HeartbeatSender:
    """Implements `agents.ports.Heartbeat`."""

    def __init__(self, connection: socket.socket, vehicle_id: int, now_s: Callable[[], float]) -> None:
        self._connection = connection
        self._vehicle_id = vehicle_id
        self._now_s = now_s
        self._sent_s = 0.0

    def rising(self) -> None:
        self._send(encode_beat(Beat.RISING, self._vehicle_id))

    def tick(self, due_s: float) -> None:
        now_s = self._now_s()
        if abs(now_s - self._sent_s) >= TICK_PERIOD_MIN_S:
            self._sent_s = now_s
            self._send(encode_beat(Beat.TICK, self._vehicle_id, due_s))

    def ended(self) -> None:
        self._send(encode_beat(Beat.ENDED, self._vehicle_id))

    def _send(self, record: bytes) -> None:
        with suppress(OSError):  # the supervisor has ended: the listening thread handles it
            self._connection.send(record)
