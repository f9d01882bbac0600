"""The way into a formation: it ends at the slot, and keeps clear of all others, wherever it begins."""

from math import dist, hypot

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from agents.control.station_keeping import way_point
from agents.settings.shapes import SPACED_SHAPES, SpacedShape, offset_m

SEPARATION_M = 3.0
STEP_M = 0.2
ARRIVED_M = 2.5
"""So near to its slot a vehicle asks for no way any more: half the spacing."""


@pytest.mark.parametrize("shape", SPACED_SHAPES)
@settings(max_examples=25)
@given(
    count=st.integers(2, 8),
    leader=st.integers(0, 7),
    own=st.integers(0, 7),
    start=st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)),
)
def test_from_anywhere_around_it_the_slot_is_reached_without_a_conflict(
    shape: SpacedShape, count: int, leader: int, own: int, start: tuple[float, float]
) -> None:
    slots = [offset_m(shape, place, leader % count, 5.0) for place in range(count)]
    own_x, own_y = slots.pop(own % count)
    others = [(x - own_x, y - own_y) for x, y in slots]
    assume(all(dist(start, other) > 2.0 * SEPARATION_M for other in others))
    assume(hypot(*start) > ARRIVED_M)
    x, y = start
    for _ in range(2000):
        goal_x, goal_y = way_point((x, y), others, SEPARATION_M)
        away_m = dist((x, y), (goal_x, goal_y))
        if hypot(x, y) < ARRIVED_M:
            break
        step = min(STEP_M, away_m) / away_m
        x, y = x + (goal_x - x) * step, y + (goal_y - y) * step
        assert min(dist((x, y), other) for other in others) >= SEPARATION_M
    assert hypot(x, y) < ARRIVED_M
