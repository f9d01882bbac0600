"""A thread that runs relays and passes on what arrives for any of them.

Each system call releases the interpreter lock and has to acquire it again. One thread for all connections acquires it
once for everything that has arrived meanwhile; a thread per connection would acquire it once per vehicle.
"""

import select
import socket
import threading
import time
import traceback
from collections.abc import Container, Iterable, Sequence
from contextlib import suppress
from math import ceil
from typing import Protocol

WAKE_PERIOD_S = 0.25
"""Longest time between turns, for the waiting bytes of a slow stream and for ended connections."""
GATHER_S, GATHER_MAX_S, A_FEW = 1e-4, 5e-3, 4
"""With more than a few relays, what arrives within this time for each of them after the first bytes is passed on with
them.
"""
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
        look_next_s, watch = 0.0, _Watch(self._woken_end.fileno())
        while relays := self._next():
            watch.keep(relays)
            due_s = min(relay.due_s() for relay in relays)
            readable = watch.wait(min(max(due_s - time.monotonic(), 0.0), WAKE_PERIOD_S))
            if len(relays) > A_FEW:
                time.sleep(min(GATHER_S * len(relays), GATHER_MAX_S))
                readable = watch.wait(0.0)
            now_s = time.monotonic()
            everything = self._woken_end.fileno() in readable or now_s >= look_next_s
            if everything:
                look_next_s = now_s + WAKE_PERIOD_S
                with suppress(BlockingIOError):
                    self._woken_end.recv(WAKES_MAX)
            with self._running:
                self._waits += 1
                self._running.notify_all()
                for relay in relays if everything or now_s >= due_s else watch.relays(readable):
                    descriptors = watch.descriptors(relay)
                    due = everything or not readable.isdisjoint(descriptors) or relay.due_s() <= now_s
                    if relay in self._relays and due:
                        self._turn(relay, descriptors if everything else readable)
                        watch.look_at(relay)

    def _next(self) -> Sequence[Turns]:
        """Return the relays to run; without relays the thread ends."""
        with self._running:
            if not self._relays:
                self._thread = None
                self._waits += 1
                self._running.notify_all()
            return tuple(self._relays)

    def _turn(self, relay: Turns, readable: Container[int]) -> None:
        try:
            relay.turn(readable)
        except Exception:  # a bug in one relay silences its vehicles; the others fly on
            traceback.print_exc()
            self._relays.remove(relay)


class _Watch:
    """The descriptors to wait for: those of the thread's relays, which change in their turns only, and one to wake it.

    To look at those of all relays before each wait took longer than the turns of 32 vehicles.
    """

    def __init__(self, woken: int) -> None:
        self._poll = select.poll()
        self._poll.register(woken, select.POLLIN)
        self._descriptors: dict[Turns, tuple[int, ...]] = {}
        self._relays: dict[int, Turns] = {}

    def keep(self, relays: Sequence[Turns]) -> None:
        """Watch these relays only."""
        if len(relays) == len(self._descriptors) and all(each in self._descriptors for each in relays):
            return
        for gone in self._descriptors.keys() - set(relays):
            self._watch(gone, ())
            del self._descriptors[gone]
        for each in relays:
            self.look_at(each)

    def look_at(self, relay: Turns) -> None:
        """Watch the descriptors that a relay has now."""
        self._watch(relay, relay.watched())

    def _watch(self, relay: Turns, descriptors: tuple[int, ...]) -> None:
        before = self._descriptors.get(relay, ())
        if descriptors == before:
            return
        for each in before:
            if self._relays.get(each) is relay:  # else it has been closed, and is another relay's by now
                del self._relays[each]
                self._poll.unregister(each)
        for each in descriptors:
            self._relays[each] = relay
            self._poll.register(each, select.POLLIN)
        self._descriptors[relay] = descriptors

    def descriptors(self, relay: Turns) -> tuple[int, ...]:
        """Return the descriptors of a relay."""
        return self._descriptors[relay]

    def relays(self, readable: Iterable[int]) -> Sequence[Turns]:
        """Return the relays of descriptors, each once."""
        return tuple(dict.fromkeys(self._relays[each] for each in readable if each in self._relays))

    def wait(self, wait_s: float) -> set[int]:
        """Wait until one of the descriptors can be read or has been closed, at most `wait_s`; return those."""
        return {descriptor for descriptor, _ in self._poll.poll(ceil(wait_s * 1e3))}
