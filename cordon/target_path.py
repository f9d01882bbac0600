"""A target that moves along any path: the legs of a mission's target that follow it."""

from collections.abc import Callable
from itertools import pairwise
from math import ceil, hypot

from cordon.returned import finite_numbers
from gcs.mission.mission import PARTS_MAX, Mission

TargetPath = Callable[[float], tuple[float, float]]
"""Where the target is: from the mission time [s] to its position (x, y) in the mission frame [m].

It moves straight from its place at one tick to that at the next; in flights of more than 1000 ticks from every second,
third, ... tick to the next. At most 20 m/s, as all targets.
"""


def with_target_path(mission: Mission, path: TargetPath, duration_s: float) -> Mission:
    """Return the mission with a simulated target that follows the path until `duration_s`, and stays there.

    It does so in straight `legs` of the mission itself. So a log of the flight, read anywhere, says where the target was.
    Raises InputError, also for a target that is faster than targets may be.
    """
    ticks = max(round(duration_s * mission.mission.rate_hz), 1)
    stride = ceil(ticks / PARTS_MAX)
    step_s = stride / mission.mission.rate_hz
    points = [_point(path, index * step_s) for index in range(ceil(ticks / stride) + 1)]
    legs = [_leg(*pair, step_s) for pair in pairwise(points)]
    target = {"source": "simulated", "start_m": points[0], "velocity_m_s": (0.0, 0.0), "legs": legs, "rounds": 1}
    return mission.replace(target=target)


def _point(path: TargetPath, time_s: float) -> tuple[float, float]:
    x, y = finite_numbers(path(time_s), ("x_m", "y_m"), f"target: the path at {time_s:g} s")
    return x, y


def _leg(from_m: tuple[float, float], to_m: tuple[float, float], step_s: float) -> dict[str, object]:
    away_m = hypot(to_m[0] - from_m[0], to_m[1] - from_m[1])
    if away_m == 0.0:
        return {"to_m": to_m, "speed_m_s": 1.0, "pause_s": step_s}
    return {"to_m": to_m, "speed_m_s": away_m / step_s}
