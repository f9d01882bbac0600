"""Where a vehicle can land: places by a fine grid and shapely, and which vehicles are in the way."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point, Polygon
from shapely.geometry import box

from agents.safety.landing import ASIDE, LandingPlaces, OtherVehicles
from agents.settings.sections import NoFlySection
from agents.team.messages import Goal, MemberState
from tests.agents.safety.test_neighbours import HEIGHT_M, Maker, member, situation

SEPARATION_M, REACH_M = 2.0, 40.0
FENCE_M = ((-12.0, -12.0), (12.0, -12.0), (12.0, 3.0), (-12.0, 3.0))
ZONES = (
    NoFlySection(name="house", polygon_m=((1.0, -9.0), (5.0, -9.0), (5.0, -2.0), (1.0, -2.0)), ceiling_m=4.0),
    NoFlySection(name="above", polygon_m=((-9.0, -9.0), (-1.0, -9.0), (-1.0, 2.0), (-9.0, 2.0)), floor_m=15.0),
)
STARTS_M = ((0.0, 4.0), (0.0, 0.0), (0.0, -4.0))
near = st.floats(-6.0, 6.0)


def places(make: Maker, **safety: Any) -> LandingPlaces:
    settings = {"separation_m": SEPARATION_M, **safety}
    return LandingPlaces(make(safety=settings, home_m=STARTS_M[1], starts_m=STARTS_M))


def seen(*members: MemberState) -> OtherVehicles:
    return OtherVehicles(members, (), {})


@given(others=st.lists(st.tuples(near, near), max_size=6), lying=st.tuples(near, near), goal=st.tuples(near, near))
def test_the_place_aside_is_the_nearest_that_is_free(
    others: list[tuple[float, float]], lying: tuple[float, float], goal: tuple[float, float], make_config: Maker
) -> None:
    """Truth: a polygon of shapely, less than one step of the search nearer."""
    states = [member(position=each, tactic="pilot override") for each in others]
    sent = MemberState(3, 10.0, "hold", (9.0, 9.0), (0.0, 0.0), (9.0, 9.0), (0.0, 0.0), HEIGHT_M, goal=Goal(*goal))
    known = OtherVehicles((*states, sent), (), {3: lying})
    found = places(make_config, fence_m=FENCE_M, no_fly=ZONES).nearest_m(
        (0.0, 0.0), situation(10.0), known, from_landing_places=True
    )
    keep_m, room_m = ASIDE * SEPARATION_M, 1.0
    free: Any = box(-12.0, -12.0, 12.0, 3.0).buffer(-room_m).difference(Polygon(ZONES[0].polygon_m).buffer(room_m))
    for each in (*others, (9.0, 9.0), goal, lying, STARTS_M[0], STARTS_M[2]):
        free = free.difference(Point(each).buffer(keep_m, quad_segs=64))
    assert found is not None
    assert free.distance(Point(found)) < 0.01
    roomy = free.buffer(-0.5)  # where each place of the search has a neighbour that is free, too
    assert np.hypot(*found) <= roomy.distance(Point(0.0, 0.0)) + 0.5


def test_there_is_no_place_aside_beyond_the_reach(make_config: Maker) -> None:
    around = [member(position=(x, y)) for x in np.arange(-44.0, 45.0, 4.0) for y in np.arange(-44.0, 45.0, 4.0)]
    assert places(make_config).nearest_m((0.0, 0.0), situation(10.0), seen(*around), from_landing_places=False) is None


def test_who_is_in_the_way_of_a_landing(make_config: Maker) -> None:
    """At (2, 0), with a separation of 2 m: those in the air within 2.5 m and the uncertainty, on the ground 1 m."""
    judged, place = places(make_config), (2.0, 0.0)
    rows: list[tuple[MemberState, bool]] = [
        (member(position=(4.4, 0.0), tactic="pilot override", altitude_m=3.0), True),
        (member(position=(4.6, 0.0), tactic="pilot override", altitude_m=3.0), False),
        (member(position=(4.6, 0.0), tactic="pilot override", altitude_m=3.0, sigma_m=0.5), True),
        (member(position=(2.0, 0.0), tactic="pilot override", altitude_m=HEIGHT_M + 1.9), True),
        (member(position=(2.0, 0.0), tactic="pilot override", altitude_m=HEIGHT_M + 2.1), False),
        (member(position=(2.0, 0.0), tactic="hold", altitude_m=3.0), False),
        (member(position=(2.0, 0.0), tactic="encircle", altitude_m=3.0), False),
        (member(position=(4.4, 0.0), tactic="land", altitude_m=3.0), True),
    ]
    for state, expected in rows:
        found = judged.obstacle(place, situation(10.0), seen(state))
        assert (found is not None) is expected, state
        if found is not None:
            assert "vehicle 1" in found.text
            assert found.comes_down is (state.tactic == "land")
    silent: list[tuple[MemberState, bool]] = [
        (member(position=(4.4, 0.0), tactic="encircle"), True),
        (member(position=(4.4, 0.0), tactic="land"), True),
        (member(position=(3.1, 0.0), tactic="land", altitude_m=0.2), False),
        (member(position=(2.9, 0.0), tactic="land", altitude_m=0.2), True),
    ]
    for state, expected in silent:
        found = judged.obstacle(place, situation(10.0), OtherVehicles((), (state,), {}))
        assert (found is not None) is expected, state
    for x, expected in ((3.1, False), (2.9, True)):
        assert (judged.obstacle(place, situation(10.0), OtherVehicles((), (), {4: (x, 0.0)})) is not None) is expected


@pytest.mark.parametrize("keep_out_m", [0.0, 5.0])
def test_the_place_aside_is_outside_of_the_targets_disc(keep_out_m: float, make_config: Maker) -> None:
    now = situation(10.0)
    with_target = type(now)(
        now.now_s, now.acting_s, now.own, now.acting_motion, now.disturbance, None, None, np.array((3.0, 0.0, 0.0, 0.0))
    )
    pilot = member(position=(-1.0, 0.0), tactic="pilot override")
    found = places(make_config, keep_out_m=keep_out_m).nearest_m(
        (0.0, 0.0), with_target, seen(pilot), from_landing_places=False
    )
    assert found is not None
    assert np.hypot(found[0] - 3.0, found[1]) >= keep_out_m
    assert bool(np.hypot(found[0] - 3.0, found[1]) < 5.0) is (keep_out_m == 0.0)
