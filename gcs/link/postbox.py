"""Passes values from MAVSDK's threads to the event loop."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from agents.shell.handover import Handover


class Postbox:
    """Calls functions with posted values on the running event loop, in the order of posting."""

    def __init__(self, *, gathers: bool) -> None:
        """Take whether values are gathered for a moment, which costs less than a call for each."""
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()
        self._handover = Handover(self._loop, self._take_all, gathers=gathers)

    def post(self, take: Callable[..., object], *values: Any) -> None:
        """Call `take` with values on the event loop, from any thread; do nothing once the loop is closed.

        An exception goes to the loop's handler, and does not affect other calls.
        """
        self._waiting.append((take, values))
        self._handover.ask()

    def _take_all(self) -> None:
        for _ in range(len(self._waiting)):
            take, values = self._waiting.popleft()
            try:
                take(*values)
            except Exception as error:
                self._loop.call_exception_handler({"message": "a value of MAVSDK was not taken", "exception": error})
