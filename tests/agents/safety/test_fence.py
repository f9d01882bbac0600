"""The fence against matplotlib's paths and against its own edges, walked along in small steps."""

from math import cos, hypot, inf, pi, sin

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from matplotlib.path import Path
from shapely import Point, Polygon

from agents.safety.fence import Area, Corner, Fence, RoundEdge
from agents.settings.sections import NoFlySection, SafetySettings
from estimation.state import Vector

STEPS = 4000
Corners = list[Corner]

SQUARE: Corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
NOTCHED: Corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (5.0, 2.0), (0.0, 6.0)]


def around(shares: list[float], radii_m: list[float], centre_m: Corner, clockwise: bool) -> Corners:
    """A polygon around a centre that sees all of it: simple, and with unequal radii hardly ever convex."""
    turns = np.cumsum(shares) / sum(shares) * 2.0 * pi
    corners = [
        (centre_m[0] + radius * cos(turn), centre_m[1] + radius * sin(turn))
        for turn, radius in zip(turns.tolist(), radii_m, strict=True)
    ]
    return corners[::-1] if clockwise else corners


def polygons(radius_least_m: float = 3.0) -> st.SearchStrategy[Corners]:
    """Simple polygons in both senses: shares of at most 3/8 of the turn keep the centre inside."""

    def drawn(count: int) -> st.SearchStrategy[Corners]:
        return st.builds(
            around,
            st.lists(st.floats(1.0, 1.5), min_size=count, max_size=count),
            st.lists(st.floats(radius_least_m, 20.0), min_size=count, max_size=count),
            st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)),
            st.booleans(),
        )

    return st.integers(4, 9).flatmap(drawn)


offsets = st.tuples(st.floats(-25.0, 25.0), st.floats(-25.0, 25.0))


def edges(corners: Corners) -> Vector:
    """Points along each edge, (edges, STEPS + 1, 2)."""
    starts, ends = np.array(corners), np.roll(np.array(corners), -1, axis=0)
    shares = np.linspace(0.0, 1.0, STEPS + 1)[None, :, None]
    return np.asarray(starts[:, None] * (1.0 - shares) + ends[:, None] * shares)


def distances_m(corners: Corners, place: Corner) -> Vector:
    """The distance of each edge, never less than the true one, and more by less than a step."""
    return np.asarray(np.linalg.norm(edges(corners) - place, axis=2).min(axis=1))


def step_m(corners: Corners) -> float:
    return float(np.linalg.norm(np.diff(edges(corners)[:, :2], axis=1), axis=2).max())


def near(corners: Corners, offset: Corner) -> Corner:
    x, y = np.mean(corners, axis=0).tolist()
    return x + offset[0], y + offset[1]


@given(corners=polygons(), offset=offsets)
def test_inside_is_inside_and_the_clearance_is_how_far(corners: Corners, offset: Corner) -> None:
    place = near(corners, offset)
    nearest_m = float(distances_m(corners, place).min())
    assume(nearest_m > 0.01)
    fence = Fence(corners)
    inside = bool(Path([*corners, corners[0]], closed=True).contains_point(place))
    assert fence.contains(place) is inside
    clearance_m = fence.clearance_m(place)
    assert (clearance_m > 0.0) is inside
    assert nearest_m - step_m(corners) <= abs(clearance_m) <= nearest_m + 1e-9


@given(corners=polygons(), offset=offsets)
def test_clearances_of_many_places_are_those_by_shapely(corners: Corners, offset: Corner) -> None:
    places = [near(corners, offset), near(corners, (0.0, 0.0)), *[(x, y + 0.1) for x, y in corners]]
    shape, edge = Polygon(corners), RoundEdge(corners[0], 3.0)
    expected = [shape.exterior.distance(Point(each)) * (1 if shape.covers(Point(each)) else -1) for each in places]
    assert Fence(corners).clearances_m(np.array(places)) == pytest.approx(np.array(expected), abs=1e-6)
    assert Fence(corners, encloses=False).clearances_m(np.array(places)) == pytest.approx(-np.array(expected), abs=1e-6)
    outside_m = [Point(corners[0]).distance(Point(each)) - 3.0 for each in places]
    assert edge.clearances_m(np.array(places)) == pytest.approx(np.array(outside_m), abs=1e-6)


@given(corners=polygons(), offset=offsets, turn=st.floats(0.0, 2.0 * pi))
def test_the_reach_is_how_far_it_is_straight_on_to_the_fence(corners: Corners, offset: Corner, turn: float) -> None:
    (x, y), path = near(corners, offset), Path([*corners, corners[0]], closed=True)
    assume(distances_m(corners, (x, y)).min() > 0.01)
    assume(path.contains_point((x, y)))
    reach_m = Fence(corners).reach_m((x, y), (cos(turn), sin(turn)))
    on_fence = x + reach_m * cos(turn), y + reach_m * sin(turn)
    assert distances_m(corners, on_fence).min() <= step_m(corners)
    ahead_m = np.linspace(0.0, 0.999 * reach_m, 200)
    assert path.contains_points(np.column_stack([x + ahead_m * cos(turn), y + ahead_m * sin(turn)])).all()


