"""Joining a ring on which others are: when it has room for one more, the way to the place, and when to enter."""

from collections.abc import Callable
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.ring.commanded_ring import Orbit
from agents.ring.detour import MARGIN_M, Obstacle, bent_ring_m
from agents.ring.joining import WAITING, Joining
from agents.ring.place import RingPlace
from agents.ring.transition import SLOWEST_SHARE, TRACKED_SHARE, Mover, transition_of, transition_rate_rad_s
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings, SafetySettings
from estimation.polar import Polar
from tests.conftest import CONFIG

Maker = Callable[..., AgentConfig]

SEPARATION_M = 3.0
NARROW, WIDE, ALONE = RingPlace(4, 0.2, 1.5), RingPlace(4, 0.8, 0.9), RingPlace(1, None, None)

rings = st.builds(
    EncirclementSettings,
    radius_m=st.floats(4.0, 40.0),
    angular_rate_rad_s=st.sampled_from([0.0]) | st.floats(-0.3, 0.3),
    speed_max_m_s=st.floats(1.0, 6.0),
    acceleration_max_m_s2=st.floats(0.2, 4.0),
)


def at(radius_m: float, bearing_rad: float = 0.0) -> Polar:
    return Polar(radius_m, bearing_rad, 0.0, 0.0)


def joining_at(ring: EncirclementSettings, separation_m: float) -> Joining:
    return Joining(replace(CONFIG, encirclement=ring, safety=SafetySettings(separation_m=separation_m)))


def test_it_joins_from_wherever_it_is_while_the_ring_has_room_for_one_more(make_config: Maker) -> None:
    config = make_config(safety={"separation_m": SEPARATION_M}, encirclement={"radius_m": 5.0})
    joining = Joining(config)
    waiting = at(joining.waiting_m)
    assert joining.waiting_m == 5.0 + WAITING * SEPARATION_M
    assert not joining.look(waiting, 11.0)  # eleven would be 2.8 m apart
    assert not joining.joined
    assert joining.look(waiting, 10.0)
    assert joining.look(waiting, 11.0), "once it has published its bearing, the others count on it"
    joining.reset()
    assert not joining.look(at(30.0), 11.0)
    assert joining.look(at(30.0), 1.0)


def test_on_a_full_ring_a_vehicle_that_is_there_already_joins(make_config: Maker) -> None:
    config = make_config(safety={"separation_m": SEPARATION_M}, encirclement={"radius_m": 5.0})
    assert Joining(config).look(at(5.0 + SEPARATION_M), 21.0)
    assert not Joining(config).look(at(5.1 + SEPARATION_M), 21.0)


def test_it_enters_in_front_of_its_place_once_there_is_room_and_stays(make_config: Maker) -> None:
    joining = Joining(make_config(safety={"separation_m": SEPARATION_M}))
    for place, error_rad in ((NARROW, 0.0), (NARROW, 2.0), (WIDE, 2.0), (WIDE, -2.0), (ALONE, 2.0)):
        assert joining.radius_m(at(20.0), place, error_rad) == joining.waiting_m
    assert joining.radius_m(at(joining.waiting_m), WIDE, 0.0) == 10.0
    assert joining.radius_m(at(joining.waiting_m), NARROW, 0.0) == joining.waiting_m, "the neighbours have to make room"
    assert joining.radius_m(at(12.0), WIDE, 2.0) == joining.waiting_m, "it is not in front of its place"
    assert joining.radius_m(at(12.0), NARROW, 0.0) == joining.waiting_m
    assert joining.radius_m(at(12.0), WIDE, 0.4) < joining.waiting_m
    assert joining.radius_m(at(12.0), NARROW, 2.0) == 10.0, "it has entered, and goes on"
    joining.reset()
    assert joining.radius_m(at(12.0), NARROW, 2.0) == joining.waiting_m


@given(st.floats(0.0, pi), st.floats(0.0, pi), st.sampled_from([-1.0, 1.0]), st.sampled_from([WIDE, ALONE]))
def test_the_nearer_to_its_place_the_nearer_to_the_ring_it_flies(
    near_rad: float, far_rad: float, side: float, place: RingPlace
) -> None:
    joining = joining_at(CONFIG.encirclement, SEPARATION_M)
    near_m, far_m = (joining.radius_m(at(20.0), place, side * each) for each in sorted((near_rad, far_rad)))
    assert 10.0 <= near_m <= far_m <= joining.waiting_m


