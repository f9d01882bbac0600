"""Headway: the distance to the vehicle in front, on the ring and on the way to it."""

from collections.abc import Iterable
from math import inf

from estimation.frames import wrap_turn_rad
from estimation.polar import Polar
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
