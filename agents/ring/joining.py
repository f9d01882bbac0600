"""How a vehicle joins an occupied ring: from outside, into a wide gap, when there is room for it.

Until it has joined it does not publish its bearing, and the ring does not change. Once it is in front of its gap it
publishes its bearing: the members make room, and the vehicle enters when there is enough. No member is overtaken or cut
off.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import copysign, tau

import msgspec

from agents.ring.detour import MARGIN_M
from agents.ring.place import RingPlace, chord_m
from agents.settings.config import AgentConfig
from estimation.frames import wrap_signed_rad, wrap_turn_rad
from estimation.polar import Polar

ASIDE = 2.0
"""In separations: the distance outside the ring at which a vehicle waits."""
_ROOM = 1.5
"""In separations: the smallest distance between neighbours on the ring when a vehicle enters between them."""
_ROOM_SHARE = 0.75
"""In even spacings: the largest room that is required, for a ring that is nearly full."""
_WIDE_SHARE = 0.8
"""A gap that the vehicle is in front of is taken if it has this share of the widest gap's width."""
_FURTHER = 1.1
"""The margin over the room that a vehicle needs, so that it may enter where it arrives."""


class RingGap(msgspec.Struct, frozen=True):
    """A gap between neighbours on the ring: the angle from a vehicle to its middle, and its width."""

    ahead_rad: float
    width_rad: float

    @property
    def edge_rad(self) -> float:
        """The angle from the vehicle to the gap's nearer edge; negative outside the gap."""
        return self.width_rad / 2.0 - abs(self.ahead_rad)

    def way_rad(self, room_rad: float) -> float:
        """Return the angle ahead to the nearest place with this room on either side, at most to the middle."""
        return copysign(max(0.0, min(room_rad, self.width_rad / 2.0) - self.edge_rad), self.ahead_rad)


class Joining:
    """Decides when one vehicle joins the ring, and when it may enter.

    `ring_m` is the ring's present radius. The ring's capacity and the room for a vehicle are those of the mission's
    ring, to which it returns.
    """

    def __init__(self, config: AgentConfig) -> None:
        self._mission_ring_m = self.ring_m = config.encirclement.radius_m
        self._separation_m = config.safety.separation_m
        self._room_rad = _ROOM * config.clearance_rad
        self.joined = False
        self._inside = False

    @property
    def waiting_m(self) -> float:
        """The radius of the waiting circle outside the ring."""
        return self.ring_m + ASIDE * self._separation_m

    def isolated_m(self, unsure_m: float) -> float:
        """Return the radius for a vehicle that the others have lost: they bend the ring around its last position.

        It adds two separations for the largest bend and one between bend and vehicle, each with its uncertainty.
        """
        return self.ring_m + 3.0 * self._separation_m + 2.0 * (unsure_m + MARGIN_M)

    def reset(self) -> None:
        """Restart as not joined, when the vehicle comes from another tactic."""
        self.joined = self._inside = False

    def look(self, polar: Polar, bearings_rad: Sequence[float]) -> float | None:
        """Join if possible; return the angle ahead to the nearest free place [rad], None once joined."""
        if self.joined:
            return None
        gap = chosen_gap(polar.bearing_rad, bearings_rad)
        members = len(bearings_rad) + 1
        room_rad = min(self._room_rad, _ROOM_SHARE * gap.width_rad / 2.0)
        fits = members == 1 or chord_m(self._mission_ring_m, members) >= self._separation_m
        at_ring = polar.radius_m <= self.ring_m + self._separation_m
        self.joined = at_ring or (fits and gap.edge_rad >= room_rad)
        return None if self.joined else gap.way_rad(_FURTHER * room_rad if fits else gap.width_rad / 2.0)

    def radius_m(self, polar: Polar, place: RingPlace) -> float:
        """Return the radius to fly at for a vehicle that has joined: the ring's, once its neighbours have made room."""
        if not self._inside and place.lead_rad is not None and place.lag_rad is not None:
            room_rad = min(self._room_rad, _ROOM_SHARE * place.desired_rad)
            at_ring = polar.radius_m <= self.ring_m + self._separation_m
            if not at_ring and min(place.lead_rad, place.lag_rad) < room_rad:
                return self.waiting_m
        self._inside = self._inside or polar.radius_m <= self.ring_m + self._separation_m
        return self.ring_m


def chosen_gap(bearing_rad: float, bearings_rad: Sequence[float]) -> RingGap:
    """Return the widest gap between vehicles on the ring, or the one in front if that is nearly as wide."""
    if not bearings_rad:
        return RingGap(0.0, tau)
    ahead = sorted(wrap_turn_rad(other - bearing_rad) for other in bearings_rad)
    gaps = [RingGap((one + other) / 2.0, other - one) for one, other in pairwise(ahead)]
    own_lag = tau - ahead[-1]
    own = RingGap((ahead[0] - own_lag) / 2.0, ahead[0] + own_lag)
    widest = max(gaps, key=lambda gap: gap.width_rad, default=own)
    if own.width_rad >= _WIDE_SHARE * widest.width_rad:
        return own
    return RingGap(wrap_signed_rad(widest.ahead_rad), widest.width_rad)
