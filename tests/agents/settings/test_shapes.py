"""The formation's shapes: who is where, and that nobody is nearer to anybody than the spacing."""

from collections.abc import Callable
from itertools import combinations, product
from math import dist, sqrt

import pytest

from agents.settings.config import AgentConfig
from agents.settings.shapes import SHAPES, SPACED_SHAPES, SpacedShape, offset_m

Maker = Callable[..., AgentConfig]


@pytest.mark.parametrize(
    ("shape", "places"),
    [
        ("line", [(0.0, 10.0), (0.0, 5.0), (0.0, 0.0), (0.0, -5.0), (0.0, -10.0)]),
        ("column", [(-15.0, 0.0), (-5.0, 0.0), (0.0, 0.0), (-10.0, 0.0), (-20.0, 0.0)]),
        ("wedge", [(-7.071, 7.071), (-3.536, 3.536), (0.0, 0.0), (-3.536, -3.536), (-7.071, -7.071)]),
    ],
)
def test_shapes_by_hand(shape: SpacedShape, places: list[tuple[float, float]]) -> None:
    assert [offset_m(shape, place, 2, 5.0) for place in range(5)] == [pytest.approx(p, abs=1e-3) for p in places]


def test_in_no_shape_is_anybody_nearer_than_the_spacing(subtests: pytest.Subtests) -> None:
    for shape, leader in product(SPACED_SHAPES, range(16)):
        with subtests.test(shape=shape, leader=leader):
            slots = [offset_m(shape, place, leader, 4.0) for place in range(16)]
            assert min(dist(*pair) for pair in combinations(slots, 2)) >= 4.0 - 1e-9
            assert slots[leader] == pytest.approx((0.0, 0.0))
            assert all(x <= 1e-9 for x, _ in slots)


@pytest.mark.parametrize("leader", [0, 1, 2])
def test_on_straight_paths_between_shapes_vehicles_keep_apart(leader: int) -> None:
    # All set out together and fly at one pace: the nearest two are never nearer than half the spacing.
    for before, after in combinations(SPACED_SHAPES, 2):
        for share in (step / 50.0 for step in range(51)):
            places = []
            for place in range(5):
                (x, y), (to_x, to_y) = (offset_m(shape, place, leader, 1.0) for shape in (before, after))
                places.append(((1.0 - share) * x + share * to_x, (1.0 - share) * y + share * to_y))
            assert min(dist(*pair) for pair in combinations(places, 2)) >= 1.0 / sqrt(2.0) - 0.15, (before, after)


def test_the_mission_says_which_shapes_there_are(make_config: Maker) -> None:
    slots_m = ((0.0, 9.0), (3.0, 0.0), (0.0, -9.0))
    assert (make_config().shape, make_config().shapes) == ("line", SPACED_SHAPES)
    free = make_config(slots_m=slots_m)
    assert (free.shape, free.shapes) == ("free", SHAPES)
    assert free.slot_offset_m(1, 2) == (-3.0, 9.0)
    assert make_config(slots_m=slots_m, formation={"shape": "column"}).shape == "column"
    # Slots may be apart though the spacing is not: then there is no other shape to fly.
    assert make_config(slots_m=slots_m, formation={"spacing_m": 0.5}).shapes == ("free",)
    assert make_config().reshaped("column").slot_offset_m(3, 2) == (-10.0, 0.0)
