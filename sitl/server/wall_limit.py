"""Limits of wall time for which a process is waited for: on a busy computer one that does not go on need not hang."""

from contextlib import suppress
from pathlib import Path


class WallLimit:
    """A limit of wall time, which the time for which the process waits for the processor does not count towards.

    That is known on Linux only; elsewhere all the time counts.
    """

    def __init__(self, limit_s: float, process: int, since_s: float) -> None:
        self._limit_s, self._process, self._since_s = limit_s, process, since_s
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
        longest_s = max((s - self._before_s.get(thread, 0.0) for thread, s in now_s.items()), default=0.0)
        return waited_for_s - longest_s > self._limit_s


def _without_processor_s(process: int) -> dict[str, float]:
    """Return by thread of a process how long it has been ready to run without a processor."""
    waited_s = {}
    for thread in Path(f"/proc/{process}/task").glob("*"):
        with suppress(OSError, ValueError, IndexError):  # it has ended, or the kernel keeps no such statistics
            waited_s[thread.name] = int((thread / "schedstat").read_text().split()[1]) / 1e9
    return waited_s
