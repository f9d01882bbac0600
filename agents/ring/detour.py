"""Detours of the ring around obstacles on it: a vehicle that fell silent there, or holds.

The guard alone would also keep the distance, but late, with a jump, and always to the right, which for some vehicles is
across the ring. The bend is outwards and early, and the vehicles keep their order and spacing.
"""

from collections.abc import Sequence
from math import asin, atan2, copysign, cos, inf, pi, sin, sqrt
from typing import Final

import numpy as np

from estimation.polar import Polar, angular_rate_of, polar_of
from estimation.state import Vector
from estimation.vectors import Pair, length, wrap_signed_rad

_GAIN_PER_S: Final = 0.5

_FARTHER_IN: Final = 0.5
"""In headways: a vehicle that is so much farther in comes first."""

Motion = tuple[float, float, float, float]


class Headway:
    """What keeps `headway_m` to the next vehicle on either side, and to those farther in.

    Vehicles up to a quarter turn away limit the angular rate, unless their radii differ by `abreast_m`: they may pass
    each other. Behind one that is farther in, the vehicle keeps its radius until there is room.
    """

    def __init__(self, polar: Polar, headway_m: float, abreast_m: float) -> None:
        self._radius_m = polar.radius_m
        self._x, self._y = cos(polar.bearing_rad), sin(polar.bearing_rad)
        self._headway_m, self._abreast_m = headway_m, abreast_m
        self._least_rad_s, self._most_rad_s, self._least_m = -inf, inf, 0.0

    def keep_to(self, motion: Motion) -> None:
        """Keep it to a vehicle, by its motion [x y x' y'] relative to the target."""
        its_x, its_y, its_x_rate, its_y_rate = motion
        across, along = self._x * its_y - self._y * its_x, self._x * its_x + self._y * its_y
        if along <= 0.0:
            return
        farther_in_m, headway_m = self._radius_m - length(across, along), self._headway_m
        if abs(across) < headway_m and farther_in_m > _FARTHER_IN * headway_m:
            self._least_m = max(self._least_m, along + sqrt(headway_m * headway_m - across * across))
        if abs(farther_in_m) >= self._abreast_m:
            return
        spare_rad_s = _GAIN_PER_S * (abs(atan2(across, along)) - headway_m / self._radius_m)
        other_rad_s = angular_rate_of(its_x, its_y, its_x_rate, its_y_rate)
        if across > 0.0:
            self._most_rad_s = min(self._most_rad_s, max(other_rad_s + spare_rad_s, 0.0))
        elif across < 0.0:
            self._least_rad_s = max(self._least_rad_s, min(other_rad_s - spare_rad_s, 0.0))

    @property
    def rates_rad_s(self) -> Pair:
        """The least and the largest angular rate."""
        return self._least_rad_s, self._most_rad_s

    @property
    def least_m(self) -> float:
        """The least radius."""
        return min(self._least_m, self._radius_m)


MARGIN_M: Final = 0.5
"""The margin over the distance that the guard demands, so that the guard does not intervene."""
_INWARD_MOST: Final = 0.25
"""In radii of the ring: the largest bend inwards."""
_INWARD_CLEARLY: Final = 0.5
"""In distances to keep: the largest bend inwards. With it the side of the obstacle is unambiguous, and the bend does
not change sides while a vehicle passes one that was lost on the ring itself.
"""
_SLOW_RAD_S: Final = 0.02
"""A vehicle on a slower ring is treated as one at this rate: what it meets later is not predicted."""
_SLOWED_SHARE: Final = 0.5
"""The least share of the ring's rate at which a vehicle is expected to go on."""
_CLOSING_SHARE: Final = 0.25
"""The least share of its own rate at which the vehicle comes nearer to an obstacle that moves along with it."""
_TRIES: Final = 4
"""Newton's steps towards the time of the meeting."""
_BEGUN: Final = 2.0
"""By how much a vehicle's distance inside the ring makes a larger bend inwards, and outside of it a smaller one."""


class Obstacle:
    """An obstacle: its bearing and radius about the target, the distance to keep from it, and from where to bend."""

    def __init__(self, bearing_rad: float, radius_m: float, distance_m: float, bent_from_m: float = 0.0) -> None:
        self.bearing_rad: Final = bearing_rad
        self.radius_m: Final = radius_m
        self.clear_m: Final = distance_m + MARGIN_M
        self._bent_from_m = bent_from_m
        self._half_rad: Final = asin(self.clear_m / max(radius_m, self.clear_m))

    def width_rad(self, bend_m: float) -> float:
        """Return on either side of the obstacle how far the ring is bent: a larger bend begins earlier."""
        width_rad = 2.0 * self._half_rad * max(1.0, bend_m / self.clear_m)
        return min(max(width_rad, self._bent_from_m / max(self.radius_m, self.clear_m)), pi)

    def nearer(self, by_m: float) -> "Obstacle":
        """Return the obstacle so much nearer to the target."""
        radius_m = max(self.radius_m - by_m, MARGIN_M)
        return Obstacle(self.bearing_rad, radius_m, self.clear_m - MARGIN_M, self._bent_from_m)

    def leaves_room_to(self, other: "Obstacle") -> bool:
        """Return whether a vehicle can pass between the two."""
        apart_rad = self.bearing_rad - other.bearing_rad
        apart_m2 = self.radius_m**2 + other.radius_m**2 - 2.0 * self.radius_m * other.radius_m * cos(apart_rad)
        return apart_m2 >= (self.clear_m + other.clear_m) ** 2

    def is_within(self, other: "Obstacle", width_rad: float) -> bool:
        """Return whether the way around this obstacle, bent within a width, comes near another one."""
        return abs(wrap_signed_rad(self.bearing_rad - other.bearing_rad)) < width_rad + 2.0 * other._half_rad


