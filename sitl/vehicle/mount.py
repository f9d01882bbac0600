"""The simulated mount of a camera: a stabilised gimbal of two axes with bounded rates and a bounded pitch.

Angles are those of the camera towards the earth, as a stabilised gimbal keeps them: elevation above the horizontal and
heading clockwise from north.
"""

from math import pi, radians

from estimation.vectors import wrap_signed_rad

ELEVATION_MIN_RAD, ELEVATION_MAX_RAD = -pi / 2.0, radians(20.0)
RATE_MAX_RAD_S = radians(90.0)


class Mount:
    """A mount that looks ahead, along the vehicle's nose, until it is sent a direction."""

    def __init__(self) -> None:
        self.elevation_rad = 0.0
        self.heading_rad = 0.0
        self.stuck = False
        self._wanted_rad: tuple[float, float] | None = None

    def point(self, elevation_rad: float, heading_rad: float) -> None:
        """Turn towards a direction, as far as the mount's range allows, and keep it."""
        elevation_rad = min(max(elevation_rad, ELEVATION_MIN_RAD), ELEVATION_MAX_RAD)
        self._wanted_rad = elevation_rad, heading_rad

    def step(self, duration_s: float, nose_rad: float) -> None:
        """Move for a time; the vehicle's nose points along a heading."""
        if self.stuck:
            return
        elevation_rad, heading_rad = self._wanted_rad or (0.0, nose_rad)
        longest_rad = RATE_MAX_RAD_S * duration_s
        self.elevation_rad += _bounded(elevation_rad - self.elevation_rad, longest_rad)
        turn_rad = _bounded(wrap_signed_rad(heading_rad - self.heading_rad), longest_rad)
        self.heading_rad = wrap_signed_rad(self.heading_rad + turn_rad)


def _bounded(value: float, most: float) -> float:
    return min(max(value, -most), most)
