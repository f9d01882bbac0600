"""Limits of wall time for which a process is waited for: on a busy computer one that does not go on need not hang."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path


class WallLimit:
    """A limit of wall time, which the time for which the process lacks the processor does not count to.

    That time is the one of the thread that lacks it longest, or of all of them in `total`, where they work one after
    the other. It is known on Linux only; elsewhere all the time counts.
    """

    def __init__(
        self,
        limit_s: float,
        longest_s: float,
        process: int,
        since_s: float,
        total: Callable[[Iterable[float]], float] = max,
    ) -> None:
        """Take the limit, what it is extended to at most, and when it began by the monotonic clock."""
        self._limit_s, self._longest_s, self._total = limit_s, longest_s, total
        self._process, self._since_s = process, since_s
        self._before_s: dict[str, float] | None = None

    def is_over(self, wall_s: float) -> bool:
        """Return whether it is over at a time of the monotonic clock; to be asked again and again until then."""
        waited_for_s = wall_s - self._since_s
        if self._before_s is None:
            if waited_for_s > self._limit_s / 8.0:  # most go on long before, and to ask the system takes time
                self._before_s = _without_processor_s(self._process)
                self._since_s = max(self._since_s, wall_s - self._limit_s / 4.0)  # who asks may have lacked it
            return False
        if waited_for_s <= self._limit_s:
            return False
        now_s = _without_processor_s(self._process)
        lacked_s = self._total([0.0, *(s - self._before_s.get(thread, 0.0) for thread, s in now_s.items())])
        return waited_for_s - lacked_s > self._limit_s or waited_for_s > self._longest_s


def _without_processor_s(process: int) -> dict[str, float]:
    """Return by thread of a process how long it has been ready to run without a processor."""
    lacked_s = {}
    for thread in Path(f"/proc/{process}/task").glob("*"):
        with suppress(OSError, ValueError, IndexError):  # it has ended, or the kernel keeps no such statistics
            lacked_s[thread.name] = int((thread / "schedstat").read_text().split()[1]) / 1e9
    return lacked_s
