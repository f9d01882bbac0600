"""How near two vehicles came to each other."""

from collections.abc import Collection
from typing import Final

import numpy as np

from estimation.state import Vector

AIRBORNE_M: Final = 0.5
"""A vehicle that is less than this above the origin, or above its lowest place if that is lower, is on the ground."""
WAYS_STEP_S: Final = 0.1


def closest_approach_m(x_m: Vector, y_m: Vector, height_m: Vector, above_m: Vector) -> float | None:
    """Return the smallest horizontal distance of two vehicles in the air, None if no two were measured at one time.

    Places are (V, T), NaN where not known. Two do not count if their heights differ by `above_m` (V, T) of one of them,
    or if a height is not known; where both are infinite, heights do not matter.
    """
    if len(x_m) < 2:
        return None
    ground_m = np.fmin.reduce(height_m, axis=1, keepdims=True, initial=0.0)
    x_m = np.where(height_m <= ground_m + AIRBORNE_M, np.nan, x_m)
    closest_m = np.inf
    for row in range(len(x_m) - 1):
        apart_m = np.hypot(x_m[row + 1 :] - x_m[row], y_m[row + 1 :] - y_m[row])
        needed_m = np.minimum(above_m[row + 1 :], above_m[row])
        counts = np.isinf(needed_m) | (np.abs(height_m[row + 1 :] - height_m[row]) < needed_m)
        apart_m = np.where(counts, apart_m, np.nan)
        closest_m = min(closest_m, float(np.fmin.reduce(apart_m, axis=None, initial=np.inf)))
    return closest_m if closest_m < np.inf else None


def ways_s(times_s: Collection[Vector], mission_s: tuple[float, float]) -> Vector:
    """Return the times (T,) of the ways, from the first place known until the last one: those outside the mission."""
    known = [each for each in times_s if each.size]
    if not known:
        return np.empty(0)
    out_s = np.arange(min(each[0] for each in known), mission_s[0], WAYS_STEP_S)
    home_s = np.arange(mission_s[1], max(each[-1] for each in known), WAYS_STEP_S)
    return np.concatenate((out_s, home_s))


def closest_on_ways_m(position_m: Vector, above_m: float) -> float | None:
    """Return the smallest horizontal distance of two vehicles in the air on the way out and on the way home.

    `position_m` (V, T, 3) are their places then, NaN where not known. Two whose heights differ by `above_m` do not
    count: vehicles take off and return in layers. None if there were never two.
    """
    if not position_m.size:
        return None
    x_m, y_m, height_m = np.moveaxis(position_m, 2, 0)
    return closest_approach_m(x_m, y_m, height_m, np.full_like(x_m, above_m))
