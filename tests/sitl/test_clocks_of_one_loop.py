"""Two participants of a governed clock on one event loop, as a flight beside stubs of its own process."""

import asyncio
from math import inf

import pytest

from sitl.server.governed_clock import GovernedClock
from sitl.server.shared_clock import Rank, new_clock


async def test_two_clocks_of_one_event_loop_do_not_wait_for_each_other() -> None:
    with new_clock(50.0) as name, GovernedClock(name, Rank.STUBS) as stubs, GovernedClock(name, Rank.AGENTS) as agents:
        order: list[tuple[int, str]] = []

        async def tick(clock: GovernedClock, who: str, period_ms: int) -> None:
            began_s = clock.now_s()
            for number in range(1, 1 + 1000 // period_ms):
                await clock.sleep_until(began_s + 1e-3 * number * period_ms)
                order.append((round((clock.now_s() - began_s) * 1e3), who))

        await asyncio.wait_for(asyncio.gather(tick(agents, "agents", 100), tick(stubs, "stubs", 4)), 5.0)
    expected = [(ms, "stubs") for ms in range(4, 1001, 4)] + [(ms, "agents") for ms in range(100, 1001, 100)]
    assert order == sorted(expected, key=lambda each: (each[0], each[1] != "stubs"))


async def test_an_earlier_event_is_stated_before_another_clock_of_the_loop_looks() -> None:
    with new_clock(inf) as name, GovernedClock(name, Rank.STUBS) as stubs, GovernedClock(name, Rank.AGENTS) as agents:
        began_s = stubs.now_s()
        later = asyncio.create_task(stubs.sleep_until(began_s + 1.0))
        await asyncio.sleep(0)
        woken_s = await agents.sleep_until(began_s + 0.5)
        assert woken_s == pytest.approx(began_s + 0.5, abs=1e-6)
        await later
