"""The way of a single vehicle into a formation that flies already: around it, then into its slot along a free lane.

Straight through, it would push others out of their places, and whoever keeps station on these with them.
"""

from collections.abc import Sequence
from math import inf

from estimation.vectors import Pair

CLEAR = 2.0
"""In separations: how far from all slots a vehicle flies around them."""
_LANE, _LANE_KEPT = 0.15, 0.5
"""In separations: how far off the middle of its lane a vehicle may be when it turns in, and from then on."""
_FROM = ((-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 0.0))
"""Where lanes come from, the first free one is taken: behind, left, right, ahead."""


def way_point(off_m: Pair, others_m: Sequence[Pair], separation_m: float) -> Pair:
    """Return where to go next, relative to the own slot, from `off_m`; `others_m` are the other slots.

    The slot itself is (0, 0): it is aimed at once the vehicle is in its lane.
    """
    clear_m = CLEAR * separation_m
    x, y = next((lane for lane in _FROM if _free(lane, others_m, separation_m)), _FROM[0])
    # Along the lane, outwards, and across it.
    out_m, aside_m = off_m[0] * x + off_m[1] * y, off_m[1] * x - off_m[0] * y
    slots = [(a * x + b * y, b * x - a * y) for a, b in ((0.0, 0.0), *others_m)]
    out_most_m, right_m, left_m = max(s[0] for s in slots), min(s[1] for s in slots), max(s[1] for s in slots)
    lane_m = (_LANE if out_m >= out_most_m else _LANE_KEPT) * separation_m
    if abs(aside_m) <= lane_m and out_m >= -separation_m / 2.0:
        goal_m = 0.0, 0.0
    elif out_m >= out_most_m + clear_m / 2.0:
        goal_m = out_most_m + clear_m, 0.0
    elif right_m - clear_m / 2.0 < aside_m < left_m + clear_m / 2.0 and out_m < 0.0:
        goal_m = out_m, right_m - clear_m if aside_m - right_m < left_m - aside_m else left_m + clear_m
    else:
        goal_m = out_most_m + clear_m, aside_m
    return goal_m[0] * x - goal_m[1] * y, goal_m[0] * y + goal_m[1] * x


def _free(lane: Pair, others_m: Sequence[Pair], separation_m: float) -> bool:
    """Return whether no slot lies in the lane to the own one."""
    x, y = lane
    nearest_m = min((abs(b * x - a * y) for a, b in others_m if a * x + b * y > 0.0), default=inf)
    return nearest_m >= separation_m
