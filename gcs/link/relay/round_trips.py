"""The round trips of TIMESYNC requests between this computer and one vehicle. No clock: times are arguments."""

from collections import deque
from statistics import median

KEPT = 15
"""Number of round trips in the median: half a minute of them."""
PENDING = 16


class RoundTrips:
    """Measures round trips: each answer returns the time of its request."""

    def __init__(self) -> None:
        self._asked_ns: deque[int] = deque(maxlen=PENDING)
        self._newest_s: deque[float] = deque(maxlen=KEPT)

    @property
    def median_s(self) -> float | None:
        """The median of the newest round trips [wall s]; None before the first."""
        return median(self._newest_s) if self._newest_s else None

    def asked(self, time_ns: int) -> None:
        """Note a request that has been sent."""
        self._asked_ns.append(time_ns)

    def answered(self, asked_ns: int, now_ns: int) -> bool:
        """Note an answer; return whether it is the first one to a request of this computer."""
        if asked_ns not in self._asked_ns:
            return False
        self._asked_ns.remove(asked_ns)
        self._newest_s.append((now_ns - asked_ns) * 1e-9)
        return True
