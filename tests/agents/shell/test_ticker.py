"""The ticker on a fake clock: nothing here sleeps."""

from itertools import pairwise

import pytest

from agents.shell.ticker import Ticker, first_deadline_s


class FakeClock:
    """A mission clock `speed` times as fast as the wall; moved by sleep (plus an overshoot) and `work`."""

    def __init__(self, speed: float = 1.0, overshoot_wall_s: float = 0.0) -> None:
        self.time_s = 100.0
        self.speed = speed
        self.overshoot_wall_s = overshoot_wall_s
        self.slept_wall_s: list[float] = []

    def now_s(self) -> float:
        return self.time_s

    async def sleep_until(self, time_s: float) -> float:
        wall_s = max(time_s - self.time_s, 0.0) / self.speed
        self.slept_wall_s.append(wall_s)
        if wall_s > 0.0:
            self.time_s += (wall_s + self.overshoot_wall_s) * self.speed
        return self.time_s

    def work(self, mission_s: float) -> None:
        self.time_s += mission_s


def ticker_on(clock: FakeClock, period_s: float = 0.1) -> Ticker:
    return Ticker(period_s, clock)


async def test_the_first_tick_comes_at_once_and_the_rest_on_the_grid() -> None:
    clock = FakeClock()
    ticker = ticker_on(clock)
    times_s = []
    async for tick in ticker:
        times_s.append(clock.time_s)
        clock.work(0.03)
        if tick.index == 4:
            break
    assert times_s == pytest.approx([100.0, 100.1, 100.2, 100.3, 100.4])
    assert ticker.statistics.ticks == 5
    assert ticker.statistics.missed == 0


async def test_late_sleeps_never_add_up() -> None:
    # A millisecond of oversleep in every tick, at ten times real time: each tick 10 ms of mission time late.
    clock = FakeClock(speed=10.0, overshoot_wall_s=0.001)
    ticker = ticker_on(clock)
    ticks = [await ticker.next() for _ in range(1001)]
    assert ticks[-1].index == 1000
    assert ticks[-1].deadline_s == pytest.approx(200.0, abs=1e-9)
    assert clock.time_s == pytest.approx(200.01, abs=1e-6)
    statistics = ticker.statistics
    assert (statistics.ticks, statistics.missed) == (1001, 0)
    assert statistics.late_max_s == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize(("work_s", "index"), [(0.199, 1), (0.201, 2), (10.05, 100)])
async def test_whole_periods_late_are_counted_and_skipped(work_s: float, index: int) -> None:
    clock = FakeClock()
    ticker = ticker_on(clock)
    await ticker.next()
    clock.work(work_s)
    late = await ticker.next()
    assert (late.index, late.skipped) == (index, index - 1)
    assert late.late_s < 0.1
    following = await ticker.next()
    assert following.index == index + 1
    assert clock.time_s == pytest.approx(following.deadline_s)
    assert ticker.statistics.missed == index - 1
    assert ticker.statistics.ticks == 3


async def test_a_late_ticker_still_gives_way() -> None:
    clock = FakeClock()
    ticker = ticker_on(clock)
    for _ in range(3):
        await ticker.next()
        clock.work(1.0)
    assert len(clock.slept_wall_s) == 3


async def test_ticks_begin_at_the_start_that_is_given() -> None:
    clock = FakeClock()
    ticker = Ticker(0.1, clock, 100.03)
    times_s = [(await ticker.next(), clock.time_s)[1] for _ in range(3)]
    assert times_s == pytest.approx([100.03, 100.13, 100.23])


@pytest.mark.parametrize("now_s", [0.0, 1.7640e9 + 0.0123])
def test_the_vehicles_of_a_team_begin_evenly_over_one_period(now_s: float) -> None:
    """Whenever each of them begins, their deadlines have the same distances."""
    count, period_s = 32, 0.05
    first_s = [first_deadline_s(now_s + 0.31 * row, period_s, row / count) for row in range(count)]
    assert all(0.0 <= first - now_s - 0.31 * row < period_s + 1e-6 for row, first in enumerate(first_s))
    offsets_s = sorted((first - first_s[0]) % period_s for first in first_s)
    turned_s = sorted((offset + period_s / 2 / count) % period_s for offset in offsets_s)
    assert [after - before for before, after in pairwise(turned_s)] == pytest.approx([period_s / count] * 31, abs=1e-6)
