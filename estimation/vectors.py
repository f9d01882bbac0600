"""Lengths of vectors with two components; limits of numbers to a range, of angles to one turn, of vectors; rounding."""

from math import floor, hypot, pi, remainder, sqrt, tau
from typing import Final

from estimation.state import Vector

Pair = tuple[float, float]


def length(x: float, y: float) -> float:
    """Return `hypot(x, y)` of numbers whose squares are numbers; compiled code calls `hypot` through Python, and `sqrt`
    not, which takes a tenth of the time.
    """
    return sqrt(x * x + y * y)


def limited(value: float, limit: float) -> float:
    """Return the number nearest to `value` in [-limit, limit]; NaN becomes -limit."""
    if value > limit:
        return limit
    return value if value >= -limit else -limit


def wrap_signed_rad(angle_rad: float) -> float:
    """Wrap an angle to [-pi, pi]."""
    return angle_rad if -pi <= angle_rad <= pi else remainder(angle_rad, tau)


_PARTS: Final = [10.0**digits for digits in range(10)]
_SURE: Final = 0.499
_LARGEST: Final = 1e12
"""Up to here a multiple of a number shows by which whole one its decimals are rounded."""


def rounded(value: float, digits: int) -> float:
    """Return `round(value, digits)` for up to nine digits, the same number in a fraction of the time; never -0.0."""
    scaled = value * _PARTS[digits]
    if not -_LARGEST < scaled < _LARGEST:
        return round(value, digits)
    whole = floor(scaled + 0.5)
    return whole / _PARTS[digits] if -_SURE < scaled - whole < _SURE else round(value, digits)


def clipped(vector: Vector, length_max: float) -> Vector:
    """Return a vector (2,) limited to `length_max`; the same object if it is not longer."""
    length = hypot(*vector.tolist())
    return vector if length <= length_max else vector * (length_max / length)


def clipped_pair(vector: Pair, length_max: float) -> Pair:
    """Return the same for a vector given as two numbers, for callers where an array costs more than its arithmetic.

    It multiplies before it divides, so the last digit may differ from `clipped`; replays of recorded flights need both.
    """
    length = hypot(*vector)
    return vector if length <= length_max else (vector[0] * length_max / length, vector[1] * length_max / length)
