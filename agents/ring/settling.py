"""How long vehicles take to settle on the ring: the law and the bounds of a transition, without plants and noise."""

from collections.abc import Collection, Mapping
from math import inf, tau
from typing import Final

from agents.ring.commanded_ring import Orbit
from agents.ring.joining import Joining
from agents.ring.place import place_errors_rad, ring_place, weights_of
from agents.ring.reference import RingReference, RingWay
from agents.settings.config import AgentConfig
from estimation.polar import Polar

_STEP_S: Final = 0.2
_LONGEST_S: Final = 300.0


class _OnReference:
    """A vehicle that keeps its motion until some time after the engagement, and then flies exactly on its reference."""

    def __init__(self, config: AgentConfig, engaged: Polar, from_s: float) -> None:
        self.polar = self._engaged = engaged
        self._from_s, self._radius_min_m = from_s, config.encirclement.radius_min_m
        self.joining = Joining(config)
        self.joining.look(engaged, 1.0)
        self._reference = RingReference(config)

    def place_rad(self, orbit: Orbit, at_s: float) -> float:
        """Return the bearing of its place at a time."""
        return self._reference.place_rad(self.polar, orbit, at_s)

    def advance(self, way: RingWay, at_s: float) -> None:
        """Move to a time."""
        before = self._engaged
        if at_s < self._from_s:
            radius_m = max(before.radius_m + at_s * before.radial_speed_m_s, self._radius_min_m)
            bearing_rad = before.bearing_rad + at_s * before.angular_rate_rad_s
            self.polar = Polar(radius_m, bearing_rad, before.radial_speed_m_s, before.angular_rate_rad_s)
            return
        point = self._reference.advance(self.polar, way, at_s)
        self.polar = Polar(point.radius.value, point.bearing.value, point.radius.rate, point.bearing.rate)


def settling_s(
    config: AgentConfig,
    engaged: Mapping[int, Polar],
    radius_share: float,
    spacing_rad: float,
    on_ring: Collection[int] = (),
) -> float:
    """Return the time from an engagement until n vehicles are settled: radii and spacings within the tolerances.

    `engaged` are their polar states about the target at the engagement, by their ids. Those that were `on_ring` before
    move as their references do; the others first keep their motion for the smoothing time t_sm. Infinite if they do not
    settle in five minutes.
    """
    ring = config.encirclement
    orbit = Orbit(ring.radius_m, ring.angular_rate_rad_s)
    mixing_s = {each: 0.0 if each in on_ring else ring.smoothing_time_s for each in engaged}
    ids, flights = list(engaged), [_OnReference(config, polar, mixing_s[each]) for each, polar in engaged.items()]
    weights = weights_of(ids, config.gaps)
    for tick in range(round(_LONGEST_S / _STEP_S)):
        bearings_rad = [flight.polar.bearing_rad for flight in flights]
        places_rad = [flight.place_rad(orbit, tick * _STEP_S) for flight in flights]
        errors_rad = place_errors_rad(places_rad, ids, config.gaps)
        places = [
            ring_place(own, bearings_rad[:i] + bearings_rad[i + 1 :], [weights[i], *weights[:i], *weights[i + 1 :]])
            for i, own in enumerate(bearings_rad)
        ]
        near = all(abs(flight.polar.radius_m - orbit.radius_m) <= radius_share * orbit.radius_m for flight in flights)
        off_rad = max(abs((place.lead_rad or tau) - place.desired_rad) for place in places)
        if near and off_rad <= spacing_rad and tick * _STEP_S >= max(mixing_s.values()):
            return tick * _STEP_S
        movers = [
            flight.joining.mover(error_rad, flight.polar.radius_m, orbit)
            for flight, error_rad in zip(flights, errors_rad, strict=True)
        ]
        for i, flight in enumerate(flights):
            radius_m = flight.joining.radius_m(flight.polar, places[i], errors_rad[i])
            movers_own_first = [movers[i], *movers[:i], *movers[i + 1 :]]
            flight.advance(RingWay(orbit, radius_m, movers_own_first, flight.joining.acceleration), tick * _STEP_S)
    return inf
