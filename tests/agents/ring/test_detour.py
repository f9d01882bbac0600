"""The ring that bends: clear of what stands in its way at every bearing, and without a step."""

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.ring.detour import MARGIN_M, Obstacle, bent_ring_m

RING_M = 10.0
BEARINGS = np.linspace(-pi, pi, 2000)


@given(radius=st.floats(1.0, 25.0), bearing=st.floats(-pi, pi), distance=st.floats(1.0, 6.5))
def test_at_every_bearing_the_bent_ring_is_clear_of_the_obstacle(
    radius: float, bearing: float, distance: float
) -> None:
    bent = bent_ring_m(RING_M, BEARINGS, [Obstacle(bearing, radius, distance)])
    apart = np.abs(bent * np.exp(1j * BEARINGS) - radius * np.exp(1j * bearing))
    assert apart.min() >= distance - 1e-9
    # No step: its slope is what a vehicle can follow on the ring.
    assert np.abs(np.diff(bent)).max() < 40.0 * np.diff(BEARINGS)[0]


@pytest.mark.parametrize(
    ("radius", "way"), [(10.0, 1.0), (7.0, 1.0), (15.0, -1.0), (13.0, 1.0), (1.0, 0.0), (30.0, 0.0)]
)
def test_it_bends_outwards_unless_a_little_inwards_will_do(radius: float, way: float) -> None:
    bend = bent_ring_m(RING_M, np.array([0.3]), [Obstacle(0.3, radius, 6.0)])[0] - RING_M
    assert np.sign(bend) == way
    if way:
        assert abs(RING_M + bend - radius) == pytest.approx(6.0 + MARGIN_M)


@pytest.mark.parametrize(("own_m", "way"), [(10.0, -1.0), (14.9, -1.0), (15.1, 1.0), (19.0, 1.0)])
def test_who_is_on_its_way_around_outside_stays_outside(own_m: float, way: float) -> None:
    bend = bent_ring_m(RING_M, np.array([0.3]), [Obstacle(0.3, 15.0, 6.0)], own_m)[0] - RING_M
    assert np.sign(bend) == way
    assert abs(RING_M + bend - 15.0) == pytest.approx(6.0 + MARGIN_M)


def test_far_from_the_obstacle_it_is_the_ring() -> None:
    bent = bent_ring_m(RING_M, BEARINGS, [Obstacle(0.0, 10.0, 4.0)])
    assert (bent[np.abs(BEARINGS) > 1.0] == RING_M).all()
    assert bent_ring_m(RING_M, BEARINGS, []) == pytest.approx(np.full(2000, RING_M))
