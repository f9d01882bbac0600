"""Polar coordinates about the target, and the feedback linearisation that makes them double integrators.

They describe the motion relative to the target, and so include the target's velocity (docs/notes/paper.md).
"""

from math import cos, sin

import numpy as np

from estimation.plant.model import Plant
from estimation.polar import Polar
from estimation.state import Vector
from estimation.vectors import Pair


def aim_for(motion: Vector, polar: Polar, acceleration: Pair, disturbance_m_s2: Vector, plant: Plant) -> Vector:
    """Return the aim (2,) that gives the plant the polar acceleration (r'', phi'') - (3), (5), (11)."""
    radial, angular = acceleration
    cosine, sine = cos(polar.bearing_rad), sin(polar.bearing_rad)
    outward = radial - polar.radius_m * polar.angular_rate_rad_s**2
    sideways = polar.radius_m * angular + 2.0 * polar.radial_speed_m_s * polar.angular_rate_rad_s
    wanted = outward * cosine - sideways * sine, outward * sine + sideways * cosine
    return aim_for_acceleration(motion, wanted, disturbance_m_s2, plant)


def aim_for_acceleration(motion: Vector, acceleration_m_s2: Pair, disturbance_m_s2: Vector, plant: Plant) -> Vector:
    """Solve the plant for its input: return the aim (2,) under which it has the given acceleration."""
    x, y, x_rate, y_rate = motion.tolist()
    w_x, w_y = disturbance_m_s2.tolist()
    x_wanted, y_wanted = acceleration_m_s2
    effort_x = x_wanted + plant.x.a1_per_s * x_rate - w_x
    effort_y = y_wanted + plant.y.a1_per_s * y_rate - w_y
    return np.array((x + effort_x / plant.x.a0_per_s2, y + effort_y / plant.y.a0_per_s2))