def test_from_outside_the_fence_bounds_no_way() -> None:
    assert Fence(SQUARE).reach_m((-1.0, 2.0), (1.0, 0.0)) == inf


def sample_of(corners: Corners, place: Corner, edge: int) -> int:
    """The number of the sample of an edge that is nearest to a place."""
    return int(np.linalg.norm(edges(corners)[edge] - place, axis=1).argmin())


def behind_corner(corners: Corners, place: Corner, edge: int) -> bool:
    """Whether the nearest sample of an edge is a corner that sticks in, and that of the edge beside it is none."""
    count, sample = len(corners), sample_of(corners, place, edge)
    if 0 < sample < STEPS:
        return False
    corner, beside = (edge, (edge - 1) % count) if sample == 0 else ((edge + 1) % count, (edge + 1) % count)
    around_it = Path([*corners, corners[0]], closed=True)
    before, after = np.array(corners[corner - 1]), np.array(corners[(corner + 1) % count])
    ear_x, ear_y = np.array(corners[corner]) + 1e-3 * ((before - corners[corner]) + (after - corners[corner]))
    sticks_in = not around_it.contains_point((ear_x, ear_y))
    return sticks_in and 0 < sample_of(corners, place, beside) < STEPS


@given(corners=polygons(), offset=offsets, within_m=st.floats(0.5, 30.0) | st.just(inf))
def test_from_inside_the_nearest_point_of_every_edge_within_reach_is_found(
    corners: Corners, offset: Corner, within_m: float
) -> None:
    """But of those that begin or end in a corner that sticks in, while the place is beside the corner's other edge."""
    place = near(corners, offset)
    sampled_m = distances_m(corners, place)
    assume(sampled_m.min() > 0.01 and np.abs(sampled_m - within_m).min() > step_m(corners))
    fence = Fence(corners)
    assume(fence.contains(place))
    points = fence.nearest_points(place, within_m)
    expected_m = [m for i, m in enumerate(sampled_m.tolist()) if m < within_m and not behind_corner(corners, place, i)]
    assert [point.distance_m for point in points] == pytest.approx(expected_m, abs=step_m(corners))
    for point in points:
        assert hypot(*point.inward) == pytest.approx(1.0)
        foot = place[0] - point.distance_m * point.inward[0], place[1] - point.distance_m * point.inward[1]
        assert distances_m(corners, foot).min() <= step_m(corners)


@given(corners=polygons(), offset=offsets)
def test_from_outside_only_the_shortest_way_back_is_returned(corners: Corners, offset: Corner) -> None:
    place = near(corners, offset)
    sampled_m = distances_m(corners, place)
    assume(sampled_m.min() > 0.01)
    fence = Fence(corners)
    assume(not fence.contains(place))
    (point,) = fence.nearest_points(place, 0.0)
    assert point.distance_m == pytest.approx(-sampled_m.min(), abs=step_m(corners))
    back = place[0] - point.distance_m * point.inward[0], place[1] - point.distance_m * point.inward[1]
    assert distances_m(corners, back).min() <= step_m(corners)


@given(corners=polygons(), edge=st.integers(0, 3), share=st.floats(0.1, 0.9))
def test_on_an_edge_inwards_is_still_inwards(corners: Corners, edge: int, share: float) -> None:
    (x1, y1), (x2, y2) = corners[edge], corners[(edge + 1) % len(corners)]
    place = x1 + share * (x2 - x1), y1 + share * (y2 - y1)
    point = min(Fence(corners).nearest_points(place), key=lambda point: abs(point.distance_m))
    assert abs(point.distance_m) < 1e-9
    step = place[0] + 1e-3 * point.inward[0], place[1] + 1e-3 * point.inward[1]
    assert Path([*corners, corners[0]], closed=True).contains_point(step)


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_vehicle_exactly_on_a_straight_edge_is_sent_inwards(clockwise: bool) -> None:
    fence = Fence(SQUARE[::-1] if clockwise else SQUARE)
    for place, inward in (((2.0, 0.0), (0.0, 1.0)), ((4.0, 2.0), (-1.0, 0.0)), ((0.0, 2.0), (1.0, 0.0))):
        point = min(fence.nearest_points(place), key=lambda point: abs(point.distance_m))
        assert point.distance_m == 0.0
        assert point.inward == pytest.approx(inward)


def test_a_corner_that_sticks_in_is_no_wall_to_who_flies_along_the_edge_before_it() -> None:
    along, beyond = Fence(NOTCHED), (5.0 - 2.5, 4.0 - 0.1)  # just inside the edge from the notch to (0, 6)
    assert [point.end for point in along.nearest_points(beyond, 1.0)] == [0]
    # Under the notch itself both edges are told, from the corner that they share.
    assert [point.end for point in along.nearest_points((5.0, 1.5), 1.0)] == [1, -1]


