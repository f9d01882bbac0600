"""The reference that a vehicle follows on the ring: a place that moves by the spacing law, within bounds.

The law gives an angular rate. Applied directly, it would saturate the acceleration whenever a vehicle joins or
leaves. Instead it moves a reference within the bounds of a transition, and the LMPC keeps the vehicle on the reference.
The spacing errors are those of the places, which vehicles publish. The spacing loop therefore contains neither
noise nor the vehicles' dynamics, and its errors decay as in (20) while no bound is active.

On the ring, and on the waiting circle, the reference is at its place. A vehicle that comes in from farther out flies to
where its place will be: the place is behind the reference by as much as the ring turns until the vehicle comes to the
waiting circle, `w (r - r_waiting) / v` at its largest speed v. It flies straight in while its place turns with the
ring, and the others make room for it meanwhile.
"""

from collections.abc import Sequence
from math import inf, sqrt
from typing import Final

from agents.ring.commanded_ring import Orbit
from agents.ring.feasibility import RESERVE
from agents.ring.joining import WAITING
from agents.ring.transition import (
    TRACKED_SHARE,
    AccelerationBound,
    Mover,
    ShapedCoordinate,
    transition_of,
    transition_rate_rad_s,
)
from agents.settings.config import AgentConfig
from estimation.polar import Polar
from estimation.vectors import Pair, limited, wrap_signed_rad

_RADIAL_GAIN_PER_S: Final = 0.5
_BRAKED_WITHIN_M: Final = 0.25
_ACROSS_SHARE: Final = 0.7
"""The share of its speed that a vehicle may use towards the ring and around it, however fast it is in the other."""


class RingPoint:
    """The reference about the target at `time_s`: radius [m], bearing [rad], and the bearing [rad] of its place.

    Without a place it is there.
    """

    def __init__(
        self, radius: ShapedCoordinate, bearing: ShapedCoordinate, time_s: float, place: ShapedCoordinate | None = None
    ) -> None:
        self.radius: Final = radius
        self.bearing: Final = bearing
        self.time_s: Final = time_s
        self.place: Final = bearing if place is None else place

    def place_rad(self, at_s: float) -> float:
        """Return the bearing of the place at a time, extrapolated at its rate."""
        return self.place.value + self.place.rate * (at_s - self.time_s)


class RingWay:
    """The input of a reference: the orbit at `radius_m`, and the n vehicles that change places, its own first.

    The law's correction of the rate is computed anew for other `movers` than those of the way before.
    `acceleration` bounds its acceleration along the ring and across it. `rates_rad_s` are the least and the
    largest angular rate that keep the headway. `share` is that of the encirclement in the vehicle's aim. At the
    vehicle's bearing the ring is `bend_m` farther out than the reference. The vehicle `waits` while the guard changes
    its aims.
    """

    def __init__(
        self,
        orbit: Orbit,
        radius_m: float,
        movers: Sequence[Mover],
        acceleration: AccelerationBound,
        rates_rad_s: Pair = (-inf, inf),
        share: float = 1.0,
        bend_m: float = 0.0,
        waits: bool = False,
    ) -> None:
        self.orbit: Final = orbit
        self.radius_m: Final = radius_m
        self.movers: Final = movers
        self.acceleration: Final = acceleration
        self.rates_rad_s: Final = rates_rad_s
        self.share: Final = share
        self.bend_m: Final = bend_m
        self.waits: Final = waits