@given(st.floats(0.0, 10.0 + SEPARATION_M / 4.0), st.floats(-pi, pi))
def test_at_the_ring_or_inside_it_a_vehicle_flies_on_the_ring_even_without_room(
    radius_m: float, error_rad: float
) -> None:
    joining = joining_at(CONFIG.encirclement, SEPARATION_M)
    assert joining.radius_m(at(radius_m), NARROW, error_rad) == 10.0


def test_on_a_ring_that_is_nearly_full_less_room_suffices(make_config: Maker) -> None:
    joining = Joining(make_config(safety={"separation_m": SEPARATION_M}))
    crowded = RingPlace(16, 0.3, 0.3)  # of the even 0.39
    assert joining.radius_m(at(joining.waiting_m), crowded, 0.0) == 10.0
    joining.reset()
    assert joining.radius_m(at(joining.waiting_m), RingPlace(16, 0.24, 0.3), 0.0) == joining.waiting_m


def test_where_a_gap_is_to_be_narrower_than_the_other_less_room_suffices_there(make_config: Maker) -> None:
    joining = Joining(make_config(safety={"separation_m": SEPARATION_M}))
    narrow_ahead = RingPlace(3, 0.31, 1.5, 0.4, 3.0)
    assert joining.radius_m(at(joining.waiting_m), narrow_ahead, 0.0) == 10.0
    joining.reset()
    assert joining.radius_m(at(joining.waiting_m), RingPlace(3, 1.5, 0.31, 0.4, 3.0), 0.0) == joining.waiting_m


def test_a_ring_that_is_wider_for_a_while_is_waited_for_farther_out(make_config: Maker) -> None:
    joining = Joining(make_config(safety={"separation_m": SEPARATION_M}))
    joining.ring_m = 16.0
    assert joining.waiting_m == 16.0 + WAITING * SEPARATION_M
    assert joining.look(at(30.0), 1.0)
    assert joining.radius_m(at(30.0), NARROW, 0.0) == joining.waiting_m
    assert joining.radius_m(at(30.0), WIDE, 0.0) == 16.0


@given(unsure_m=st.floats(0.0, 3.0), ring_m=st.floats(8.0, 40.0), moved_m=st.floats(0.0, 3.0))
def test_who_is_not_heard_stays_clear_of_the_bend_around_where_it_was(
    unsure_m: float, ring_m: float, moved_m: float
) -> None:
    config = replace(CONFIG, safety=CONFIG.safety.model_copy(update={"separation_m": 3.0}))
    joining = Joining(config)
    joining.ring_m = ring_m
    lost = Obstacle(0.0, ring_m, 3.0 + unsure_m + moved_m)
    outermost_m = bent_ring_m(ring_m, np.linspace(-pi, pi, 361), [lost], ring_m).max()
    assert outermost_m >= ring_m + lost.clear_m - MARGIN_M
    assert joining.isolated_m(unsure_m) >= outermost_m + 3.0 + unsure_m


@given(rings, st.floats(1.0, 5.0), st.floats(0.3, 2.0), st.floats(-pi, pi), st.floats(-1.0, 1.0))
def test_on_the_ring_a_vehicle_changes_places_within_the_bounds_of_a_transition(
    ring: EncirclementSettings, separation_m: float, slowed: float, error_rad: float, outside: float
) -> None:
    """Up to a separation outside of it as well, where vehicles pass from one set of bounds to the other."""
    joining, orbit = joining_at(ring, separation_m), Orbit(ring.radius_m, min(1.0, slowed) * ring.angular_rate_rad_s)
    radius_m, gentle = ring.radius_m + outside * separation_m, transition_of(ring)
    mover, size_m = joining.mover(error_rad, radius_m, orbit), max(radius_m, ring.radius_m)
    ring_m_s = abs(orbit.angular_rate_rad_s) * size_m
    assert joining.coming(radius_m) == pytest.approx(0.0, abs=1e-9)
    assert mover.error_rad == error_rad
    assert mover.ahead_max_rad_s * size_m == pytest.approx(TRACKED_SHARE * gentle.speed_m_s)
    assert mover.back_max_rad_s * size_m <= TRACKED_SHARE * gentle.speed_m_s + 1e-9
    if ring_m_s > 0.0:  # it never flies backwards
        assert ring_m_s - mover.back_max_rad_s * size_m >= SLOWEST_SHARE * ring_m_s - 1e-9
    assert mover.acceleration_max_rad_s2 * size_m == pytest.approx(gentle.acceleration_m_s2)


