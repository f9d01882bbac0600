"""The shapes of a formation: every slot relative to the leader's, in the mission frame, x in flight direction."""

from itertools import pairwise
from math import dist, sqrt
from typing import Literal, get_args

SpacedShape = Literal["line", "column", "wedge"]
"""The shapes made from `spacing_m` and the line order."""
Shape = Literal[SpacedShape, "free"]
SPACED_SHAPES: tuple[SpacedShape, ...] = get_args(SpacedShape)
SHAPES: tuple[Shape, ...] = get_args(Shape)


def offset_m(shape: SpacedShape, place: int, leader: int, spacing_m: float) -> tuple[float, float]:
    """Return the slot of index `place` relative to the leader's of index `leader` [m]; the first is farthest left.

    A line is abreast. In a column the leader flies ahead, then those next to it in line order, the left one first. In a
    wedge both arms trail it by 45 degrees. Neighbours in line order are `spacing_m` apart in each, or farther.
    """
    right = place - leader
    match shape:
        case "line":
            return 0.0, -right * spacing_m
        case "column":
            return -(2 * abs(right) - (right < 0)) * spacing_m, 0.0
        case "wedge":
            along_m = spacing_m / sqrt(2.0)
            return -abs(right) * along_m, -right * along_m


def gap_m(shape: SpacedShape, count: int, leader: int, spacing_m: float) -> float:
    """Return the largest distance between neighbours in line order [m], one of which keeps station on the other."""
    slots_m = [offset_m(shape, place, leader, spacing_m) for place in range(count)]
    return max((dist(*pair) for pair in pairwise(slots_m)), default=0.0)
