"""A fixed rate kept by absolute deadlines.

Ticks that are a whole period late are counted and skipped, not made up in a burst.
"""

from dataclasses import dataclass
from math import ceil, floor
from typing import Protocol


class TickerClock(Protocol):
    """What a ticker needs of a clock."""

    def now_s(self) -> float:
        """Return the present time."""

    async def sleep_until(self, time_s: float) -> float:
        """Wait until a time has come, yielding at least once; return the time, which may be later."""


@dataclass(frozen=True, slots=True)
class TickTiming:
    """One tick: its deadline on the mission clock, its lateness, and the number of ticks skipped before it."""

    index: int
    deadline_s: float
    late_s: float
    skipped: int


@dataclass(frozen=True, slots=True)
class TickerStatistics:
    """The statistics of a ticker: ticks delivered, deadlines missed, largest lateness in mission seconds."""

    ticks: int = 0
    missed: int = 0
    late_max_s: float = 0.0

    def plus(self, other: "TickerStatistics") -> "TickerStatistics":
        """Return the statistics of both tickers."""
        late_max_s = max(self.late_max_s, other.late_max_s)
        return TickerStatistics(self.ticks + other.ticks, self.missed + other.missed, late_max_s)


def first_deadline_s(now_s: float, period_s: float, phase: float) -> float:
    """Return the first time not before `now_s` that is `phase` periods (0 to 1) after a multiple of the period [s]."""
    return (ceil(now_s / period_s - phase) + phase) * period_s


class Ticker:
    """Ticks every `period_s` of the mission clock: `async for tick in ticker`.

    The first deadline is `start_s`, by default the first use. The clock may wake it late. Deadlines lie on one grid,
    so lateness does not accumulate.
    """

    def __init__(self, period_s: float, clock: TickerClock, start_s: float | None = None) -> None:
        self._period_s = period_s
        self._clock = clock
        self._start_s = start_s
        self._next_index = 0
        self._ticks = 0
        self._missed = 0
        self._late_max_s = 0.0

    @property
    def statistics(self) -> TickerStatistics:
        """The statistics so far."""
        return TickerStatistics(self._ticks, self._missed, self._late_max_s)

    def __aiter__(self) -> "Ticker":
        return self

    async def __anext__(self) -> TickTiming:
        return await self.next()

    async def next(self) -> TickTiming:
        """Wait for the next deadline, skipping those that passed a whole period ago or more.

        Yields to other tasks at least once, even if it is late.
        """
        if self._start_s is None:
            self._start_s = self._clock.now_s()
        deadline_s = self._start_s + self._next_index * self._period_s
        now_s = await self._clock.sleep_until(deadline_s)
        skipped = max(floor((now_s - deadline_s) / self._period_s), 0)
        index = self._next_index + skipped
        # From the index, not by addition: a million additions of 0.1 are 0.1 ms off the grid.
        deadline_s = self._start_s + index * self._period_s
        self._next_index = index + 1
        return self._count(TickTiming(index, deadline_s, max(0.0, now_s - deadline_s), skipped))

    def _count(self, tick: TickTiming) -> TickTiming:
        self._ticks += 1
        self._missed += tick.skipped
        self._late_max_s = max(self._late_max_s, tick.late_s)
        return tick
