"""The ring that bends: clear of what stands in its way at every bearing, and without a step."""

from math import pi

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from agents.ring.detour import MARGIN_M, Obstacle, bends, bent_ring_m, met
from estimation.polar import Polar

RING_M = 10.0
BEARINGS = np.linspace(-pi, pi, 2000)


@given(
    radius=st.floats(0.0, 25.0), bearing=st.floats(-pi, pi), distance=st.floats(1.0, 6.5), early=st.floats(0.0, 15.0)
)
def test_at_every_bearing_the_bent_ring_is_clear_of_the_obstacle(
    radius: float, bearing: float, distance: float, early: float
) -> None:
    bent = bent_ring_m(RING_M, BEARINGS, [Obstacle(bearing, radius, distance, early)], RING_M)
    apart = np.abs(bent * np.exp(1j * BEARINGS) - radius * np.exp(1j * bearing))
    assert apart.min() >= distance - 1e-9
    # No step: its slope is what a vehicle can follow on the ring.
    assert np.abs(np.diff(bent)).max() < 40.0 * np.diff(BEARINGS)[0]


@given(
    first=st.tuples(st.just(0.0), st.floats(1.0, 25.0)),
    second=st.tuples(st.floats(-1.2, 1.2), st.floats(1.0, 25.0)),
    distance=st.floats(1.0, 4.0),
    early=st.floats(0.0, 15.0),
)
@example(first=(0.0, 12.0), second=(0.0, 6.4), distance=3.0, early=0.0)
@example(first=(0.0, 12.14), second=(-0.81, 11.54), distance=3.41, early=0.0)
@example(first=(0.0, 10.0), second=(0.1, 15.0), distance=3.0, early=0.0)
@example(first=(0.0, 11.0), second=(-0.3, 14.0), distance=2.5, early=0.0)
def test_it_is_clear_of_two_obstacles(
    first: tuple[float, float], second: tuple[float, float], distance: float, early: float
) -> None:
    obstacles = [Obstacle(*first, distance, early), Obstacle(*second, distance, early)]
    bent = bent_ring_m(RING_M, BEARINGS, obstacles, RING_M)
    for bearing, radius in (first, second):
        apart = np.abs(bent * np.exp(1j * BEARINGS) - radius * np.exp(1j * bearing))
        assert apart.min() >= distance - 1e-9


@pytest.mark.parametrize(
    ("radius", "way"), [(10.0, 1.0), (7.0, 1.0), (15.0, -1.0), (13.0, 1.0), (1.0, 0.0), (30.0, 0.0)]
)
def test_it_bends_outwards_unless_a_little_inwards_will_do(radius: float, way: float) -> None:
    bend = bent_ring_m(RING_M, np.array([0.3]), [Obstacle(0.3, radius, 6.0)], RING_M)[0] - RING_M
    assert np.sign(bend) == way
    if way:
        assert abs(RING_M + bend - radius) == pytest.approx(6.0 + MARGIN_M)


@pytest.mark.parametrize(
    ("radius", "own_m", "way"),
    [(15.0, 10.0, -1.0), (15.0, 11.0, 1.0), (15.0, 15.1, 1.0), (15.0, 19.0, 1.0), (14.0, 9.5, -1.0), (13.0, 9.0, 1.0)],
)
def test_a_vehicle_stays_on_the_side_on_which_it_has_begun(radius: float, own_m: float, way: float) -> None:
    bend = bent_ring_m(RING_M, np.array([0.3]), [Obstacle(0.3, radius, 6.0)], own_m)[0] - RING_M
    assert np.sign(bend) == way
    assert abs(RING_M + bend - radius) == pytest.approx(6.0 + MARGIN_M)


@pytest.mark.parametrize(("own_m", "way"), [(10.0, 1.0), (9.7, -1.0)])
def test_inwards_it_goes_on_where_it_would_not_begin(own_m: float, way: float) -> None:
    assert np.sign(bent_ring_m(RING_M, np.array([0.3]), [Obstacle(0.3, 10.9, 2.0)], own_m)[0] - RING_M) == way


def test_only_an_obstacle_on_the_ring_bends_it() -> None:
    assert bends(RING_M, [Obstacle(0.3, 10.0, 3.0)], RING_M)
    assert not bends(RING_M, [Obstacle(0.3, 100.0, 3.0), Obstacle(0.3, 1.0, 3.0)], RING_M)


def test_a_vehicle_that_holds_over_the_target_of_a_small_ring_is_passed() -> None:
    assert bent_ring_m(5.0, BEARINGS, [Obstacle(0.0, 0.0, 6.0, 10.0)], 5.0).max() == pytest.approx(6.0 + MARGIN_M)


def test_far_from_the_obstacle_it_is_the_ring() -> None:
    bent, early = (bent_ring_m(RING_M, BEARINGS, [Obstacle(0.0, 10.0, 4.0, from_m)], RING_M) for from_m in (0.0, 15.0))
    assert (bent[np.abs(BEARINGS) > 1.0] == RING_M).all()
    assert ((early > RING_M + 1e-6) == (np.abs(BEARINGS) < 1.5)).mean() == pytest.approx(1.0, abs=0.01)
    assert early.max() == pytest.approx(bent.max(), abs=0.001)
    assert bent_ring_m(RING_M, BEARINGS, [], RING_M) == pytest.approx(np.full(2000, RING_M))


@given(
    rate=st.floats(0.06, 0.2),
    clockwise=st.booleans(),
    ahead=st.floats(0.05, 2.5),
    radius=st.floats(8.0, 30.0),
    drift=st.floats(0.0, 0.5),
    course=st.floats(-pi, pi),
)
def test_an_obstacle_is_taken_where_the_vehicle_meets_it(
    rate: float, clockwise: bool, ahead: float, radius: float, drift: float, course: float
) -> None:
    rate = -rate if clockwise else rate
    place, velocity = radius * np.exp(1j * np.sign(rate) * ahead), drift * np.exp(1j * course)
    obstacle = met(Polar(15.0, 0.0, 0.0, rate), rate, (place.real, place.imag, velocity.real, velocity.imag), 3.0)
    # Step by step: when the vehicle, along the ring, is at the bearing of the obstacle, which drifts.
    times_s = np.arange(0.0, pi / abs(rate), 0.01)
    seen_rad = np.angle((place + velocity * times_s) * np.exp(-1j * rate * times_s)) * np.sign(rate)
    passed = np.flatnonzero(seen_rad <= 0.0)
    # One that moves through the target, or as fast around it as the vehicle, is met at no certain place.
    steps_rad = -np.diff(seen_rad[: passed[0] + 1]) if passed.size else np.empty(0)
    assume(steps_rad.size and 0.3 * abs(rate) * 0.01 < steps_rad.min() and steps_rad.max() < 3.0 * abs(rate) * 0.01)
    there = place + velocity * times_s[passed[0]]
    assert obstacle.radius_m == pytest.approx(abs(there), abs=0.1)
    assert np.angle(np.exp(1j * obstacle.bearing_rad) / there) == pytest.approx(0.0, abs=0.05)


def test_an_obstacle_that_was_passed_is_where_it_is() -> None:
    behind = met(Polar(10.0, 1.0, 0.0, 0.1), 0.1, (10.0, 0.0, 0.5, 0.0), 3.0)
    assert (behind.bearing_rad, behind.radius_m) == (0.0, 10.0)
