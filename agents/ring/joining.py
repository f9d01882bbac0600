"""How a vehicle joins the ring: from outside, to the place among the others that its bearing gives it.

It publishes its bearing from the engagement on, so that all know for how many the ring is. It flies towards its place
around the ring, outside of it, and enters once it is in front of its place and its neighbours have made room. A vehicle
for which the ring has no room waits outside, and does not publish its bearing.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Final

from agents.ring.commanded_ring import Orbit
from agents.ring.detour import MARGIN_M
from agents.ring.feasibility import RESERVE
from agents.ring.place import RingPlace, chord_m
from agents.ring.transition import SLOWEST_SHARE, TRACKED_SHARE, AccelerationBound, Mover, transition_of
from agents.settings.config import AgentConfig
from estimation.polar import Polar

ASIDE: Final = 2.0
WAITING: Final = 1.5
"""In separations: the distances outside the ring at which a vehicle is clear of it, and at which one waits to enter."""
_ROOM: Final = 1.5
"""In separations: the smallest distance between neighbours on the ring when a vehicle enters between them."""
_ROOM_SHARE: Final = 0.65
"""In wanted gaps: the largest room that is required, for a ring that is nearly full."""
_AT_RING: Final = 0.25
"""In separations: a vehicle this near to the ring, or inside it, flies on the ring even if there is no room."""
_IN_FRONT: Final = 3.0
"""In distances of the waiting circle from the ring: a vehicle this far from its place begins to enter."""
_TURNING_SHARE: Final = 0.6
"""The share of its acceleration that a vehicle uses along the ring, and of it across the ring, on its way in."""


class Joining:
    """Decides when one vehicle joins the ring, and when it may enter.

    `ring_m` is the ring's present radius, and `inside` whether the vehicle has entered it. The ring's capacity and the
    room for a vehicle are those of the configured ring, to which it returns if it was widened.
    """

    def __init__(self, config: AgentConfig) -> None:
        ring = config.encirclement
        self.ring_m = ring.radius_m
        self._separation_m = config.safety.separation_m
        self._waiting_m = WAITING * self._separation_m
        self._speed_m_s = RESERVE * min(ring.speed_max_m_s, config.safety.speed_max_m_s)
        self._acceleration_m_s2 = _TURNING_SHARE * min(ring.acceleration_max_m_s2, config.safety.acceleration_max_m_s2)
        self.joined = False
        self.inside = False
        self.change(config)
        self._aside_m = self._waiting_m

    def change(self, config: AgentConfig) -> None:
        """Join the ring of another configuration from now on."""
        self._configured_m = config.encirclement.radius_m
        self._room_rad = _ROOM * config.clearance_rad
        self._transition = transition_of(config.encirclement)
        self.acceleration = AccelerationBound(
            self._separation_m, self._transition.acceleration_m_s2, self._acceleration_m_s2
        )
        """The bound on the acceleration: a vehicle that comes in can brake for the smaller one at the ring."""

    @property
    def waiting_m(self) -> float:
        """The radius of the waiting circle outside the ring."""
        return self.ring_m + self._waiting_m

    @property
    def clear_m(self) -> float:
        """The radius beyond which a vehicle is clear of the ring."""
        return self.ring_m + ASIDE * self._separation_m

    def isolated_m(self, unsure_m: float) -> float:
        """Return the radius for a vehicle that the others have lost: they bend the ring around its last position.

        It adds two separations for the largest bend and one between bend and vehicle, each with its uncertainty.
        """
        return self.ring_m + 3.0 * self._separation_m + 2.0 * (unsure_m + MARGIN_M)

    def reset(self) -> None:
        """Restart as not joined, when the vehicle comes from another tactic."""
        self.joined = self.inside = False

    def look(self, polar: Polar, places: float) -> bool:
        """Join if the ring has room for so many even places; return whether the vehicle has joined."""
        fits = places == 1.0 or chord_m(self._configured_m, places) >= self._separation_m
        if not self.joined:
            self.joined = fits or polar.radius_m <= self.ring_m + self._separation_m
            self._aside_m = min(self._waiting_m, polar.radius_m - self.ring_m)
        return self.joined

    def radius_m(self, polar: Polar, place: RingPlace, error_rad: float) -> float:
        """Return the radius to fly at for a vehicle that has joined and is `error_rad` from its place.

        It is that of the ring once the vehicle is there and its neighbours have made room. A vehicle that joined inside
        the waiting circle does not fly out to it; nearer than a separation it enters before it is at its place.
        """
        outside_m, aside_m = polar.radius_m - self.ring_m, self._aside_m
        if self.inside or outside_m <= _AT_RING * self._separation_m:
            self.inside = True
            return self.ring_m
        if place.lead_rad is not None and place.lag_rad is not None:
            lead_room_rad = min(self._room_rad, _ROOM_SHARE * place.desired_rad)
            lag_room_rad = min(self._room_rad, _ROOM_SHARE * place.desired_lag_rad)
            if place.lead_rad < lead_room_rad or place.lag_rad < lag_room_rad:
                return self.ring_m + aside_m
        # Without a spacing gain no vehicle flies to its place.
        waits = self._transition.gain_per_s > 0.0 and aside_m > self._separation_m
        left_m = abs(error_rad) * self.ring_m if waits else 0.0
        self.inside = outside_m <= self._separation_m and left_m <= aside_m
        return self.ring_m + aside_m * min(1.0, left_m / (_IN_FRONT * aside_m))

    def coming(self, radius_m: float) -> float:
        """Return how far a vehicle at a radius is still outside: 0 on the ring, 1 from the waiting circle on."""
        return min(1.0, max(0.0, ((radius_m - self.ring_m) / self._separation_m - 1.0) / (WAITING - 1.0)))

    def movers(self, errors_rad: Sequence[float], radii_m: Sequence[float], orbit: Orbit) -> list[Mover]:
        """Return the bounds of the vehicles that change places, the own first, from their errors and radii.

        Vehicles on the ring have the same bounds, those of the outermost. Of them the law needs the two that are
        farthest from their places, ahead and behind.
        """
        found, on_ring, size_m = [self.mover(errors_rad[0], radii_m[0], orbit)], list[float](), 0.0
        for error_rad, radius_m in zip(errors_rad[1:], radii_m[1:], strict=True):
            if self.coming(radius_m) > 0.0:
                found.append(self.mover(error_rad, radius_m, orbit))
            else:
                on_ring.append(error_rad)
                size_m = max(size_m, radius_m)
        if on_ring:
            found += [self.mover(error_rad, size_m, orbit) for error_rad in {min(on_ring): 0, max(on_ring): 0}]
        return found

    def mover(self, error_rad: float, radius_m: float, orbit: Orbit) -> Mover:
        """Return the bounds of a vehicle at a radius: of a transition on the ring, its own on its way in.

        On its way in it may also fly against the ring's direction.
        """
        coming, size_m = self.coming(radius_m), max(radius_m, orbit.radius_m)
        ring_m_s, gentle_m_s = abs(orbit.angular_rate_rad_s) * size_m, TRACKED_SHARE * self._transition.speed_m_s
        most_m_s = min(self._speed_m_s, sqrt(self._acceleration_m_s2 * size_m))
        waiting_m_s = gentle_m_s if ring_m_s == 0.0 else min(gentle_m_s, (1.0 - SLOWEST_SHARE) * ring_m_s)
        return Mover(
            error_rad,
            (gentle_m_s + coming * max(0.0, most_m_s - ring_m_s - gentle_m_s)) / size_m,
            (waiting_m_s + coming * max(0.0, most_m_s + ring_m_s - waiting_m_s)) / size_m,
            # It brakes for its place while it comes in and the bound falls.
            (self._transition.acceleration_m_s2 + self.acceleration.at_m_s2(radius_m - self.ring_m)) / 2.0 / size_m,
        )
