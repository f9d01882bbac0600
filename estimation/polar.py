"""The polar state of a vehicle about a target: radius, bearing and their rates. Equations (3) to (7) of the paper."""

from math import atan2, cos, sin
from typing import Final

import numpy as np

from estimation.state import Vector
from estimation.vectors import length


class Polar:
    """A vehicle's motion about the target: radius and bearing, and their rates.

    The bearing is that of the vehicle from the target, counter-clockwise from x of the mission frame, in [-pi, pi]. The
    angular rate is positive counter-clockwise, the radial speed outwards. All are relative to the moving target.
    """

    def __init__(self, radius_m: float, bearing_rad: float, radial_speed_m_s: float, angular_rate_rad_s: float) -> None:
        self.radius_m: Final = radius_m
        self.bearing_rad: Final = bearing_rad
        self.radial_speed_m_s: Final = radial_speed_m_s
        self.angular_rate_rad_s: Final = angular_rate_rad_s


def polar_from_motion(motion: Vector, target: Vector) -> Polar:
    """Return the polar state of a motion (4,) = [x y x' y'] about another: the state of the polar plant - (3), (5).

    It is the upper half of (5); the lower half is in the feedback linearisation.

    At the centre, bearing and angular rate are 0.
    """
    x, y, x_rate, y_rate = motion.tolist()
    target_x, target_y, target_x_rate, target_y_rate = target.tolist()
    return polar_of(x - target_x, y - target_y, x_rate - target_x_rate, y_rate - target_y_rate)


def polar_of(x: float, y: float, x_rate: float, y_rate: float) -> Polar:
    """Return the polar state of a motion relative to the target - (6), (7)."""
    radius = length(x, y)
    squared = radius**2
    if squared == 0.0:
        return Polar(0.0, 0.0, length(x_rate, y_rate), 0.0)
    return Polar(radius, atan2(y, x), (x * x_rate + y * y_rate) / radius, (x * y_rate - y * x_rate) / squared)


def angular_rate_of(x: float, y: float, x_rate: float, y_rate: float) -> float:
    """Return the angular rate of `polar_of` alone."""
    squared = x * x + y * y
    return 0.0 if squared == 0.0 else (x * y_rate - y * x_rate) / squared


def motion_from_polar(polar: Polar, target: Vector) -> Vector:
    """Return the motion (4,) of a vehicle at polar coordinates about a moving target (4,) - (4a) to (4d)."""
    cosine, sine = cos(polar.bearing_rad), sin(polar.bearing_rad)
    tangential = polar.radius_m * polar.angular_rate_rad_s
    relative = (
        polar.radius_m * cosine,
        polar.radius_m * sine,
        polar.radial_speed_m_s * cosine - tangential * sine,
        polar.radial_speed_m_s * sine + tangential * cosine,
    )
    return np.asarray(target + np.array(relative), dtype=np.float64)
