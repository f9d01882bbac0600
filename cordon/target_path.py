"""A target that moves along any path: the legs of a mission's target that follow it."""

from collections.abc import Callable
from itertools import pairwise
from math import ceil, hypot

from cordon.returned import finite_numbers
from gcs.errors import InputError
from gcs.mission.mission import PARTS_MAX, TARGET_SPEED_MAX_M_S, Mission

TargetPath = Callable[[float], tuple[float, float]]
"""The target's path: from the mission time [s] to its position (x, y) in the mission frame [m].

The target moves straight from its position at one tick to that at the next; in flights of more than 1000 ticks, from
every second, third, ... tick to the next. At the end it stays at its last position.
"""


def with_target_path(mission: Mission, path: TargetPath, duration_s: float) -> Mission:
    """Return the mission with a simulated target that follows the path until `duration_s`, and stays there.

    The path is stored as straight `legs` of the mission, so that a log of the flight contains it. Raises InputError,
    also for a target above the maximum speed.
    """
    ticks = max(round(duration_s * mission.mission.rate_hz), 1)
    stride = ceil(ticks / PARTS_MAX)
    step_s = stride / mission.mission.rate_hz
    times_s = [index * step_s for index in range(ceil(ticks / stride) + 1)]
    points = [_point(path, time_s) for time_s in times_s]
    legs = [_leg(begin_s, *ends, step_s) for begin_s, ends in zip(times_s, pairwise(points), strict=False)]
    target = {"source": "simulated", "start_m": points[0], "velocity_m_s": (0.0, 0.0), "legs": legs, "rounds": 1}
    return mission.replace(target=target)


def _point(path: TargetPath, time_s: float) -> tuple[float, float]:
    x, y = finite_numbers(path(time_s), ("x_m", "y_m"), f"target: the path at {time_s:g} s")
    return x, y


def _leg(begin_s: float, from_m: tuple[float, float], to_m: tuple[float, float], step_s: float) -> dict[str, object]:
    speed_m_s = hypot(to_m[0] - from_m[0], to_m[1] - from_m[1]) / step_s
    if speed_m_s > TARGET_SPEED_MAX_M_S:
        most = f"targets move at {TARGET_SPEED_MAX_M_S:g} m/s at most"
        raise InputError([f"target: the path moves at {speed_m_s:.3g} m/s at {begin_s:g} s: {most}"])
    if speed_m_s == 0.0:
        return {"to_m": to_m, "speed_m_s": TARGET_SPEED_MAX_M_S, "pause_s": step_s}
    return {"to_m": to_m, "speed_m_s": speed_m_s}
