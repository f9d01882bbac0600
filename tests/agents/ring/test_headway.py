"""Headway: which vehicles count, and at which rates and radius a vehicle keeps its distance to them."""

from collections.abc import Sequence
from math import cos, hypot, inf, pi, sin

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agents.ring.detour import Headway, Motion
from estimation.polar import Polar

OWN = Polar(10.0, pi - 0.1, 0.0, 0.05)
SIDES = {1.0: 1, -1.0: 0}
"""The index of the bound on the rate, by the direction in which the other vehicle is."""


def other(radius_m: float, ahead_rad: float, rate_rad_s: float = 0.0) -> Motion:
    """Return the motion of a vehicle on a circle about the target, `ahead_rad` counter-clockwise of the own one."""
    x, y = cos(OWN.bearing_rad + ahead_rad), sin(OWN.bearing_rad + ahead_rad)
    speed_m_s = radius_m * rate_rad_s
    return radius_m * x, radius_m * y, -speed_m_s * y, speed_m_s * x


def headway(others: Sequence[Motion], headway_m: float) -> Headway:
    kept = Headway(OWN, headway_m, 6.0)
    for each in others:
        kept.keep_to(each)
    return kept


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_vehicle_keeps_the_rate_of_the_next_one_at_its_headway(direction: float) -> None:
    def rate_rad_s(headway_m: float, *more: Motion) -> float:
        next_ahead = other(11.0, direction * 0.5, direction * 0.04)
        rates = headway([*more, next_ahead], headway_m).rates_rad_s
        assert abs(rates[1 - SIDES[direction]]) == inf  # nothing is behind
        return direction * rates[SIDES[direction]]

    # At its headway it flies as fast as the one ahead; nearer slower, farther away faster.
    assert rate_rad_s(5.0) == pytest.approx(0.04)
    assert rate_rad_s(3.0) > 0.04
    assert 0.0 <= rate_rad_s(5.5) < 0.04
    assert rate_rad_s(9.0) == 0.0
    assert rate_rad_s(5.0, other(10.0, direction * 0.6, direction * 0.04)) == pytest.approx(0.04)


@given(st.floats(-pi, pi), st.floats(5.0, 30.0))
def test_those_count_that_are_up_to_a_quarter_turn_away_and_about_as_far_out(ahead_rad: float, radius_m: float) -> None:
    assume(all(abs(ahead_rad - edge_rad) > 1e-6 for edge_rad in (-pi, -pi / 2.0, 0.0, pi / 2.0, pi)))
    assume(abs(radius_m - 16.0) > 1e-6)
    rates = headway([other(radius_m, ahead_rad)], 3.0).rates_rad_s
    bound = [abs(rate) != inf for rate in rates]
    counts = abs(ahead_rad) < pi / 2.0 and radius_m < 16.0
    assert bound == [counts and ahead_rad < 0.0, counts and ahead_rad > 0.0]


@given(st.floats(-pi, pi), st.floats(0.1, 30.0), st.floats(1.0, 8.0))
def test_behind_a_vehicle_farther_in_the_radius_keeps_the_headway(
    ahead_rad: float, radius_m: float, headway_m: float
) -> None:
    it = other(radius_m, ahead_rad)
    least_m = headway([it], headway_m).least_m
    towards = cos(OWN.bearing_rad), sin(OWN.bearing_rad)

    def apart_m(own_m: float) -> float:
        return hypot(own_m * towards[0] - it[0], own_m * towards[1] - it[1])

    assert 0.0 <= least_m <= OWN.radius_m
    if least_m > 0.0:
        assert radius_m < OWN.radius_m
        # It never has to fly outwards for it, and may come as near as the headway.
        assert least_m == OWN.radius_m or apart_m(least_m) == pytest.approx(headway_m, abs=1e-6)
    elif abs(ahead_rad) < pi / 2.0 and radius_m < OWN.radius_m - headway_m:
        assert abs(radius_m * sin(ahead_rad)) >= headway_m - 1e-9  # it passes beside it
