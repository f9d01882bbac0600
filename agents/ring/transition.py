"""How vehicles change places on the ring: by the law (22), within the bounds of a transition."""

from collections.abc import Sequence
from math import ceil, copysign, sqrt
from typing import Final

import msgspec

from agents.ring.feasibility import Orbit
from agents.settings.sections import EncirclementSettings
from estimation.vectors import limited


class ShapedCoordinate:
    """A value, its rate and its acceleration, in the value's unit, per second and per second squared."""

    def __init__(self, value: float, rate: float, acceleration: float = 0.0) -> None:
        self.value: Final = value
        self.rate: Final = rate
        self.acceleration: Final = acceleration

    def follow(self, rate_wanted: float, acceleration_max: float, jerk_max: float, step_s: float) -> "ShapedCoordinate":
        """Return the coordinate a step later, its rate moved towards the one wanted."""
        missing, change_max = rate_wanted - self.rate, jerk_max * step_s
        # The largest acceleration that the jerk can end in whole steps as the rate is reached: a + (a - c) + ... = due.
        due = abs(missing) / step_s
        steps = max(1, ceil((sqrt(1.0 + 8.0 * due / change_max) - 1.0) / 2.0))
        endable = due / steps + change_max * (steps - 1) / 2.0
        wanted = copysign(min(acceleration_max, endable), missing)
        # Braking beyond the bounds ends at once: reducing it by the jerk would overshoot.
        before = limited(self.acceleration, acceleration_max)
        acceleration = before + limited(wanted - before, change_max)
        rate = self.rate + acceleration * step_s
        return ShapedCoordinate(self.value + (self.rate + rate) / 2.0 * step_s, rate, acceleration)

    def near(self, value: float, rate: float, off_max: float, share: float) -> "ShapedCoordinate":
        """Return the coordinate within `off_max` of a value, with its offsets from value and rate scaled by `share`."""
        off = limited(self.value - value, off_max)
        return ShapedCoordinate(value + share * off, rate + share * (self.rate - rate), self.acceleration)


ACCELERATION_MAX_M_S2, JERK_MAX_M_S3 = 0.3, 0.5
SLOWEST_SHARE = 0.2
"""The smallest angular rate of a vehicle that waits for others, as a share of the ring's rate."""
TRACKED_SHARE = 0.98
"""The share of a transition's speed that references use: a vehicle is briefly a little faster than its reference."""
_BRAKING_SHARE = 0.5
"""The share of the acceleration that the braking distance is computed with; the rest is a margin for disturbances."""


class Transition(msgspec.Struct, frozen=True):
    """The bounds of a transition - speed relative to the ring, acceleration - and the spacing gain gamma."""

    speed_m_s: float
    acceleration_m_s2: float
    gain_per_s: float


def transition_of(settings: EncirclementSettings) -> Transition:
    """Return the transition of the settings."""
    acceleration_m_s2 = min(ACCELERATION_MAX_M_S2, settings.acceleration_max_m_s2)
    return Transition(settings.transition_speed_m_s, acceleration_m_s2, settings.spacing_gain_per_s)


def transition_rate_rad_s(errors_rad: Sequence[float], orbit: Orbit, transition: Transition) -> float:
    """Return the rate of the first vehicle on a ring whose vehicles are `errors_rad` (n,) off places - (21), (22).

    It is `w_i = w_D + gamma e_i` [rad/s] as long as no bound is active. With `place_errors_rad` this is the one
    solution of (19) and (21) for n vehicles: every spacing error decays at gamma, and the mean rate is the ring's. For
    n = 3 it is (22). A bound on one vehicle scales the corrections of all by the same share, so that the errors decay
    in proportion and no spacing overshoots. If the ring is too slow for a vehicle to wait, all fly faster by the same
    amount. Every vehicle computes the share from the same bearings, so no message is needed.
    """
    ring_rad_s, gain_per_s = orbit.angular_rate_rad_s, transition.gain_per_s
    furthest_rad = max(map(abs, errors_rad))
    if furthest_rad * gain_per_s == 0.0:
        return ring_rad_s
    fastest_rad_s = TRACKED_SHARE * transition.speed_m_s / orbit.radius_m
    slowest_rad_s = fastest_rad_s if ring_rad_s == 0.0 else min(fastest_rad_s, (1.0 - SLOWEST_SHARE) * abs(ring_rad_s))
    forwards_per_s = copysign(gain_per_s, ring_rad_s)
    forwards = [forwards_per_s * error_rad for error_rad in errors_rad]
    least, most = min(forwards), max(forwards)
    share = min(
        1.0,
        (fastest_rad_s + slowest_rad_s) / (most - least),
        braked_rate(furthest_rad, transition.acceleration_m_s2 / orbit.radius_m) / (gain_per_s * furthest_rad),
    )
    common = max(0.0, -slowest_rad_s - share * least) - max(0.0, share * most - fastest_rad_s)
    return ring_rad_s + copysign(1.0, ring_rad_s) * (share * forwards[0] + common)


def braked_rate(missing: float, acceleration_max: float) -> float:
    """Return the largest rate from which a coordinate can be braked within the `missing` distance."""
    return sqrt(2.0 * _BRAKING_SHARE * acceleration_max * abs(missing))
