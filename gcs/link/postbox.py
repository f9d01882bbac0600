"""Values of MAVSDK's threads on their way to the event loop."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from agents.shell.handover import Handover


class Postbox:
    """Has values taken on the running event loop, in the order in which they were posted."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()
        self._handover = Handover(self._loop, self._take_all)

    def post(self, take: Callable[..., object], *values: Any) -> None:
        """Have `take` called with values on the event loop, from any thread; once the loop is closed nothing happens.

        An exception of one goes to the loop's handler, and does not keep the others from theirs.
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