@given(
    ring=st.builds(
        EncirclementSettings,
        radius_m=st.floats(8.0, 20.0),
        angular_rate_rad_s=st.floats(-0.05, 0.05),
        speed_max_m_s=st.floats(3.0, 6.0),
        acceleration_max_m_s2=st.floats(1.0, 4.0),
    ),
    separation_m=st.floats(1.0, 5.0),
    beyond_m=st.floats(0.0, 60.0),
)
def test_on_its_way_in_a_vehicle_flies_at_its_own_limits_in_both_directions(
    ring: EncirclementSettings, separation_m: float, beyond_m: float
) -> None:
    joining, orbit = joining_at(ring, separation_m), Orbit(ring.radius_m, ring.angular_rate_rad_s)
    radius_m, gentle = joining.waiting_m + beyond_m, transition_of(ring)
    mover, ring_m_s = joining.mover(0.3, radius_m, orbit), abs(ring.angular_rate_rad_s) * radius_m
    forwards_m_s = ring_m_s + mover.ahead_max_rad_s * radius_m
    backwards_m_s = mover.back_max_rad_s * radius_m - ring_m_s
    acceleration_m_s2 = mover.acceleration_max_rad_s2 * radius_m
    assert joining.coming(radius_m) == pytest.approx(1.0)
    assert gentle.acceleration_m_s2 < acceleration_m_s2 <= ring.acceleration_max_m_s2
    if forwards_m_s > ring_m_s + gentle.speed_m_s:  # where its limits allow more than a transition at the ring's rate
        assert forwards_m_s <= ring.speed_max_m_s
        assert forwards_m_s**2 / radius_m + acceleration_m_s2 <= 2.0**0.5 * ring.acceleration_max_m_s2
        assert backwards_m_s == pytest.approx(forwards_m_s)


@given(rings, st.floats(1.0, 5.0), st.floats(1.0, 3.0))
def test_the_bounds_change_without_a_step_on_the_way_in(
    ring: EncirclementSettings, separation_m: float, wider: float
) -> None:
    joining, orbit = joining_at(ring, separation_m), Orbit(wider * ring.radius_m, ring.angular_rate_rad_s)
    joining.ring_m = orbit.radius_m
    radii_m = np.linspace(orbit.radius_m / 2.0, joining.waiting_m + separation_m, 2001)
    bounds = np.array([in_metres(joining.mover(0.0, each, orbit), max(each, orbit.radius_m)) for each in radii_m])
    # A bound changes within half a separation, linearly but for the ring's own speed, which grows with the radius.
    step_m = radii_m[1] - radii_m[0]
    slopes = np.abs(np.diff(bounds, axis=0)) / step_m
    ranges = np.ptp(bounds, axis=0) / (0.5 * separation_m)
    assert (slopes <= 3.0 * ranges + abs(ring.angular_rate_rad_s) + 1e-6).all()


def in_metres(mover: Mover, radius_m: float) -> list[float]:
    bounds = mover.ahead_max_rad_s, mover.back_max_rad_s, mover.acceleration_max_rad_s2
    return [bound * radius_m for bound in bounds]


@given(st.lists(st.tuples(st.floats(-2.0, 2.0), st.sampled_from([10.0, 12.9, 14.0, 30.0])), min_size=1, max_size=12))
def test_of_vehicles_on_the_ring_the_two_farthest_from_their_places_decide(errors: list[tuple[float, float]]) -> None:
    """The law gives the same rate as with every vehicle's bounds."""
    joining, orbit = Joining(CONFIG), Orbit(10.0, 0.05)
    radii_m = [10.0 if joining.coming(radius_m) == 0.0 else radius_m for _, radius_m in errors]
    errors_rad = [error_rad for error_rad, _ in errors]
    every = [joining.mover(*each, orbit) for each in zip(errors_rad, radii_m, strict=True)]
    rates_rad_s = [transition_rate_rad_s(of, 0.05, 0.3) for of in (every, joining.movers(errors_rad, radii_m, orbit))]
    assert rates_rad_s[0] == pytest.approx(rates_rad_s[1], abs=1e-12)
