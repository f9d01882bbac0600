"""The ring that operators command in flight: whether a vehicle can fly it, and the way to it from the present ring."""

from math import ceil, degrees, inf, radians, sqrt
from typing import Final

import msgspec

from agents.ring.heights import HEIGHT_LEAST_M, HEIGHT_MOST_M, altitude_refusal, tilt_refusal
from agents.ring.place import chord_m, even_places, weights_of
from agents.ring.transition import TRACKED_SHARE, ShapedCoordinate, braked_rate, transition_of
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from agents.team.messages import CommandedRing
from estimation.vectors import limited

_RADIUS_GAIN_PER_S: Final = 0.6
_SPEED_GAIN_PER_S: Final = 1.0
"""With more the radius goes beyond the commanded one, by 0.16 m at 1 1/s: the jerk delays the braking."""
_SHARE: Final = 0.8
"""The share of a transition's acceleration and jerk with which the ring changes: vehicles that follow have the rest."""
_REACHED_M: Final = 0.02
_REACHED_M_S: Final = 0.01
_STEP_S: Final = 0.05
_LONGEST_S: Final = 600.0
_PART_MAX_S: Final = 0.25
_BUILT_UP_S: Final = 0.5
"""How long the jerk takes to its bound as the speed along the ring changes."""


class Orbit:
    """The flown ring: radius, angular rate, and the rate at which its radius changes."""

    def __init__(self, radius_m: float, angular_rate_rad_s: float, radius_rate_m_s: float = 0.0) -> None:
        self.radius_m: Final = radius_m
        self.angular_rate_rad_s: Final = angular_rate_rad_s
        self.radius_rate_m_s: Final = radius_rate_m_s


class ChangingRing:
    """The ring of the settings, or one on its way to it, which every vehicle computes alike.

    Radius and speed along the ring change within the bounds of a transition. The rate is their quotient, so no
    ring between two is faster than both, and a reversal passes through a ring at rest. The acceleration towards the
    target stays below the larger one of the two rings.
    """

    def __init__(self, settings: EncirclementSettings) -> None:
        self.settings = settings
        self._transition = transition_of(settings)
        self._radius = self._speed = ShapedCoordinate(0.0, 0.0)
        self.arrive()

    @property
    def changes(self) -> bool:
        """Whether the ring is still on its way."""
        return self._radius.value != self.settings.radius_m or self._speed.value != self._wanted_m_s

    def change(self, settings: EncirclementSettings) -> None:
        """Begin the way to the ring of other settings."""
        self.settings, self._transition = settings, transition_of(settings)

    def arrive(self) -> None:
        """End the way at once: a vehicle that is not on the ring does not change with it."""
        self._radius = ShapedCoordinate(self.settings.radius_m, 0.0)
        self._speed = ShapedCoordinate(self._wanted_m_s, 0.0)

    def advance(self, step_s: float) -> None:
        """Move by a time step: a long one, after a pause of the vehicle's ticks, in parts."""
        parts = max(1, ceil(step_s / _PART_MAX_S))
        for _ in range(parts):
            if self.changes:
                self._advance(step_s / parts)

    def _advance(self, step_s: float) -> None:
        bounds, radius, speed = self._transition, self._radius, self._speed
        acceleration_m_s2, jerk_m_s3 = _SHARE * bounds.acceleration_m_s2, _SHARE * bounds.jerk_m_s3
        missing_m = self.settings.radius_m - radius.value
        fastest_m_s = min(TRACKED_SHARE * bounds.speed_m_s, braked_rate(missing_m, acceleration_m_s2))
        radius = radius.follow(
            limited(_RADIUS_GAIN_PER_S * missing_m, fastest_m_s), acceleration_m_s2, jerk_m_s3, step_s
        )
        inwards_m_s2 = max(self._wanted_m_s**2 / self.settings.radius_m, speed.value**2 / radius.value)
        missing_m_s = limited(self._wanted_m_s, sqrt(inwards_m_s2 * radius.value)) - speed.value
        wanted_m_s2 = limited(_SPEED_GAIN_PER_S * missing_m_s, acceleration_m_s2)
        speed = speed.follow(wanted_m_s2, jerk_m_s3, jerk_m_s3 / _BUILT_UP_S, step_s)
        self._radius, self._speed = radius, speed
        rests = abs(missing_m) < _REACHED_M and abs(radius.rate) < _REACHED_M_S
        if rests and abs(self._wanted_m_s - speed.value) < _REACHED_M_S:
            self.arrive()

    def orbit(self, radius_share: float, rate_share: float) -> Orbit:
        """Return the ring with shares of its radius and rate."""
        if not self.changes:
            radius_m, rate_rad_s = self.settings.radius_m, self.settings.angular_rate_rad_s
        else:
            radius_m, rate_rad_s = self._radius.value, self._speed.value / self._radius.value
        return Orbit(radius_share * radius_m, rate_share * rate_rad_s, radius_share * self._radius.rate)

    @property
    def _wanted_m_s(self) -> float:
        return self.settings.angular_rate_rad_s * self.settings.radius_m


def change_s(before: EncirclementSettings, after: EncirclementSettings, flying_m: float = 0.0) -> float:
    """Return how long the ring takes from rest at one to another, and the vehicles to its heights.

    `flying_m` is the flying height of the lowest vehicle, at which a ring without an altitude is.
    """
    ring, steps = ChangingRing(before), 0
    ring.change(after)
    while ring.changes and steps * _STEP_S < _LONGEST_S:
        ring.advance(_STEP_S)
        steps += 1
    raised_m = abs(after.lowest_m(flying_m) - before.lowest_m(flying_m))
    climbs_m = raised_m + before.rise_m + after.rise_m if before.tilt_deg != after.tilt_deg else raised_m
    return max(steps * _STEP_S, climbs_m / after.climb_max_m_s)


