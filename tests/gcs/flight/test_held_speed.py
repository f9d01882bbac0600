"""The speed of a flight of stubs, by how much work the computer does in a second."""

import pytest

from gcs.flight.preparation.held_speed import LOAD_MAX, SAMPLE_S, TICK_WORK, held_speed, speed_for

TRIO = 30.0
"""Ticks a second of three vehicles at 10 Hz."""


class SlowComputer:
    """A clock that advances by so much each time it is read: once for each piece of work."""

    def __init__(self, work_s: float) -> None:
        self.now_s, self._work_s = 0.0, work_s

    def __call__(self) -> float:
        self.now_s += self._work_s
        return self.now_s


@pytest.mark.parametrize(
    ("asked", "work_per_s", "held"),
    [
        (10.0, 4000.0, 10.0),
        (10.0, 10.0 * TICK_WORK * TRIO / LOAD_MAX, 10.0),
        (10.0, 7.449 * TICK_WORK * TRIO / LOAD_MAX, 7.4),
        (50.0, 7.449 * TICK_WORK * TRIO / LOAD_MAX, 7.4),
        (10.0, 1.0, 1.0),
    ],
    ids=["fast", "just", "rounded down", "asked for more", "never below the wall clock"],
)
def test_the_load_of_a_flight_stays_below_its_limit(asked: float, work_per_s: float, held: float) -> None:
    assert speed_for(asked, TRIO, work_per_s) == held


def test_twice_the_vehicles_are_held_at_half_the_speed() -> None:
    assert speed_for(50.0, 2.0 * TRIO, 1600.0) == pytest.approx(speed_for(50.0, TRIO, 1600.0) / 2.0, abs=0.1)


def test_a_slow_computer_is_measured_by_the_wall_clock() -> None:
    clock = SlowComputer(0.0025)  # 400 pieces of work a second, and one reading more than that
    assert held_speed(10.0, TRIO, clock) == pytest.approx(400.0 * LOAD_MAX / (TICK_WORK * TRIO), abs=0.15)
    assert clock.now_s == pytest.approx(SAMPLE_S, abs=0.01)


@pytest.mark.parametrize("asked", [0.2, 1.0])
def test_the_wall_clocks_speed_is_not_measured(asked: float) -> None:
    clock = SlowComputer(1.0)
    assert held_speed(asked, TRIO, clock) == asked
    assert clock.now_s == 0.0
