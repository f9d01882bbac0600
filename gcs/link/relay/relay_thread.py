"""A thread that runs relays and passes on what arrives for any of them.

Each system call releases the interpreter lock and has to acquire it again. One thread for all connections acquires it
once for everything that has arrived meanwhile; a thread per connection would acquire it once per vehicle.
"""

import select
import socket
import threading
import time
import traceback
from collections.abc import Container, Sequence
from contextlib import suppress
from itertools import chain
from math import ceil
from typing import Protocol

WAKE_PERIOD_S = 0.25
"""Longest time between turns, for the waiting bytes of a slow stream and for ended connections."""
GATHER_S, A_FEW = 0.001, 4
"""With more than a few relays, what arrives within this time after the first bytes is passed on with them."""
WAKES_MAX = 64
REMOVED_WITHIN_S = 2.0


class Turns(Protocol):
    """An object that a relay thread runs."""

    def watched(self) -> tuple[int, ...]:
        """Return the file descriptors that become readable."""
        ...

    def due_s(self) -> float:
        """Return when a turn is due even if nothing arrives [s, monotonic]; infinity for none."""
        ...

    def turn(self, readable: Container[int]) -> None:
        """Pass on what has arrived; called at least four times a second, then with all descriptors."""
        ...


class RelayThread:
    """Runs relays from `add` to `remove`; the thread ends with the last of them. Use it from any other thread."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._relays: list[Turns] = []
        self._running = threading.Condition()
        """Held during turns, and while the list of relays changes; notified after each wait for input."""
        self._waits = 0
        self._wake_end, self._woken_end = socket.socketpair()
        self._woken_end.setblocking(False)
        self._thread: threading.Thread | None = None

    def add(self, relay: Turns) -> None:
        """Run a relay from now on."""
        with self._running:
            self._relays.append(relay)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
        self.wake()

    def remove(self, relay: Turns) -> None:
        """Stop running a relay; do nothing for one that is not run.

        Once this returns, none of its turns is under way, and the thread does not wait for its descriptors: a socket
        that is waited for stays open although it has been closed.
        """
        with self._running:
            if relay not in self._relays:
                return
            self._relays.remove(relay)
            waits = self._waits
            self.wake()
            self._running.wait_for(lambda: self._waits > waits, REMOVED_WITHIN_S)

    def wake(self) -> None:
        """Give every relay a turn now."""
        self._wake_end.send(b"\0")

    def close(self) -> None:
        """Release its file descriptors; no relay may be left."""
        thread = self._thread
        if thread is not None:
            thread.join(REMOVED_WITHIN_S)
        self._wake_end.close()
        self._woken_end.close()

    def _run(self) -> None:
        look_next_s = 0.0
        while relays := self._next():
            readable = self._wait_readable(relays)
            if len(relays) > A_FEW:
                time.sleep(GATHER_S)
            now_s = time.monotonic()
            everything = self._woken_end.fileno() in readable or now_s >= look_next_s
            if everything:
                look_next_s = now_s + WAKE_PERIOD_S
                with suppress(BlockingIOError):
                    self._woken_end.recv(WAKES_MAX)
            with self._running:
                self._waits += 1
                self._running.notify_all()
                for relay, descriptors in relays:
                    due = everything or not readable.isdisjoint(descriptors) or relay.due_s() <= now_s
                    if relay in self._relays and due:
                        self._turn(relay, descriptors if everything else readable)

    def _next(self) -> Sequence[tuple[Turns, tuple[int, ...]]]:
        """Return the relays to run and their descriptors; without relays the thread ends."""
        with self._running:
            if not self._relays:
                self._thread = None
                self._waits += 1
                self._running.notify_all()
            return [(relay, relay.watched()) for relay in self._relays]

    def _turn(self, relay: Turns, readable: Container[int]) -> None:
        try:
            relay.turn(readable)
        except Exception:  # a bug in one relay silences its vehicles; the others fly on
            traceback.print_exc()
            self._relays.remove(relay)

    def _wait_readable(self, relays: Sequence[tuple[Turns, tuple[int, ...]]]) -> set[int]:
        """Wait until one of the descriptors can be read, has been closed, or a turn is due; return those."""
        poll = select.poll()
        for descriptor in (self._woken_end.fileno(), *chain.from_iterable(each for _, each in relays)):
            poll.register(descriptor, select.POLLIN)
        due_s = min(relay.due_s() for relay, _ in relays)
        wait_s = min(max(due_s - time.monotonic(), 0.0), WAKE_PERIOD_S)
        return {descriptor for descriptor, _ in poll.poll(ceil(wait_s * 1e3))}