class RingBounds(msgspec.Struct, frozen=True):
    """What a ring keeps: radius, speed along it, acceleration towards the target, altitude and climb rate.

    The radius is between the two, and not equal to one. The altitude is that of the lowest vehicle, and that of all its
    points if the ring is inclined.
    """

    radius_min_m: float
    radius_max_m: float
    speed_max_m_s: float
    acceleration_max_m_s2: float
    altitude_min_m: float
    altitude_max_m: float
    climb_max_m_s: float

    def rate_max_rad_s(self, radius_m: float) -> float:
        """Return the largest angular rate at a radius."""
        return min(self.speed_max_m_s / radius_m, sqrt(self.acceleration_max_m_s2 / radius_m))


def ring_bounds(config: AgentConfig) -> RingBounds:
    """Return the bounds of the rings that a vehicle can fly about a target at rest, with room for its whole team."""
    ring, safety = config.encirclement, config.safety
    low_m, high_m = config.lowest_between_m
    return RingBounds(
        max(ring.radius_min_m, safety.keep_out_m, _least_m(config)),
        ring.far_m,
        min(ring.speed_max_m_s, safety.speed_max_m_s),
        min(ring.acceleration_max_m_s2, safety.acceleration_max_m_s2),
        HEIGHT_LEAST_M if low_m is None else max(low_m, HEIGHT_LEAST_M),
        HEIGHT_MOST_M if high_m is None else min(high_m, HEIGHT_MOST_M),
        ring.climb_max_m_s,
    )


def ring_refusal(config: AgentConfig, reach_m: float) -> str:
    """Return why a vehicle cannot fly the ring of its configuration, with the nearest that it could; empty if it can.

    `reach_m` is the distance from the target to the fence, infinite if that is not known. What radios and sensors allow
    is not asked here, but by the checks of missions (`gcs/mission/cross_checks.py`).
    """
    ring, bounds, turns_deg_s = config.encirclement, ring_bounds(config), config.safety.yaw_rate_max_deg_s
    radius_m, rate_rad_s = ring.radius_m, abs(ring.angular_rate_rad_s)
    if radius_m <= bounds.radius_min_m:
        return f"a ring of {radius_m:g} m has no room for the team: more than {bounds.radius_min_m:.1f} m is needed"
    if radius_m >= bounds.radius_max_m:
        return f"a ring of {radius_m:g} m is beyond its law's reach: less than {bounds.radius_max_m:g} m is possible"
    if rate_rad_s > (most_rad_s := bounds.rate_max_rad_s(radius_m)):
        return f"{rate_rad_s:g} rad/s at {radius_m:g} m is faster than it may fly: at most {most_rad_s:.3f} rad/s"
    if ring.yaw == "target" and degrees(rate_rad_s) > turns_deg_s:
        return f"its nose cannot follow {rate_rad_s:g} rad/s: at most {turns_deg_s:g} degrees/s"
    if radius_m > reach_m:
        return f"a ring of {radius_m:g} m leaves the fence: at most {max(reach_m, 0.0):.1f} m about the target"
    return _heights_refusal(config)


def impossible_value(config: AgentConfig, commanded: CommandedRing) -> str:
    """Return which commanded value no ring of a vehicle could have, whatever its other values; empty if there is none.

    No vehicle with such limits has taken a command of such a value: a peer that publishes it has made it up.
    """
    bounds, turns_deg_s = ring_bounds(config), config.safety.yaw_rate_max_deg_s
    radius_m, rate_rad_s, altitude_m = commanded.radius_m, commanded.angular_rate_rad_s, commanded.altitude_m
    if radius_m is not None and not bounds.radius_min_m < radius_m < bounds.radius_max_m:
        return f"no ring of {radius_m:g} m is possible: {bounds.radius_min_m:.1f} to {bounds.radius_max_m:g} m are"
    if rate_rad_s is not None:
        most_rad_s = bounds.rate_max_rad_s(bounds.radius_min_m) if bounds.radius_min_m > 0.0 else inf
        if config.encirclement.yaw == "target":
            most_rad_s = min(most_rad_s, radians(turns_deg_s))
        if abs(rate_rad_s) > most_rad_s:
            return f"no ring of {rate_rad_s:g} rad/s is possible: at most {most_rad_s:.3f} rad/s are"
    if altitude_m is not None and not bounds.altitude_min_m <= altitude_m <= bounds.altitude_max_m:
        low_m, high_m = bounds.altitude_min_m, bounds.altitude_max_m
        return f"no ring at an altitude of {altitude_m:g} m is possible: {low_m:g} to {high_m:g} m are"
    return ""


def circles_apart_m(radius_m: float, other_m: float, centres_m: float) -> float:
    """Return the distance of two circles whose centres are so far apart; 0 if they meet."""
    return max(centres_m - (radius_m + other_m), abs(radius_m - other_m) - centres_m, 0.0)


def _heights_refusal(config: AgentConfig) -> str:
    ring, between_m = config.encirclement, config.lowest_between_m
    if refusal := tilt_refusal(ring, between_m):
        return f"a tilt of {refusal}"
    refusal = altitude_refusal(ring, config.lowest_m, between_m)
    return f"an altitude of {refusal}" if refusal else ""


def _least_m(config: AgentConfig) -> float:
    """Return the radius at which the whole team is a separation apart."""
    if config.places < 2:
        return 0.0
    weights = weights_of(config.slots, config.gaps)
    if config.places < len(weights):  # any of them may be on the ring: the narrowest gap among the widest is smallest
        least, *others = sorted(weights)
        weights = [least, *others[1 - config.places :]]
    return config.safety.separation_m / chord_m(1.0, even_places(weights))
