"""A call on the event loop that other threads request: one call for all requests within a short time.

Each wake of the event loop costs several system calls, each of which releases the interpreter lock and waits for it
again. With many vehicles messages arrive more often than they have to be processed.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from math import inf
from time import monotonic

PERIOD_S = 0.002
"""The shortest time between two calls, and the longest wait of a message."""


class Handover:
    """Calls a function on an event loop, at once if the last call was not recent."""

    def __init__(self, loop: asyncio.AbstractEventLoop, call: Callable[[], object], *, gathers: bool = True) -> None:
        """Take the loop and the function; unless it `gathers` requests, each is met at once."""
        self._loop, self._call = loop, call
        self._period_s = PERIOD_S if gathers else 0.0
        self._requested = False
        self._called_s = -inf

    def request(self) -> None:
        """Request a call, from any thread; no effect once the loop is closed."""
        if self._requested:
            return
        self._requested = True
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._call_in_time)

    def _call_in_time(self) -> None:
        wait_s = self._called_s + self._period_s - monotonic()
        if wait_s > 0.0:
            self._loop.call_later(wait_s, self._call_now)
        else:
            self._call_now()

    def _call_now(self) -> None:
        self._requested = False  # before the call: a request during it may be too late for it
        try:
            self._call()
        finally:
            self._called_s = monotonic()
