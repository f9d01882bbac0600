"""Limits of numbers to a range, and of vectors with two components to a length."""

from math import hypot

from estimation.state import Vector

Pair = tuple[float, float]


def limited(value: float, limit: float) -> float:
    """Return the number nearest to `value` in [-limit, limit]; NaN becomes -limit."""
    if value > limit:
        return limit
    return value if value >= -limit else -limit


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
