"""Joining a ring on which others are: which gap, when to say so, and when to come in."""

from collections.abc import Callable
from dataclasses import replace
from math import pi, tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.ring.detour import Obstacle, bent_ring_m
from agents.ring.joining import ASIDE, Joining, chosen_gap
from agents.ring.place import RingPlace
from agents.settings.config import AgentConfig
from estimation.polar import Polar
from tests.conftest import CONFIG

Maker = Callable[..., AgentConfig]
bearings = st.lists(st.floats(-pi, pi), min_size=1, max_size=8)


def at(radius_m: float, bearing_rad: float = 0.0) -> Polar:
    return Polar(radius_m, bearing_rad, 0.0, 0.0)


@given(own=st.floats(-pi, pi), others=bearings)
def test_the_gap_is_as_wide_as_a_search_over_all_bearings_finds(own: float, others: list[float]) -> None:
    gap = chosen_gap(own, others)
    turns = np.linspace(0.0, tau, 3600)
    # How far the nearest vehicle is from each bearing: in the middle of the widest gap it is farthest.
    free = np.abs((turns[:, None] - np.array(others) + pi) % tau - pi).min(axis=1)
    assert gap.width_rad / 2.0 >= 0.8 * free.max() - 0.01
    middle = own + gap.ahead_rad
    clear = np.abs((middle - np.array(others) + pi) % tau - pi).min()
    assert clear == pytest.approx(gap.width_rad / 2.0, abs=1e-6)
    assert -pi - 1e-9 <= gap.ahead_rad <= pi + 1e-9


@pytest.mark.parametrize(
    ("own", "middle", "width"),
    [
        (0.5, 1.0, 2.0),  # its own is the widest
        (3.0, 2.9, 1.8),  # nearly as wide
        (5.0, 1.0, 2.0),  # in front of a narrow one
    ],
)
def test_in_front_of_a_gap_that_is_nearly_the_widest_it_stays(own: float, middle: float, width: float) -> None:
    gap = chosen_gap(own, [0.0, 2.0, 3.8, 5.1])
    assert (own + gap.ahead_rad - middle) % tau == pytest.approx(0.0, abs=1e-9) or (own + gap.ahead_rad) == (
        pytest.approx(middle)
    )
    assert gap.width_rad == pytest.approx(width)


@pytest.mark.parametrize(
    ("radius", "others", "joins"),
    [
        (30.0, [], True),  # the first
        (30.0, [1.5, -1.5], True),  # in front of a wide gap
        (30.0, [0.1, 2.0, -2.0], False),  # behind somebody's back
        (30.0, [0.4, -0.4], False),  # its own gap is a narrow one
        (10.5, [0.1, 2.0, -2.0], True),  # there already
    ],
)
def test_it_joins_in_front_of_its_gap(radius: float, others: list[float], joins: bool, make_config: Maker) -> None:
    joining = Joining(make_config(safety={"separation_m": 3.0}))
    gap = joining.look(at(radius), others)
    assert (gap is None, joining.joined) == (joins, joins)
    if joins:
        assert joining.look(at(30.0), [0.01]) is None  # once it has said so, it stands by it
        joining.reset()
        assert not joining.joined


def test_a_ring_that_is_full_is_waited_for_outside(make_config: Maker) -> None:
    config = make_config(safety={"separation_m": 3.0}, encirclement={"radius_m": 5.0})
    joining = Joining(config)
    full = [tau * k / 10 for k in range(10)]  # eleven would be 2.8 m apart
    for bearing in np.linspace(0.0, tau, 60):
        assert joining.look(at(joining.waiting_m, float(bearing)), full) is not None
    assert joining.waiting_m == 5.0 + ASIDE * 3.0
    assert any(joining.look(at(joining.waiting_m, float(b)), full[:-1]) is None for b in np.linspace(0.0, tau, 60))


def test_it_comes_in_once_there_is_room_and_stays(make_config: Maker) -> None:
    joining = Joining(make_config(safety={"separation_m": 3.0}))
    assert joining.radius_m(at(20.0), RingPlace(4, 0.2, 1.5)) == joining.waiting_m
    assert joining.radius_m(at(20.0), RingPlace(4, 0.8, 0.9)) == 10.0
    assert joining.radius_m(at(12.0), RingPlace(4, 0.8, 0.9)) == 10.0
    assert joining.radius_m(at(13.5), RingPlace(4, 0.2, 0.9)) == 10.0
    assert joining.radius_m(at(20.0), RingPlace(1, None, None)) == 10.0


def test_a_ring_that_is_wider_for_a_while_is_waited_for_farther_out(make_config: Maker) -> None:
    joining = Joining(make_config(safety={"separation_m": 3.0}))
    joining.ring_m = 16.0
    assert joining.waiting_m == 16.0 + ASIDE * 3.0
    assert joining.look(at(18.9), [0.1, 2.0, -2.0]) is None  # on the ring of the moment already
    assert joining.radius_m(at(30.0), RingPlace(4, 0.2, 1.5)) == joining.waiting_m
    assert joining.radius_m(at(30.0), RingPlace(4, 0.8, 0.9)) == 16.0


@given(unsure_m=st.floats(0.0, 3.0), ring_m=st.floats(8.0, 40.0), moved_m=st.floats(0.0, 3.0))
def test_who_is_not_heard_stays_clear_of_the_bend_around_where_it_was(
    unsure_m: float, ring_m: float, moved_m: float
) -> None:
    config = replace(CONFIG, safety=CONFIG.safety.model_copy(update={"separation_m": 3.0}))
    joining = Joining(config)
    joining.ring_m = ring_m
    lost = Obstacle(0.0, ring_m, 3.0 + unsure_m + moved_m)
    outermost_m = bent_ring_m(ring_m, np.linspace(-pi, pi, 361), [lost]).max()
    assert outermost_m >= ring_m + lost.distance_m
    assert joining.isolated_m(unsure_m) >= outermost_m + 3.0 + unsure_m


@given(own=st.floats(-pi, pi), others=bearings, room=st.floats(0.01, 1.0))
def test_the_way_leads_to_the_nearest_place_with_room(own: float, others: list[float], room: float) -> None:
    gap = chosen_gap(own, others)
    way = gap.way_rad(room)

    def edge(bearing: float) -> float:
        return float(np.abs((bearing - np.array(others) + pi) % tau - pi).min())

    assert edge(own + way) >= min(room, gap.width_rad / 2.0) - 1e-6
    if abs(way) > 1e-6:  # nothing nearer would do
        assert edge(own + way * 0.99) < min(room, gap.width_rad / 2.0) or gap.edge_rad < 0.0
    assert abs(way) <= abs(gap.ahead_rad) + 1e-9
