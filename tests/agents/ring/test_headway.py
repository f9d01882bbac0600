"""Headway: who counts as ahead, and what a column of vehicles does that would all rather be faster."""

from math import cos, inf, pi, sin

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agents.ring.detour import headway_rate_rad_s, leads
from estimation.polar import Polar

directions = st.sampled_from([1.0, -1.0])


@given(directions)
def test_only_those_ahead_and_about_as_far_out_count(direction: float) -> None:
    own = Polar(10.0, pi - 0.1, 0.0, 0.05)
    assert headway_rate_rad_s(own, [], direction, 3.0) == inf
    behind, across, outside = (
        Polar(10.0, own.bearing_rad - direction * 0.2, 0.0, 0.0),
        Polar(10.0, own.bearing_rad + pi, 0.0, 0.0),
        Polar(16.5, own.bearing_rad + direction * 0.2, 0.0, 0.0),
    )
    assert headway_rate_rad_s(own, [behind, across, outside], direction, 3.0) == inf
    ahead = Polar(11.0, own.bearing_rad + direction * 0.5, 0.0, direction * 0.04)
    # At its headway it flies as fast as the one ahead; nearer slower, farther away faster.
    assert headway_rate_rad_s(own, [ahead], direction, 5.0) == pytest.approx(0.04)
    assert headway_rate_rad_s(own, [ahead], direction, 3.0) > 0.04
    assert 0.0 <= headway_rate_rad_s(own, [ahead], direction, 5.5) < 0.04
    assert headway_rate_rad_s(own, [ahead], direction, 9.0) == 0.0


@given(st.floats(-pi, pi), st.floats(-pi, pi), st.floats(0.1, 100.0), directions)
def test_who_leads_is_up_to_a_quarter_turn_ahead(
    bearing_rad: float, ahead_rad: float, radius_m: float, direction: float
) -> None:
    assume(all(abs(ahead_rad - edge_rad) > 1e-6 for edge_rad in (-pi, 0.0, pi / 2.0, pi)))
    at_rad = bearing_rad + direction * ahead_rad
    place_m = radius_m * cos(at_rad), radius_m * sin(at_rad)
    does = 0.0 < ahead_rad < pi / 2.0
    assert leads((cos(bearing_rad), sin(bearing_rad)), place_m, direction) is does
