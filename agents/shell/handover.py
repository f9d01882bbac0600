"""A call on the event loop that other threads ask for: one call for all that ask within a short time.

Each wake of the event loop costs it several system calls, and each of these the interpreter lock, which it has to get
back from the other threads. With many vehicles messages come more often than they have to be taken.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from math import inf
from time import monotonic

PERIOD_S = 0.002
"""The least time between two calls: what has arrived waits that long at most."""


class Handover:
    """Calls a function on an event loop, at once where the last call is long ago."""

    def __init__(self, loop: asyncio.AbstractEventLoop, call: Callable[[], object]) -> None:
        self._loop, self._call = loop, call
        self._asked = False
        self._called_s = -inf

    def ask(self) -> None:
        """Have the function called, from any thread; once the loop is closed nothing happens."""
        if self._asked:
            return
        self._asked = True
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._call_in_time)

    def _call_in_time(self) -> None:
        wait_s = self._called_s + PERIOD_S - monotonic()
        if wait_s > 0.0:
            self._loop.call_later(wait_s, self._call_now)
        else:
            self._call_now()

    def _call_now(self) -> None:
        self._asked = False  # before the call: who asks during it may have come too late for it
        try:
            self._call()
        finally:
            self._called_s = monotonic()