class RingReference:
    """Moves the reference of one vehicle. It starts with the vehicle's position and motion."""

    def __init__(self, config: AgentConfig) -> None:
        self._waiting_m = WAITING * config.safety.separation_m
        self._point: RingPoint | None = None
        self._corrected: Sequence[Mover] = ()
        self._correction_rad_s = 0.0
        self.change(config)

    def reset(self) -> None:
        """Restart, when the vehicle comes from another tactic or from far off the ring."""
        self._point = None

    def change(self, config: AgentConfig) -> None:
        """Move on the ring of another configuration from now on."""
        self._settings, self._transition = config.encirclement, transition_of(config.encirclement)
        self._corrected = ()

    def place_rad(self, polar: Polar, orbit: Orbit, at_s: float) -> float:
        """Return the bearing of the place at a time, before `advance`."""
        if self._point is not None:
            return self._point.place_rad(at_s)
        outside_m = self._outside_m(polar.radius_m, orbit)
        return polar.bearing_rad - self._turned_rad_m(outside_m, orbit) * outside_m

    def advance(self, polar: Polar, way: RingWay, at_s: float) -> RingPoint:
        """Return the reference at a time for a vehicle at `polar`.

        It is never farther from the vehicle than `reference_lead_max_m`: lag beyond that is dropped, not made up later.
        While the share of the encirclement is below 1, the vehicle's own motion has the remaining weight.
        """
        lead_max_m = self._settings.reference_lead_max_m
        before = self._point
        if before is None:
            radius = ShapedCoordinate(polar.radius_m, polar.radial_speed_m_s)
            bearing = ShapedCoordinate(polar.bearing_rad, polar.angular_rate_rad_s)
        else:
            radius, bearing = self._moved(before, way, at_s - before.time_s)
        # Without this the reference would run ahead of a waiting vehicle, and push it against the guard.
        along_max_m = 0.0 if way.waits else lead_max_m
        along_max_rad = along_max_m / max(polar.radius_m, self._settings.radius_min_m)
        near_rad = bearing.value - wrap_signed_rad(bearing.value - polar.bearing_rad)
        radius = radius.near(polar.radius_m - way.bend_m, polar.radial_speed_m_s, lead_max_m, way.share)
        bearing = bearing.near(near_rad, polar.angular_rate_rad_s, along_max_rad, way.share)
        outside_m, out_m_s = self._outside_m(radius.value, way.orbit), radius.rate - way.orbit.radius_rate_m_s
        turned_rad_m = self._turned_rad_m(outside_m, way.orbit)
        place = ShapedCoordinate(
            bearing.value - turned_rad_m * outside_m, bearing.rate - turned_rad_m * out_m_s, bearing.acceleration
        )
        self._point = RingPoint(radius, bearing, at_s, place)
        return self._point

    def _outside_m(self, radius_m: float, orbit: Orbit) -> float:
        """Return how far a radius is outside the waiting circle, on which a vehicle may have to stay."""
        return radius_m - orbit.radius_m - self._waiting_m

    def _turned_rad_m(self, outside_m: float, orbit: Orbit) -> float:
        """Return how far the ring turns while a vehicle that comes in flies a metre [rad/m]; 0 where it may wait."""
        return orbit.angular_rate_rad_s / self._settings.speed_max_m_s if outside_m > 0.0 else 0.0

    def _moved(self, before: RingPoint, way: RingWay, step_s: float) -> tuple[ShapedCoordinate, ShapedCoordinate]:
        settings, transition = self._settings, self._transition
        radius, bearing = before.radius, before.bearing
        if step_s <= 0.0:
            return radius, bearing
        size_m = max(radius.value, settings.radius_min_m)
        ring_rad_s, ring_m = way.orbit.angular_rate_rad_s, way.orbit.radius_m
        gentle_m_s2, missing_m = way.acceleration.at_m_s2(radius.value - ring_m), way.radius_m - radius.value
        # On its way to the ring a vehicle accelerates in two directions, and is briefly faster than its reference.
        fastest_m_s = settings.speed_max_m_s * (1.0 - (1.0 - RESERVE) * min(1.0, abs(missing_m)))
        towards_m_s = limited(
            _RADIAL_GAIN_PER_S * missing_m,
            min(fastest_m_s, way.acceleration.braked_m_s(radius.value - ring_m, way.radius_m - ring_m)),
        )
        turning_rad_s = self._turned_rad_m(self._outside_m(radius.value, way.orbit), way.orbit) * towards_m_s
        if way.movers is not self._corrected:
            self._corrected = way.movers
            self._correction_rad_s = transition_rate_rad_s(way.movers, ring_rad_s, transition.gain_per_s) - ring_rad_s
        rate_rad_s = turning_rad_s + ring_rad_s + self._correction_rad_s
        # Both may rise together: the one leaves the other the room for what it is to be, not only for what it is.
        around_m_s = max(abs(bearing.rate), min(abs(rate_rad_s), _ACROSS_SHARE * fastest_m_s / size_m)) * size_m
        speed_m_s = way.orbit.radius_rate_m_s + limited(towards_m_s, across_m_s(fastest_m_s, around_m_s))
        across_max_m_s = across_m_s(fastest_m_s, max(abs(radius.rate), abs(speed_m_s)))
        rate_rad_s = limited(rate_rad_s, across_max_m_s / size_m)
        rate_rad_s = min(max(rate_rad_s, way.rates_rad_s[0]), way.rates_rad_s[1])
        acceleration, jerk = self._bounds(_beyond(radius.rate, speed_m_s), gentle_m_s2, step_s)
        along_m_s = abs(bearing.rate - turning_rad_s - ring_rad_s) * size_m
        most_m_s = max(way.movers[0].ahead_max_rad_s, way.movers[0].back_max_rad_s) * size_m / TRACKED_SHARE
        turning, turning_jerk = self._bounds(along_m_s if along_m_s > most_m_s else 0.0, gentle_m_s2, step_s)
        return (
            radius.follow(speed_m_s, acceleration, jerk, step_s),
            bearing.follow(rate_rad_s, turning / size_m, turning_jerk / size_m, step_s),
        )

    def _bounds(self, too_fast_m_s: float, gentle_m_s2: float, step_s: float) -> tuple[float, float]:
        """Return the bounds on acceleration and jerk: a transition's, or larger ones for a vehicle that is too fast.

        A vehicle that begins to follow a fast target is too fast, and would fall behind with a transition's bounds. The
        acceleration brakes within `_BRAKED_WITHIN_M`, so it approaches that of a transition as the vehicle slows down.
        """
        settings = self._settings
        if too_fast_m_s == 0.0:
            return gentle_m_s2, self._transition.jerk_m_s3
        braking_m_s2 = min(too_fast_m_s**2 / (2.0 * _BRAKED_WITHIN_M), settings.acceleration_max_m_s2)
        more_m_s2 = max(0.0, braking_m_s2 - gentle_m_s2)
        return gentle_m_s2 + more_m_s2, self._transition.jerk_m_s3 + more_m_s2 / step_s


def across_m_s(speed_max_m_s: float, component_m_s: float) -> float:
    """Return the speed that one component of it, radial or along the ring, leaves for the other, at least a share."""
    left_m_s = sqrt(max(speed_max_m_s**2 - component_m_s**2, 0.0))
    return max(left_m_s, _ACROSS_SHARE * speed_max_m_s)


def _beyond(rate: float, wanted: float) -> float:
    """Return the excess of a rate over the wanted one: the whole rate if it has the wrong sign."""
    return abs(rate) if rate * wanted < 0.0 else max(0.0, abs(rate) - abs(wanted))
