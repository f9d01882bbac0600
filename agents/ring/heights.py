"""The heights of vehicles on the ring: its altitude, and its tilt.

Seen from above an inclined ring is a circle as any other: the height follows from the bearing, `z = z_0 + r tan(tilt)
cos(bearing - highest)`, for vehicles outside the ring with its radius. Vehicles that are near each other therefore fly
at about the same height, and the guard, which keeps them apart horizontally, needs no other rule.
"""

from math import atan2, cos, degrees, radians, sin, tan
from typing import Final

from agents.settings.sections import EncirclementSettings
from estimation.polar import Polar
from estimation.vectors import Pair

Limits = tuple[float | None, float | None]
HEIGHT_LEAST_M: Final = 1.0
HEIGHT_MOST_M: Final = 500.0
"""The limits of heights above the mission's origin where none are given, as those of `altitude_m`."""


def inclined_m(ring: EncirclementSettings, polar: Polar) -> Pair:
    """Return how far an inclined ring is above its centre [m] where a vehicle is, and its climb rate there [m/s]."""
    if ring.tilt_deg == 0.0:
        return 0.0, 0.0
    rise_m = min(polar.radius_m, ring.radius_m) * tan(radians(ring.tilt_deg))
    from_highest_rad = polar.bearing_rad - radians(ring.tilt_bearing_deg)
    return rise_m * cos(from_highest_rad), -rise_m * sin(from_highest_rad) * polar.angular_rate_rad_s


def tilt_refusal(ring: EncirclementSettings, between_m: Limits) -> str:
    """Return why vehicles cannot fly at the tilt of a ring, with the largest that they could; empty if they can.

    `between_m` are the limits of the lowest vehicle's altitude, None for none, which keep every vehicle inside its own.
    """
    if ring.tilt_deg == 0.0:
        return ""
    (low_m, high_m), rate_rad_s, tilted = _given(between_m), abs(ring.angular_rate_rad_s), f"{ring.tilt_deg:g} degrees"
    if (climb_m_s := ring.rise_m * rate_rad_s) > ring.climb_max_m_s:
        most_deg = _tilt_deg(ring.climb_max_m_s / rate_rad_s, ring.radius_m)
        return f"{tilted} takes climbs of {climb_m_s:.2f} m/s, {ring.climb_max_m_s:g} at most: up to {most_deg:.1f}"
    if 2.0 * ring.rise_m > high_m - low_m:
        most_deg = _tilt_deg((high_m - low_m) / 2.0, ring.radius_m)
        return f"{tilted} takes {2.0 * ring.rise_m:.1f} m between the altitude limits: up to {most_deg:.1f} fit"
    return ""


def altitude_refusal(ring: EncirclementSettings, lowest_m: float, between_m: Limits) -> str:
    """Return why the lowest vehicle cannot be at the altitude of a ring, with the nearest; empty if it can.

    `lowest_m` is its flying height, `between_m` as for the tilt, which has to fit between the limits.
    """
    if not ring.has_heights:
        return ""
    if ring.altitude == "target":  # its limits stop the team as a whole
        return "" if ring.altitude_m is None else f"{ring.altitude_m:g} m: the ring follows the target's altitude"
    (low_m, high_m), altitude_m = _given(between_m), ring.lowest_m(lowest_m)
    nearest_m = min(max(altitude_m, low_m + ring.rise_m), high_m - ring.rise_m)
    if altitude_m == nearest_m:
        return ""
    return f"{altitude_m:g} m takes vehicles beyond their altitude limits: the nearest is {nearest_m:.1f} m"


def _given(between_m: Limits) -> Pair:
    low_m, high_m = between_m
    return HEIGHT_LEAST_M if low_m is None else low_m, HEIGHT_MOST_M if high_m is None else high_m


def _tilt_deg(rise_m: float, radius_m: float) -> float:
    return degrees(atan2(max(rise_m, 0.0), radius_m))
