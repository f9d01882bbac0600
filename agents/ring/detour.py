"""Detours of the ring around obstacles on it: a vehicle that fell silent there, or holds.

The guard alone would also keep the distance, but late, with a jump, and always to the right, which for some vehicles is
across the ring. The bend is outwards and early, and the vehicles keep their order and spacing.
"""

from collections.abc import Iterable, Sequence
from math import asin, inf, pi
from typing import Final

import numpy as np

from estimation.frames import wrap_turn_rad
from estimation.polar import Polar
from estimation.state import Vector
from estimation.vectors import Pair

_GAIN_PER_S = 0.5
_ABREAST = 2.0
"""In headways: vehicles whose radii differ by more may pass each other."""
_QUARTER_RAD = 1.5708


def leads(unit: Pair, place_m: Pair, direction: float) -> bool:
    """Return whether a place about the target is up to a quarter turn ahead of a bearing, given as a unit vector."""
    (x, y), (place_x, place_y) = unit, place_m
    return direction * (x * place_y - y * place_x) > 0.0 and x * place_x + y * place_y > 0.0


def headway_rate_rad_s(polar: Polar, others: Iterable[Polar], direction: float, headway_m: float) -> float:
    """Return the largest angular rate in a direction (+1, -1) that keeps `headway_m` to the next vehicle ahead."""
    bound_rad_s = inf
    for other in others:
        ahead_rad = wrap_turn_rad(direction * (other.bearing_rad - polar.bearing_rad))
        if ahead_rad < _QUARTER_RAD and abs(other.radius_m - polar.radius_m) < _ABREAST * headway_m:
            spare_rad = ahead_rad - headway_m / polar.radius_m
            bound_rad_s = min(bound_rad_s, direction * other.angular_rate_rad_s + _GAIN_PER_S * spare_rad)
    return max(bound_rad_s, 0.0)


MARGIN_M = 0.5
"""The margin over the distance that the guard demands, so that the guard does not intervene."""
_INWARD_MOST = 0.25
"""In radii of the ring: the largest bend inwards."""
_INWARD_CLEARLY = 0.5
"""In distances to keep: the largest bend inwards. With it the side of the obstacle is unambiguous, and the bend does
not change sides while a vehicle passes one that was lost on the ring itself.
"""


class Obstacle:
    """An obstacle: its bearing and radius about the target, and the distance to keep from it."""

    def __init__(self, bearing_rad: float, radius_m: float, distance_m: float) -> None:
        self.bearing_rad: Final = bearing_rad
        self.radius_m: Final = radius_m
        self.distance_m: Final = distance_m


def bend_m(ring_m: float, polar: Polar, obstacles: Sequence[Obstacle]) -> float:
    """Return how far the ring bends outwards at a vehicle's bearing."""
    if not obstacles:
        return 0.0
    return float(bent_ring_m(ring_m, np.array([polar.bearing_rad]), obstacles, polar.radius_m).item()) - ring_m


def bent_ring_m(ring_m: float, bearings_rad: Vector, obstacles: Iterable[Obstacle], own_m: float = 0.0) -> Vector:
    """Return the radius of the ring at bearings (n,): bent around the obstacles on it.

    It bends outwards, or inwards where an obstacle is so far outside that a small bend suffices, except for a vehicle
    whose radius `own_m` is larger than the obstacle's.
    """
    radius_m = np.full(bearings_rad.shape, ring_m)
    for obstacle in obstacles:
        clear_m = obstacle.distance_m + MARGIN_M
        outer_m, inner_m = obstacle.radius_m + clear_m - ring_m, ring_m - obstacle.radius_m + clear_m
        if outer_m <= 0.0 or inner_m <= 0.0:
            continue
        inwards = inner_m <= min(_INWARD_MOST * ring_m, _INWARD_CLEARLY * clear_m) and own_m <= obstacle.radius_m
        bend_m = -inner_m if inwards else outer_m
        # A squared cosine of twice the obstacle's width: smooth at every bearing, so that no step is flown.
        width_rad = 2.0 * asin(min(clear_m / obstacle.radius_m, 1.0))
        off_rad = np.abs((bearings_rad - obstacle.bearing_rad + pi) % (2.0 * pi) - pi)
        bump = bend_m * np.cos(np.minimum(off_rad / width_rad, 1.0) * pi / 2.0) ** 2
        radius_m = np.where(np.abs(bump) > np.abs(radius_m - ring_m), ring_m + bump, radius_m)
    return radius_m
