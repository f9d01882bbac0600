"""Polar coordinates about the target, and the feedback linearisation that makes them double integrators.

Equations (3)-(5) and (11), (12) with the target's own velocity included (mathematics.md sections 3 and 4).
"""

from math import atan2, cos, hypot, sin

import msgspec
import numpy as np

from estimation.plant import Plant
from estimation.state import Vector


class Polar(msgspec.Struct, frozen=True):
    """A vehicle's motion about the target: radius and bearing, and their rates."""

    radius_m: float
    bearing_rad: float
    radial_speed_m_s: float
    angular_rate_rad_s: float


def polar_from_motion(motion: Vector, target: Vector) -> Polar:
    """Return (4) inverted, and the upper half of (5): both motions are (4,) = [x y x' y'].

    At the centre itself the bearing is taken as zero and the angular rate as none.
    """
    x, y, x_rate, y_rate = (motion - target).tolist()
    radius = hypot(x, y)
    if radius**2 == 0.0:
        return Polar(0.0, 0.0, hypot(x_rate, y_rate), 0.0)
    return Polar(
        radius,
        atan2(y, x),
        (x * x_rate + y * y_rate) / radius,
        (x * y_rate - y * x_rate) / radius**2,
    )


def motion_from_polar(polar: Polar, target: Vector) -> Vector:
    """Return (4a)-(4d): the motion (4,) of a vehicle at polar coordinates about a moving target (4,)."""
    cosine, sine = cos(polar.bearing_rad), sin(polar.bearing_rad)
    tangential = polar.radius_m * polar.angular_rate_rad_s
    relative = (
        polar.radius_m * cosine,
        polar.radius_m * sine,
        polar.radial_speed_m_s * cosine - tangential * sine,
        polar.radial_speed_m_s * sine + tangential * cosine,
    )
    return np.asarray(target + np.array(relative), dtype=np.float64)


def setpoint_for(motion: Vector, polar: Polar, acceleration: Vector, disturbance_m_s2: Vector, plant: Plant) -> Vector:
    """Return the setpoint (2,) that gives the plant the polar acceleration (r'', phi'') - (11), (12)."""
    radial, angular = acceleration.tolist()
    cosine, sine = cos(polar.bearing_rad), sin(polar.bearing_rad)
    outward = radial - polar.radius_m * polar.angular_rate_rad_s**2
    sideways = polar.radius_m * angular + 2.0 * polar.radial_speed_m_s * polar.angular_rate_rad_s
    wanted = outward * cosine - sideways * sine, outward * sine + sideways * cosine
    return setpoint_for_acceleration(motion, wanted, disturbance_m_s2, plant)


def setpoint_for_acceleration(
    motion: Vector, acceleration_m_s2: tuple[float, float], disturbance_m_s2: Vector, plant: Plant
) -> Vector:
    """Solve the plant for its input: the setpoint (2,) under which it accelerates as wished - X_d of section 4."""
    x, y, x_rate, y_rate = motion.tolist()
    w_x, w_y = disturbance_m_s2.tolist()
    x_wanted, y_wanted = acceleration_m_s2
    effort_x = x_wanted + plant.x.a1_per_s * x_rate - w_x
    effort_y = y_wanted + plant.y.a1_per_s * y_rate - w_y
    return np.array((x + effort_x / plant.x.a0_per_s2, y + effort_y / plant.y.a0_per_s2))
