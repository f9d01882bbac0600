"""The wall's clock of a mission."""

import asyncio
import time

import pytest

from agents.shell.clock import WallClock
from tests.support.simulated_loop import run_simulated


class Drowsy(WallClock):
    """A clock by the event loop's time, whose sleeps end early."""

    def __init__(self, speed: float) -> None:
        super().__init__(speed)
        self.sleeps = 0

    def now_s(self) -> float:
        return asyncio.get_running_loop().time() * self.speed

    async def sleep(self, duration_s: float) -> None:
        self.sleeps += 1
        await asyncio.sleep(max(duration_s / 2.0, 1e-4) / self.speed)


def test_it_counts_unix_seconds_at_its_speed() -> None:
    clock = WallClock(10.0)
    assert clock.now_s() == pytest.approx(10.0 * time.time(), abs=0.5)
    clock.set_speed(2.0)
    assert clock.now_s() == pytest.approx(2.0 * time.time(), abs=0.1)
    assert (clock.time_scale, clock.allowed_s(1.0), clock.allowed_s(7.0)) == (2.0, 6.0, 7.0)


def test_a_sleep_that_ends_early_is_slept_again() -> None:
    async def slept() -> None:
        clock = Drowsy(speed=4.0)
        assert await clock.sleep_until(0.1) >= 0.1
        assert asyncio.get_running_loop().time() == pytest.approx(0.1 / 4.0, abs=1e-3)
        assert clock.sleeps <= 15  # halving the rest each time, not creeping up to it

    run_simulated(slept())


def test_calls_and_sleeps_take_the_wall_time_of_their_speed() -> None:
    async def called() -> None:
        loop, clock, times_s = asyncio.get_running_loop(), Drowsy(5.0), list[float]()
        clock.call_at(clock.now_s() + 10.0, lambda: times_s.append(loop.time()))
        clock.call_at(clock.now_s() + 5.0, lambda: times_s.append(-1.0)).cancel()
        await WallClock.sleep(clock, 20.0)
        assert times_s == [pytest.approx(2.0)]
        assert loop.time() == pytest.approx(4.0)

    run_simulated(called())
