"""An event loop without sockets in simulated time: a sleep of an hour takes no wall time."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

Result = TypeVar("Result")


class SimulatedLoop(asyncio.BaseEventLoop):
    """Advances its time to the next timer when no callback is ready."""

    def __init__(self) -> None:
        super().__init__()
        self._time_s = 0.0
        self._selector = self

    def time(self) -> float:
        return self._time_s

    def select(self, timeout: float | None) -> list[object]:
        """Replace a selector: `timeout` is the time until the next timer, None without one."""
        if timeout is None:
            raise RuntimeError("nothing will ever happen again")
        self._time_s += max(timeout, 0.0)
        return []

    def _process_events(self, event_list: list[object]) -> None:
        assert not event_list

    def _write_to_self(self) -> None:
        raise AssertionError("something came from another thread")


def run_simulated(main: Coroutine[Any, Any, Result]) -> Result:
    """Run a coroutine on such a loop; also raises unhandled exceptions of its tasks and callbacks."""
    lost: list[BaseException] = []
    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        loop = runner.get_loop()
        loop.set_exception_handler(lambda _, context: lost.append(context.get("exception") or _unnamed(context)))
        result = runner.run(main)
    if lost:
        raise lost[0]
    return result


def _unnamed(context: dict[str, Any]) -> BaseException:
    return AssertionError(str(context["message"]))