def met(polar: Polar, rate_rad_s: float, motion: Motion, distance_m: float, bent_from_m: float = 0.0) -> Obstacle:
    """Return an obstacle where a vehicle on a ring of `rate_rad_s` meets it at its present rate.

    Where the target moves, an obstacle that stays in place moves through the ring. From its present place the vehicle
    would choose one side of it, and arrive when the other side is free.
    """
    x, y, x_rate, y_rate = motion
    direction = copysign(1.0, rate_rad_s)
    fast_rad_s = max(direction * polar.angular_rate_rad_s, _SLOWED_SHARE * abs(rate_rad_s), _SLOW_RAD_S)
    ahead_s, place = 0.0, polar_of(*motion)
    for _ in range(_TRIES):
        left_rad = direction * wrap_signed_rad(place.bearing_rad - polar.bearing_rad) - fast_rad_s * ahead_s
        closing_rad_s = max(fast_rad_s - direction * place.angular_rate_rad_s, _CLOSING_SHARE * fast_rad_s)
        ahead_s = min(max(ahead_s + left_rad / closing_rad_s, 0.0), pi / fast_rad_s)
        place = polar_of(x + x_rate * ahead_s, y + y_rate * ahead_s, x_rate, y_rate)
    return Obstacle(place.bearing_rad, place.radius_m, distance_m, bent_from_m)


def bend_m(ring_m: float, polar: Polar, obstacles: Sequence[Obstacle]) -> float:
    """Return how far the ring bends outwards at a vehicle's bearing."""
    if not obstacles:
        return 0.0
    return float(bent_ring_m(ring_m, np.array([polar.bearing_rad]), obstacles, polar.radius_m).item()) - ring_m


def bent_ring_m(ring_m: float, bearings_rad: Vector, obstacles: Sequence[Obstacle], own_m: float) -> Vector:
    """Return the radius of the ring at bearings (n,): bent around the obstacles on it.

    It bends outwards, or inwards where an obstacle is so far outside that a small bend suffices, except for a vehicle
    whose radius `own_m` is larger than the obstacle's. A vehicle that has begun to pass it on one side stays there.
    """
    radius_m = np.full(bearings_rad.shape, ring_m)
    for obstacle, bend_m in _bends(ring_m, obstacles, own_m):
        # A squared cosine: smooth at every bearing, so that no step is flown.
        off_rad = np.abs((bearings_rad - obstacle.bearing_rad + pi) % (2.0 * pi) - pi)
        bump = bend_m * np.cos(np.minimum(off_rad / obstacle.width_rad(bend_m), 1.0) * pi / 2.0) ** 2
        radius_m = np.where(np.abs(bump) > np.abs(radius_m - ring_m), ring_m + bump, radius_m)
    return radius_m


def bends(ring_m: float, obstacles: Sequence[Obstacle], own_m: float) -> bool:
    """Return whether the ring bends around any of the obstacles."""
    return bool(_bends(ring_m, obstacles, own_m))


def _bends(ring_m: float, obstacles: Sequence[Obstacle], own_m: float) -> list[tuple[Obstacle, float]]:
    """Return the obstacles on the ring with the bend around each, inwards negative.

    Around one that leaves no room between itself and the way around another, the ring bends as around that one.
    """
    outwards, inwards, farther_out, farther_in = [list[Obstacle]() for _ in range(4)]
    for each in obstacles:
        inner_m = ring_m - each.radius_m + each.clear_m
        if each.radius_m + each.clear_m <= ring_m:
            farther_in.append(each)
        elif inner_m <= 0.0:
            farther_out.append(each)
        else:
            clearly_m = _INWARD_CLEARLY * each.clear_m + _BEGUN * (ring_m - own_m)
            small = inner_m <= min(_INWARD_MOST * ring_m, clearly_m) and own_m <= each.radius_m
            (inwards if small else outwards).append(each)
    outwards += [each for each in inwards if not all(map(each.leaves_room_to, farther_in))]
    for one in outwards:  # grows meanwhile
        width_rad = one.width_rad(one.radius_m + one.clear_m - ring_m)
        outwards += [each for each in inwards if each not in outwards and one.is_within(each, width_rad)]
        outwards += [each for each in farther_out if each not in outwards and one.is_within(each, width_rad)]
    found = [(each, each.radius_m + each.clear_m - ring_m) for each in outwards]
    return found + [(each, each.radius_m - each.clear_m - ring_m) for each in inwards if each not in outwards]
