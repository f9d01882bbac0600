"""The asynchronous activities of an agent: at most one of each kind at a time; each reports its end as an event."""

import asyncio
from collections.abc import Callable, Coroutine
from enum import Enum, auto

from agents.ports import VehicleRefusedError
from agents.shell.life import LifeEvent


class ActivityKind(Enum):
    """The kinds of activities."""

    CALL = auto()
    """Calls the link, except for a kill."""
    TICKS = auto()
    START = auto()
    """Compares clocks, agrees on the start, waits for the mission's end."""
    OPERATOR = auto()
    """Waits for the operator to stop the flight."""
    HOLD = auto()
    """Waits until the vehicle has come to rest after a stop."""
    KILL = auto()


Work = Callable[[], Coroutine[None, None, LifeEvent | None]]


class Activities:
    """Runs activities; an activity that replaces another of its kind begins when that one has ended."""

    def __init__(
        self,
        report: Callable[[LifeEvent, VehicleRefusedError | None], object],
        fail: Callable[[ActivityKind, Exception], object],
    ) -> None:
        """Take the receivers of the event at the end of an activity, and of an exception that is not a refusal."""
        self._report = report
        self._fail = fail
        self._tasks: dict[ActivityKind, set[asyncio.Task[None]]] = {kind: set() for kind in ActivityKind}

    def start(self, kind: ActivityKind, work: Work, refused: LifeEvent | None = None) -> None:
        """Start an activity: its event is what `work` returns, or `refused` if it raises VehicleRefusedError."""
        self.cancel(kind)
        before = frozenset(self._tasks[kind])
        task = asyncio.create_task(self._run(kind, work, refused, before))
        self._tasks[kind].add(task)
        task.add_done_callback(self._tasks[kind].discard)

    def running(self, kind: ActivityKind) -> bool:
        """Return whether an activity of a kind has not ended."""
        return any(not task.done() for task in self._tasks[kind])

    def cancel(self, *kinds: ActivityKind) -> None:
        """Cancel activities."""
        for kind in kinds:
            for task in self._tasks[kind]:
                task.cancel()

    async def stop(self, *kinds: ActivityKind) -> None:
        """Cancel activities and wait until they have ended."""
        self.cancel(*kinds)
        tasks = [task for kind in kinds for task in self._tasks[kind]]
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(
        self, kind: ActivityKind, work: Work, refused: LifeEvent | None, before: frozenset[asyncio.Task[None]]
    ) -> None:
        if before:
            await asyncio.wait(before)
        refusal: VehicleRefusedError | None = None
        try:
            event = await work()
        except VehicleRefusedError as error:
            event, refusal = refused, error
        except Exception as error:
            self._fail(kind, error)
            return
        if event is not None:
            self._report(event, refusal)
