"""How vehicles change places on the ring: by the law (22), within the bounds of a transition."""

from collections.abc import Sequence
from math import ceil, copysign, sqrt
from typing import Final

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


_ACCELERATION_PER_S2: Final = 0.03
_JERK_PER_S3: Final = 0.05
"""The bounds of a transition as shares of the radius: vehicles change places in about the same time on any ring."""
_SMALL_M: Final = 10.0
_LARGE_M: Final = 20.0
"""The radii beyond which the bounds stay the same: smaller ones are below disturbances, larger ones are not gentle."""
SLOWEST_SHARE: Final = 0.2
"""The smallest angular rate of a vehicle that waits for others, as a share of the ring's rate."""
TRACKED_SHARE: Final = 0.98
"""The share of a transition's speed that references use: a vehicle is briefly a little faster than its reference."""
_TRIES: Final = 16
_NEARLY: Final = 1e-12
_DAMPED_SHARE: Final = 0.8
_BRAKING_SHARE: Final = 0.5
"""The share of the acceleration that the braking distance is computed with; the rest is a margin for disturbances."""


class Transition:
    """The bounds of a transition - speed relative to the ring, acceleration, jerk - and the spacing gain gamma."""

    def __init__(self, speed_m_s: float, acceleration_m_s2: float, jerk_m_s3: float, gain_per_s: float) -> None:
        self.speed_m_s: Final = speed_m_s
        self.acceleration_m_s2: Final = acceleration_m_s2
        self.jerk_m_s3: Final = jerk_m_s3
        self.gain_per_s: Final = gain_per_s

    @property
    def damped_gain_per_s(self) -> float:
        """The largest gamma with which references follow the law without an overshoot of more than 5 %.

        The law asks a reference of speed v to brake with gamma v. At a jerk j its rate is then (gamma v)²/(2 j) behind
        the wanted one, which it can catch up with from an error of up to j/(2 gamma³). Larger errors than a/gamma² are
        approached more slowly than the law asks, by the bound a on the acceleration. With gamma = j/(2 a) both are the
        same; a larger one overshoots. In simulations that is an overshoot of 13 %, and 0.8 of it one of 4 %.
        """
        return _DAMPED_SHARE * self.jerk_m_s3 / (2.0 * self.acceleration_m_s2)


def transition_of(settings: EncirclementSettings) -> Transition:
    """Return the transition of the settings."""
    size_m = min(max(settings.radius_m, _SMALL_M), _LARGE_M)
    if settings.spacing_acceleration_max_m_s2 is not None:
        size_m = settings.spacing_acceleration_max_m_s2 / _ACCELERATION_PER_S2  # the jerk follows from it
    acceleration_m_s2 = min(_ACCELERATION_PER_S2 * size_m, settings.acceleration_max_m_s2)
    return Transition(
        settings.transition_speed_m_s, acceleration_m_s2, _JERK_PER_S3 * size_m, settings.spacing_gain_per_s
    )


class AccelerationBound:
    """The bound on a vehicle's acceleration, in any direction: a transition's at the ring, its own far outside.

    From `near_m` outside the ring on it grows with the distance, up to `most_m_s2` and not below `gentle_m_s2`.
    """

    def __init__(self, near_m: float, gentle_m_s2: float, most_m_s2: float) -> None:
        self.near_m: Final = near_m
        self.gentle_m_s2: Final = gentle_m_s2
        self.most_m_s2: Final = max(gentle_m_s2, most_m_s2)
        self.far_m: Final = near_m * self.most_m_s2 / gentle_m_s2

    def at_m_s2(self, outside_m: float) -> float:
        """Return the bound at a distance outside the ring."""
        return max(self.gentle_m_s2, min(self.gentle_m_s2 * outside_m / self.near_m, self.most_m_s2))

    def braked_m_s(self, from_m: float, to_m: float) -> float:
        """Return the largest radial speed that a share of the bound can brake between two distances outside."""
        return sqrt(2.0 * _BRAKING_SHARE * abs(self._integral(from_m) - self._integral(to_m)))

    def _integral(self, outside_m: float) -> float:
        """Return the integral of the bound from the ring to a distance outside it, negative inside it [m²/s²]."""
        near_m, far_m = self.near_m, self.far_m
        if outside_m <= near_m:
            return self.gentle_m_s2 * outside_m
        growing_m = min(outside_m, far_m)
        grown = self.gentle_m_s2 * (near_m + (growing_m * growing_m - near_m * near_m) / (2.0 * near_m))
        return grown + self.most_m_s2 * (outside_m - growing_m)


class Mover:
    """A vehicle that changes its place: how far it is from it, and the bounds of its motion relative to the ring."""

    def __init__(
        self, error_rad: float, ahead_max_rad_s: float, back_max_rad_s: float, acceleration_max_rad_s2: float
    ) -> None:
        self.error_rad: Final = error_rad
        self.ahead_max_rad_s: Final = ahead_max_rad_s
        self.back_max_rad_s: Final = back_max_rad_s
        self.acceleration_max_rad_s2: Final = acceleration_max_rad_s2


def transition_rate_rad_s(movers: Sequence[Mover], ring_rad_s: float, gain_per_s: float) -> float:
    """Return the rate [rad/s] of the first of all vehicles on a ring of rate `ring_rad_s` - (21), (22).

    It is `w_i = w_D + gamma e_i` as long as no bound is active. With `place_errors_rad` this is the one solution of
    (19) and (21) for n vehicles: every spacing error decays at gamma, and the mean rate is the ring's. For n = 3 it is
    (22). A bound on one vehicle scales the corrections of all by the same share, so that the errors decay in proportion
    and no spacing overshoots. If a vehicle cannot wait as long as that, all fly faster by the same amount. Every
    vehicle computes the share from the same messages, so no other is needed.
    """
    forwards_per_s = copysign(gain_per_s, ring_rad_s)
    wanted = [(forwards_per_s * each.error_rad, each) for each in movers]
    share = 1.0
    for rate, each in wanted:
        braked = braked_rate(each.error_rad, each.acceleration_max_rad_s2)
        if share * abs(rate) > braked:
            share = braked / abs(rate)
    for _ in range(_TRIES):
        # All rates `share * wanted + common` are to be within their bounds: `common` lies between two, or the share of
        # the two that contradict each other is too large.
        least, slowest = max((-each.back_max_rad_s - share * rate, -rate) for rate, each in wanted)
        most, fastest = max((share * rate - each.ahead_max_rad_s, rate) for rate, each in wanted)
        if not (least + most > _NEARLY and fastest + slowest > 0.0):  # also ends with a bearing that is not a number
            break
        share -= (least + most) / (fastest + slowest)
    common = max(0.0, least) - max(0.0, most)
    return ring_rad_s + copysign(1.0, ring_rad_s) * (share * wanted[0][0] + common)


def braked_rate(missing: float, acceleration_max: float) -> float:
    """Return the largest rate from which a coordinate can be braked within the `missing` distance."""
    return sqrt(2.0 * _BRAKING_SHARE * acceleration_max * abs(missing))
