"""The rate at which a vehicle takes itself to go around: the ring's, and what is flown of it."""

from math import exp

import pytest

from agents.situation.estimator import RingFrequency

RATE_HZ = 20.0
WAYS = pytest.mark.parametrize("way", [1.0, -1.0])


def after(turning: RingFrequency, seconds: float, ring_rad_s: float, flown_rad_s: float) -> float:
    for _ in range(round(seconds * RATE_HZ)):
        turning.follow(ring_rad_s, flown_rad_s)
    return turning.rate_rad_s


@WAYS
def test_it_begins_with_the_rings_rate_and_follows_the_flown_one_within_twenty_seconds(way: float) -> None:
    turning = RingFrequency(RATE_HZ)
    turning.follow(way * 0.1)
    assert turning.rate_rad_s == way * 0.1
    assert after(turning, 20.0, way * 0.1, way * 0.095) == pytest.approx(way * (0.095 + 0.005 * exp(-1.0)), rel=1e-3)


@WAYS
def test_who_flies_another_way_is_taken_to_go_around_at_nearly_the_rings_rate(way: float) -> None:
    turning = RingFrequency(RATE_HZ)
    assert after(turning, 60.0, way * 0.1, way * -0.3) == pytest.approx(way * 0.08)
    assert after(turning, 60.0, way * 0.1, way * 0.3) == pytest.approx(way * 0.12)


def test_it_slows_down_with_the_ring_and_is_none_off_the_ring() -> None:
    turning = RingFrequency(RATE_HZ)
    assert after(turning, 200.0, 0.1, 0.095) == pytest.approx(0.095, rel=1e-4)
    turning.follow(0.05)
    assert turning.rate_rad_s == pytest.approx(0.0475, rel=1e-4)
    turning.follow(0.0, 0.095)
    assert turning.rate_rad_s == 0.0
    turning.follow(0.1)
    assert turning.rate_rad_s == 0.1
