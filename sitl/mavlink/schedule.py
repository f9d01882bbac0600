"""The schedule of telemetry messages, in simulated time."""

from collections.abc import Iterable, Mapping
from math import ceil, inf

TOLERANCE_S = 1e-6
"""A message is due up to this long before its time, because the sum of physics steps has rounding errors."""


class Schedule:
    """Message ids with an interval each; ids without a default rate are sent on request only."""

    def __init__(self, rates_hz: Mapping[int, float], known: Iterable[int]) -> None:
        """Start every message of `rates_hz` at once; `known` are the ids with a settable interval."""
        self._default_s = {message: 1.0 / rate for message, rate in rates_hz.items()}
        self._known = frozenset(known)
        self._interval_s = dict(self._default_s)
        self._due_s = dict.fromkeys(self._interval_s, 0.0)
        self._next_s = 0.0

    def interval_s(self, message: int) -> float | None:
        """Return a message's interval; None if it is not being sent."""
        return self._interval_s.get(message)

    def set_interval(self, message: int, interval_s: float | None, *, now_s: float) -> bool:
        """Set an interval (0 restores the default, None stops); return whether the message is known."""
        if message not in self._known:
            return False
        interval = self._default_s.get(message) if interval_s == 0.0 else interval_s
        self._interval_s.pop(message, None)
        self._due_s.pop(message, None)
        if interval is not None:
            self._interval_s[message] = interval
            # On a grid from the start: what a client requests a moment later comes at the same times nevertheless.
            self._due_s[message] = ceil(now_s / interval - TOLERANCE_S) * interval
        self._next_s = now_s
        return True

    def due(self, now_s: float) -> list[int]:
        """Return the messages due at `now_s` and schedule the next ones; missed ones are not made up."""
        if now_s + TOLERANCE_S < self._next_s:
            return []
        latest_s = now_s + TOLERANCE_S
        due = [message for message, due_s in self._due_s.items() if due_s <= latest_s]
        for message in due:
            interval = self._interval_s[message]
            next_s = self._due_s[message] + interval
            self._due_s[message] = next_s if next_s > now_s else now_s + interval
        self._next_s = min(self._due_s.values(), default=inf)
        return due
