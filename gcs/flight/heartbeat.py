"""The flying process's end of the lifeline: shows that its control loops live, and lands when nobody watches it."""

import os
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Protocol, Self

from agents.ports import Heartbeat
from gcs import signals
from gcs.flight.supervision import (
    LIFELINE,
    POLL_PERIOD_S,
    STOP,
    Sign,
    encode_sign,
)

TOLD_PERIOD_S = 0.04
"""A faster loop tells of fewer ticks: the supervisor looks ten times a second."""
SUPERVISOR_SILENCE_POLLS = 30
"""A supervisor silent for so many of this process's own polls, 3 s, is as good as dead: it may have been stopped."""


class Supervision(Protocol):
    """Who watches a flight from outside: what it is shown, and how the operator's wish to end comes through."""

    def signs(self, vehicle_id: int) -> Heartbeat:
        """Return what a vehicle's agent shows its life by."""
        ...

    def relay(self, ask: Callable[[], object]) -> None:
        """Call `ask`, on another thread, for each time the operator wants to end."""
        ...


class Unsupervised:
    """Nobody watches: signals come straight to this process, as in a program that flies by `gcs.flight.flight`."""

    def signs(self, _vehicle_id: int) -> Heartbeat:
        """Return what shows nothing."""
        return _NoSigns()

    def relay(self, ask: Callable[[], object]) -> None:
        """Call `ask` for each signal."""
        signals.relay(ask)


class SupervisorHeartbeat:
    """This process's end of the socket pair, to be used as a context manager around the flight.

    `orphaned` is called, on another thread, when the supervisor is gone.
    """

    def __init__(self, connection: socket.socket, orphaned: Callable[[], object]) -> None:
        connection.setblocking(False)
        connection.set_inheritable(False)
        self._connection = connection
        self._orphaned = orphaned
        self._listener: threading.Thread | None = None
        self._closing = False

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let go: nothing flies any more."""
        self._closing = True
        if self._listener is not None:
            self._listener.join()
        self._connection.close()

    @classmethod
    def inherited(cls, orphaned: Callable[[], object]) -> Self:
        """Return the one that the supervisor left to this process, and keep it from processes started by this one."""
        return cls(socket.socket(fileno=int(os.environ.pop(LIFELINE))), orphaned)

    def signs(self, vehicle_id: int) -> Heartbeat:
        """Return what a vehicle's agent shows its life by."""
        return _Signs(self._connection, vehicle_id)

    def relay(self, ask: Callable[[], object]) -> None:
        """Call `ask` for each time the operator wants to end, and once if the supervisor is lost before that."""

        def listen() -> None:
            with suppress(RuntimeError):  # the loop that was to be asked has ended: so has what it did
                self._listen(ask)

        self._listener = threading.Thread(target=listen, name="lifeline", daemon=True)
        self._listener.start()

    def _listen(self, ask: Callable[[], object]) -> None:
        asked, silent_polls = False, 0
        while not self._closing:
            words = self._words()
            silent_polls = 0 if words else silent_polls + 1
            wishes = words.count(STOP) if words else 0
            lost = words == b"" or silent_polls == SUPERVISOR_SILENCE_POLLS
            if lost:
                wishes = 0 if asked else 1  # a second one would mean: in a hurry
            for _ in range(wishes):
                ask()
            asked = asked or wishes > 0
            if lost:
                self._orphaned()  # after asking: to tell may fail, where a terminal has gone too
            if words == b"":
                return

    def _words(self) -> bytes | None:
        """Return what the supervisor says; None when it says nothing for a poll's time, nothing when it is gone."""
        if not select.select([self._connection], [], [], POLL_PERIOD_S)[0]:
            return None
        try:
            return self._connection.recv(4096)
        except OSError:  # it died with signs unread
            return b""


class _NoSigns:
    def rising(self) -> None:
        pass

    def tick(self, due_s: float) -> None:
        pass

    def ended(self) -> None:
        pass


class _Signs:
    """Implements `agents.ports.Heartbeat`."""

    def __init__(self, connection: socket.socket, vehicle_id: int) -> None:
        self._connection = connection
        self._vehicle_id = vehicle_id
        self._told_s = 0.0

    def rising(self) -> None:
        self._send(encode_sign(Sign.RISING, self._vehicle_id))

    def tick(self, due_s: float) -> None:
        now_s = time.monotonic()
        if now_s - self._told_s >= TOLD_PERIOD_S:
            self._told_s = now_s
            self._send(encode_sign(Sign.TICK, self._vehicle_id, due_s))

    def ended(self) -> None:
        self._send(encode_sign(Sign.ENDED, self._vehicle_id))

    def _send(self, record: bytes) -> None:
        with suppress(OSError):  # nobody reads: the other thread sees to that
            self._connection.send(record)
