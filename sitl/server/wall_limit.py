"""Limits of wall time for which a process is waited for: on a busy computer one that does not go on need not hang."""

from contextlib import suppress
from pathlib import Path


class WallLimit:
    """A limit of wall time, which the time for which the process lacks the processor does not count to.

    That time is the one of the thread that lacks it longest. Where threads `hand_over` to one another, it is that of
    all of them, and the time for which they compute does not count either. While a thread lacks the processor, or waits
    for a disk, the limit is not over: the system adds up such times only once they end. These times are known on Linux
    only; elsewhere all the time counts.
    """

    def __init__(
        self, limit_s: float, longest_s: float, process: int, since_s: float, *, hand_over: bool = False
    ) -> None:
        """Take the limit, what it is extended to at most, and when it began by the monotonic clock."""
        self._limit_s, self._longest_s, self._hand_over = limit_s, longest_s, hand_over
        self._process, self._since_s = process, since_s
        self._before_s: dict[str, float] | None = None
        self._seen: dict[str, tuple[str, str]] = {}

    def is_over(self, wall_s: float) -> bool:
        """Return whether it is over at a time of the monotonic clock; to be asked again and again until then."""
        waited_for_s = wall_s - self._since_s
        if self._before_s is None:
            if waited_for_s > self._limit_s / 8.0:  # most go on long before, and to ask the system takes time
                self._before_s = self._excused_s()
                self._since_s = max(self._since_s, wall_s - self._limit_s / 4.0)  # who asks may have lacked it
            return False
        if waited_for_s <= self._limit_s:
            return False
        grown_s = [0.0, *(s - self._before_s.get(thread, 0.0) for thread, s in self._excused_s().items())]
        excused_s = sum(grown_s) if self._hand_over else max(grown_s)
        if waited_for_s > self._longest_s:
            return True
        return waited_for_s - excused_s > self._limit_s and not self._is_held_up()

    def _is_held_up(self) -> bool:
        """Return whether a thread has waited for processor or disk since the look before; true at the first look."""
        before, self._seen = self._seen, {}
        for thread in Path(f"/proc/{self._process}/task").glob("*"):
            with suppress(OSError, IndexError):
                state = (thread / "stat").read_text().rpartition(") ")[2][0]
                self._seen[thread.name] = (state, (thread / "schedstat").read_text())
        waiting = (each for each in self._seen.items() if each[1][0] in "RD")
        return bool(self._seen) and (not before or any(before.get(thread) == seen for thread, seen in waiting))

    def _excused_s(self) -> dict[str, float]:
        """Return by thread the time that does not count."""
        times_s = {}
        for thread in Path(f"/proc/{self._process}/task").glob("*"):
            with suppress(OSError, ValueError, IndexError):  # it has ended, or the kernel keeps no such statistics
                computed_ns, lacked_ns, _ = map(int, (thread / "schedstat").read_text().split())
                times_s[thread.name] = (lacked_ns + (computed_ns if self._hand_over else 0)) / 1e9
        return times_s
