"""Limits of wall time for which a process is waited for: on a busy computer one that does not go on need not hang."""

from contextlib import suppress
from pathlib import Path

_LONGEST = 10.0
"""A limit is over after so many times its length, however long the process has waited for the processor."""


class WallLimit:
    """A limit of wall time, which the time for which threads of the process wait for the processor does not count to.

    They may do so one after the other: their times are summed up. That is known on Linux only; elsewhere all counts.
    """

    def __init__(self, limit_s: float, process: int, since_s: float) -> None:
        self._limit_s, self._process, self._since_s = limit_s, process, since_s
        self._lacked_before_s: float | None = None

    def is_over(self, wall_s: float) -> bool:
        """Return whether it is over at a time of the monotonic clock; to be asked again and again until then."""
        waited_for_s = wall_s - self._since_s
        if self._lacked_before_s is None:
            if waited_for_s > self._limit_s / 8.0:  # most go on long before, and to ask the system takes time
                self._lacked_before_s = _without_processor_s(self._process)
                self._since_s = max(self._since_s, wall_s - self._limit_s / 4.0)  # who asks may have lacked it
            return False
        if waited_for_s <= self._limit_s:
            return False
        lacked_s = _without_processor_s(self._process) - self._lacked_before_s
        return waited_for_s - lacked_s > self._limit_s or waited_for_s > _LONGEST * self._limit_s


def _without_processor_s(process: int) -> float:
    """Return how long the threads of a process have been ready to run without a processor, in sum."""
    lacked_s = 0.0
    for thread in Path(f"/proc/{process}/task").glob("*"):
        with suppress(OSError, ValueError, IndexError):  # it has ended, or the kernel keeps no such statistics
            lacked_s += int((thread / "schedstat").read_text().split()[1]) / 1e9
    return lacked_s
