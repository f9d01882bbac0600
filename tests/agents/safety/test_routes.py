"""Ways around zones: against lengths on paper, and their distances to the zones by shapely."""

from itertools import pairwise
from math import acos, asin, dist, hypot, pi, sqrt

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon, union_all

from agents.safety.routes import Routes, Way, passing_room_m
from agents.settings.sections import NoFlySection, SafetySettings

Pair = tuple[float, float]
ROOM_M = 2.0
DISC = NoFlySection(name="disc", center_m=(20.0, 0.0), radius_m=4.0)
SQUARE = NoFlySection(name="square", polygon_m=((18.0, -3.0), (22.0, -3.0), (22.0, 3.0), (18.0, 3.0)))
FENCE = ((-5.0, -20.0), (45.0, -20.0), (45.0, 4.0), (-5.0, 4.0))


def length_m(here: Pair, way: tuple[Pair, ...]) -> float:
    return sum(dist(*each) for each in pairwise((here, *way)))


def test_the_way_around_a_disc_is_that_of_a_string() -> None:
    """Two tangents and an arc of the radius with room: the polygon about it is at most a little longer."""
    way = Routes([DISC], (), ROOM_M).way_m((0.0, 0.0), [(40.0, 0.0)])
    radius_m, away_m = 4.0 + ROOM_M, 20.0
    string_m = 2.0 * sqrt(away_m**2 - radius_m**2) + radius_m * (pi - 2.0 * acos(radius_m / away_m))
    assert way[-1] == (40.0, 0.0)
    assert string_m <= length_m((0.0, 0.0), way) <= 1.003 * string_m


def test_the_way_around_a_square_turns_about_its_corners() -> None:
    way = Routes([SQUARE], (), ROOM_M).way_m((0.0, 0.0), [(40.0, 0.0)])
    # To a circle of the room about the corner at (18, 3), along the side, and the same again.
    aside_rad = asin(3.0 / hypot(18.0, 3.0)) + asin(ROOM_M / hypot(18.0, 3.0))
    string_m = 2.0 * sqrt(18.0**2 + 3.0**2 - ROOM_M**2) + 2.0 * ROOM_M * aside_rad + 4.0
    assert string_m <= length_m((0.0, 0.0), way) <= 1.003 * string_m


def test_the_fence_closes_one_of_two_ways() -> None:
    way = Routes([DISC], FENCE, ROOM_M).way_m((0.0, 0.0), [(40.0, 0.0)])
    assert min(y for _, y in way) < -5.0
    closed = Routes([DISC], (*FENCE[:0], (-5.0, -4.0), (45.0, -4.0), *FENCE[2:]), ROOM_M)
    assert closed.way_m((0.0, 0.0), [(40.0, 0.0)]) == ()


def test_of_several_goals_the_nearest_by_its_way_is_chosen() -> None:
    way = Routes([DISC], (), ROOM_M).way_m((0.0, 0.0), [(27.0, 0.0), (0.0, 27.5)])
    assert way == ((0.0, 27.5),)


@given(
    zones=st.lists(
        st.builds(
            lambda x, y, radius: NoFlySection(name="disc", center_m=(x, y), radius_m=radius),
            st.floats(5.0, 35.0),
            st.floats(-10.0, 10.0),
            st.floats(0.5, 4.0),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_every_part_of_a_way_has_the_room(zones: list[NoFlySection]) -> None:
    here, there = (0.0, 0.0), (40.0, 0.0)
    shapes = [Point(each.center_m).buffer(each.radius_m or 0.0, quad_segs=64) for each in zones]
    assume(all(each.distance(Point(place)) > ROOM_M + 0.1 for each in shapes for place in (here, there)))
    way = Routes(zones, (), ROOM_M).way_m(here, [there])
    flown = LineString([here, *way])
    assert flown.distance(union_all(shapes)) >= ROOM_M - 0.01
    assert length_m(here, way) >= dist(here, there)


def test_from_inside_the_room_the_way_leads_out_of_it_first() -> None:
    way = Routes([SQUARE], (), ROOM_M).way_m((17.0, 0.0), [(0.0, 0.0)])
    assert way[0] == pytest.approx((16.0, 0.0), abs=0.05)
    assert way[-1] == (0.0, 0.0)


def test_where_the_room_is_missing_the_way_has_the_least_one() -> None:
    """Between two squares 3 m apart there is room of 1 m, not of 2 m; around them it is fenced."""
    above = SQUARE.model_copy(update={"polygon_m": ((18.0, -1.5), (22.0, -1.5), (22.0, 9.9), (18.0, 9.9))})
    below = SQUARE.model_copy(update={"polygon_m": ((18.0, -9.9), (22.0, -9.9), (22.0, -4.5), (18.0, -4.5))})
    fence = ((-5.0, -10.0), (45.0, -10.0), (45.0, 10.0), (-5.0, 10.0))
    routes = Routes([above, below], fence, ROOM_M)
    assert routes.way_m((0.0, 0.0), [(40.0, 0.0)]) == ()
    way, here, flown = Way(routes), (0.0, 0.0), [(0.0, 0.0)]
    for _ in range(400):
        next_m = way.next_m(here, (40.0, 0.0))
        away_m = dist(here, next_m)
        if away_m > 0.0:
            share = min(1.0, 0.2 / away_m)
            here = here[0] + share * (next_m[0] - here[0]), here[1] + share * (next_m[1] - here[1])
        flown.append(here)
    assert here == (40.0, 0.0)
    closed = union_all([Polygon(above.polygon_m), Polygon(below.polygon_m)])
    # Places are cut by what counts as reached.
    assert LineString(flown).distance(closed) > 0.3


def test_a_gap_is_flown_instead_of_a_way_around_twice_as_long() -> None:
    """Two walls 3 m apart, of 100 m and of 12 m: around their ends it is 208 m and 49 m, through the gap 40 m."""
    here, there = (0.0, 0.0), (40.0, 0.0)
    for end_m, passes in ((100.0, True), (12.0, False)):
        upper = SQUARE.model_copy(update={"polygon_m": ((19.0, 1.5), (21.0, 1.5), (21.0, end_m), (19.0, end_m))})
        lower = SQUARE.model_copy(update={"polygon_m": ((19.0, -end_m), (21.0, -end_m), (21.0, -1.5), (19.0, -1.5))})
        way = Way(Routes([upper, lower], (), ROOM_M))
        way.next_m(here, there)
        assert (way.length_m < 41.0) == passes
        assert passes or way.length_m == pytest.approx(2.0 * hypot(20.0, 14.0), rel=0.05)


def test_the_room_grows_with_the_speed() -> None:
    assert passing_room_m(0.0, SafetySettings()) == 1.0
    assert passing_room_m(2.0, SafetySettings()) == pytest.approx(1.0 + 0.65 * 2.0 / 1.3)