def test_behind_a_notch_the_corner_that_sticks_in_is_nearest() -> None:
    fence = Fence(NOTCHED)
    assert not fence.contains((5.0, 3.0))
    assert fence.clearance_m((5.0, 3.0)) == pytest.approx(-1.0 * cos(np.arctan2(4.0, 5.0)))
    assert fence.clearance_m((5.0, 1.0)) == pytest.approx(1.0)
    sticking_in = [point for point in fence.nearest_points((5.0, 1.5)) if point.distance_m < 1.0]
    assert [(point.distance_m, point.inward) for point in sticking_in] == [(0.5, (0.0, -1.0))] * 2


@given(corners=polygons(), one=st.integers(0, 3), other=st.integers(0, 3))
def test_edges_that_cross_are_found_wherever_corners_are_in_disorder(corners: Corners, one: int, other: int) -> None:
    corners[one], corners[other] = corners[other], corners[one]
    count = len(corners)
    pieces = [Path([corners[i], corners[(i + 1) % count]]) for i in range(count)]
    crossing = {
        (i, k)
        for i in range(count)
        for k in range(i + 2, count)
        if (i, k) != (0, count - 1) and pieces[i].intersects_path(pieces[k], filled=False)
    }
    found = Fence(corners).crossed_edges()
    assert found in crossing if crossing else found is None


@pytest.mark.parametrize(
    ("corners", "crossed"),
    [
        ([(0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.0)], (0, 2)),
        ([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 0.0), (0.0, 4.0)], (0, 2)),  # a corner on another edge
        ([(0.0, 0.0), (4.0, 0.0), (2.0, 0.0), (2.0, 4.0)], (0, 2)),  # an edge that goes back over the one before
        (SQUARE, None),
        (NOTCHED, None),
    ],
)
def test_crossed_edges_by_name(corners: Corners, crossed: tuple[int, int] | None) -> None:
    assert Fence(corners).crossed_edges() == crossed


@given(corners=polygons(), offset=offsets)
def test_a_zone_has_the_distances_and_directions_of_its_outside(corners: Corners, offset: Corner) -> None:
    """Against shapely: distance and nearest point from outside, and the way out from inside."""
    place = (corners[0][0] + offset[0], corners[0][1] + offset[1])
    zone, shape, point = Fence(corners, encloses=False), Polygon(corners), Point(place)
    edge_m = shape.exterior.distance(point)
    assume(edge_m > 1e-6)
    assert zone.contains(place) is not shape.contains(point)
    assert zone.clearance_m(place) == pytest.approx(-edge_m if shape.contains(point) else edge_m, abs=1e-6)
    nearest = min(zone.nearest_points(place), key=lambda each: each.distance_m)
    assert nearest.distance_m == pytest.approx(zone.clearance_m(place), abs=1e-6)
    on_edge = (place[0] - nearest.distance_m * nearest.inward[0], place[1] - nearest.distance_m * nearest.inward[1])
    assert shape.exterior.distance(Point(on_edge)) < 1e-6


def test_along_a_side_of_a_zone_no_other_side_is_in_the_way() -> None:
    """A vehicle above a square passes its corners; diagonally off a corner it has the two sides that it could meet."""
    zone = Fence(SQUARE, encloses=False)
    assert [each.inward for each in zone.nearest_points((3.5, 5.0))] == [(0.0, 1.0)]
    assert [each.distance_m for each in zone.nearest_points((-3.0, 8.0))] == pytest.approx([5.0, 5.0])
    assert zone.nearest_points((3.5, 5.0), within_m=0.5) == []


def test_a_round_zone_is_a_circle_from_outside() -> None:
    disc = RoundEdge((1.0, 2.0), 3.0)
    (point,) = disc.nearest_points((6.0, 2.0))
    assert (point.distance_m, point.inward) == (2.0, (1.0, 0.0))
    (point,) = disc.nearest_points((1.0, 1.0))
    assert (point.distance_m, point.inward) == (-2.0, (0.0, -1.0))
    assert disc.nearest_points((6.0, 2.0), within_m=1.0) == []
    assert not disc.contains((1.0, 4.9))


def test_the_room_of_a_vehicle_is_that_of_fence_and_zones_at_its_height() -> None:
    mast = NoFlySection(name="mast", center_m=(5.0, 0.0), radius_m=1.0, ceiling_m=10.0)
    area = Area(SafetySettings(fence_m=tuple(SQUARE), no_fly=(mast,)))
    assert area.clearance_m((3.5, 2.0), 12.0) == pytest.approx(0.5)
    assert area.clearance_m((4.0, 1.0), 8.0) == pytest.approx(min(0.0, hypot(1.0, 1.0) - 1.0))
    entered = area.entered((4.5, 0.0), 8.0)
    assert entered is not None
    assert entered.name == "mast"
    assert area.entered((4.5, 0.0), 10.5) is None
    assert Area(SafetySettings()).clearance_m((0.0, 0.0), 0.0) == inf
