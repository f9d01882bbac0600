"""The shapes of a formation: where every slot lies about the leader's, in the mission frame, x along the way."""

from math import sqrt
from typing import Literal, get_args

Shape = Literal["line", "column", "wedge", "free"]
SHAPES: tuple[Shape, ...] = get_args(Shape)


def offset_m(shape: Shape, place: int, leader: int, spacing_m: float) -> tuple[float, float]:
    """Return where the slot of index `place` lies from the leader's of index `leader`; the first is farthest left.

    A line is abreast. In a column the leader flies ahead, then those next to it in line order, the left one first. In a
    wedge both arms trail it by 45 degrees. Neighbours in line order are `spacing_m` apart in each, or farther.
    Raises ValueError for "free", whose slots lie where the mission puts them.
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
        case "free":
            raise ValueError("the slots of a free formation are the mission's")
