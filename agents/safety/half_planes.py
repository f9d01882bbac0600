"""The nearest point in a disc and half-planes: a quadratic programme of two unknowns, solved exactly.

The guard solves it whenever a demand is violated, and once per level if not all demands can be met. Compared with OSQP,
which the guard uses for the relaxed problem, it is faster (random problems of four half-planes: median 2 us instead of
26 us, 99 % 4 us instead of 350 us; of sixteen: median 13 us instead of 77 us), exact, uses the disc instead of a
polygon in it, and returns None only if the demands have no point in common.
"""

from collections.abc import Iterable, Sequence
from math import inf, sqrt
from typing import Final

from estimation.vectors import Pair, clipped_pair

_MET = 1e-9
_PARALLEL = 1e-12


class HalfPlane:
    """All points u with `normal . u >= least`; the normal has length one."""

    def __init__(self, normal: Pair, least: float) -> None:
        self.normal: Final = normal
        self.least: Final = least

    def missing(self, point: Pair) -> float:
        """Return the distance of a point from the half-plane, negative inside."""
        return self.least - self.normal[0] * point[0] - self.normal[1] * point[1]


def nearest(wanted: Pair, radius: float, planes: Sequence[HalfPlane]) -> Pair | None:
    """Return the point of all half-planes and of the disc about the origin that is nearest to `wanted`.

    None if they have no point in common. The planes are added one by one: if the point violates the next plane, the new
    point lies on that plane's edge. With m half-planes this takes m (m + 1) / 2 steps at most.
    """
    point = clipped_pair(wanted, radius)
    for index, plane in enumerate(planes):
        if plane.missing(point) > _MET:
            on_edge = _nearest_on_edge(wanted, radius, plane, planes[:index])
            if on_edge is None:
                return None
            point = on_edge
    return point


def _nearest_on_edge(wanted: Pair, radius: float, plane: HalfPlane, others: Iterable[HalfPlane]) -> Pair | None:
    """Return the point nearest to `wanted` on the edge of one half-plane, inside the disc and the other half-planes."""
    normal_x, normal_y = plane.normal
    half_chord2 = radius**2 - plane.least**2
    if half_chord2 < 0.0:
        return None
    high = sqrt(half_chord2)
    low = -high
    # Along the edge: from the point nearest to the origin, to the left of the normal.
    for other in others:
        across = normal_x * other.normal[1] - normal_y * other.normal[0]
        missing = other.least - plane.least * (normal_x * other.normal[0] + normal_y * other.normal[1])
        if abs(across) < _PARALLEL:
            low = inf if missing > _MET else low
        elif across > 0.0:
            low = max(low, missing / across)
        else:
            high = min(high, missing / across)
    if low > high:
        return None
    along = min(max(normal_x * wanted[1] - normal_y * wanted[0], low), high)
    return plane.least * normal_x - along * normal_y, plane.least * normal_y + along * normal_x
