"""The peers on the ring about the target: their newest bearings and references, while they are engaged."""

from collections.abc import Callable, Iterable
from math import inf, sqrt, tau
from typing import Final
from zlib import crc32

import msgspec

from agents.team.numbers import PlaceNumbers

BESIDE_FOR_S: Final = 0.2
"""How long what is found among all engaged peers is valid: the period of their states."""
_ALONG_M: Final = 3.0
_RADIUS_M: Final = 0.5
"""How far vehicles may move past each other meanwhile, along the ring and across it."""


class RingScale(msgspec.Struct, frozen=True):
    """A ring as shares of the mission's: of its angular rate, at most 1, and of its radius, at least 1."""

    rate: float = 1.0
    radius: float = 1.0

    def with_(self, other: "RingScale") -> "RingScale":
        """Return the ring that both can fly."""
        return RingScale(min(self.rate, other.rate), max(self.radius, other.radius))


FULL_RING = RingScale()


class RingMembers:
    """The newest place on the ring of every peer that has one; queries return those of `engaged` peers."""

    def __init__(self, engaged: Callable[[int], bool]) -> None:
        """Take a function that returns whether a peer is engaged, which ends before its place is stale."""
        self._is_engaged = engaged
        self._places: dict[int, PlaceNumbers] = {}
        self._engaged: dict[int, PlaceNumbers] | None = None
        self._shares = FULL_RING
        self._references: int | None = None
        self._ids: tuple[int, ...] = ()
        self.revision = 0
        """Another number once the engaged peers, or what they know of each other, have changed."""
        self.oldest_s = inf
        """A lower bound of the times of all places."""

    def receive(self, place: PlaceNumbers) -> None:
        """Take a place unless a newer one is known."""
        sender = place.sender
        known = self._places.get(sender)
        if known is not None and place.time_s <= known.time_s:
            return
        self._places[sender] = place
        self.oldest_s = min(self.oldest_s, place.time_s)
        if known is None or known.has_reference != place.has_reference:
            self._references = None
        if known is None or known.references != place.references:
            self.revision += 1
        if self._engaged is None:
            return
        if known is None or place.shares != known.shares:
            self.changed()
        elif sender in self._engaged:
            self._engaged[sender] = place

    def forget(self, vehicle_id: int) -> None:
        """Drop a peer's place."""
        if self._places.pop(vehicle_id, None) is not None:
            self.changed()

    def expire(self, before_s: float) -> None:
        """Drop the places that are older than a time."""
        for sender in [s for s, place in self._places.items() if place.time_s < before_s]:
            self.forget(sender)
        self.oldest_s = min((place.time_s for place in self._places.values()), default=inf)

    def changed(self) -> None:
        """Record that peers may have engaged or left."""
        self._engaged = None
        self.revision += 1

    @property
    def ids(self) -> tuple[int, ...]:
        """The engaged peers."""
        self._on_ring()
        return self._ids

    def beside(self, bearing_rad: float, radius_m: float, at_s: float, within_m: float) -> tuple[int, ...]:
        """Return the engaged peers that may be next to a place on either side within `BESIDE_FOR_S`.

        They are those up to the next one whose radius differs by less than `within_m`, and those about as near as it.
        """
        ahead_rad, lead_rad, lag_rad, abreast_m = list[float](), inf, -inf, within_m - _RADIUS_M
        for each in self._on_ring():
            each_rad = (each.bearing_at_rad(at_s) - bearing_rad) % tau
            ahead_rad.append(each_rad)
            if abs(each.radius_m - radius_m) < abreast_m:
                lead_rad, lag_rad = min(lead_rad, each_rad or tau), max(lag_rad, each_rad)
        if lag_rad == -inf:
            return self._ids
        about_rad = _ALONG_M / max(radius_m, within_m)
        lead_rad, lag_rad = lead_rad + about_rad, lag_rad - about_rad
        by_id = zip(self._ids, ahead_rad, strict=True)
        return tuple([sender for sender, each_rad in by_id if not lead_rad < each_rad < lag_rad])

    def bearings_rad(self, at_s: float, of: Iterable[int]) -> list[float]:
        """Return the bearings of engaged peers at a time, extrapolated at their published rates - (25), (26)."""
        return [self._places[each].bearing_at_rad(at_s) for each in of]

    def abreast(
        self, at_s: float, radius_m: float, within_m: float, of: Iterable[int]
    ) -> list[tuple[float, float, float]]:
        """Return the same with their rates, of the peers whose radius differs by less than `within_m`.

        The third is by how much nearer than `within_m` around the target each may be, as an angle at the radius: their
        distance has a radial part.
        """
        size_m, places = max(radius_m, within_m), [self._places[each] for each in of]
        return [
            (place.bearing_at_rad(at_s), place.angular_rate_rad_s, (within_m - sqrt(within_m**2 - off_m**2)) / size_m)
            for place in places
            if (off_m := abs(place.radius_m - radius_m)) < within_m
        ]

    def others(self, at_s: float) -> tuple[list[int], list[float], list[float]]:
        """Return the engaged peers with a reference: ids, its bearings at a time at its published rate, and radii."""
        ids, bearings_rad, radii_m = list[int](), list[float](), list[float]()
        for each in self._on_ring():
            if each.has_reference:
                ids.append(each.sender)
                bearings_rad.append(each.reference_rad + each.reference_rate_rad_s * (at_s - each.time_s))
                radii_m.append(each.radius_m)
        return ids, bearings_rad, radii_m

    def references(self, own_id: int) -> int:
        """Return a digest of the vehicles whose references the law takes into account, the own included; never 0."""
        members = self._on_ring()
        if self._references is None:
            ids = [place.sender for place in members if place.has_reference]
            self._references = 1 + crc32(bytes(sorted([own_id, *ids]))) % 0xFFFF
        return self._references

    def is_known_to_all(self, own_id: int) -> bool:
        """Return whether all engaged peers with a reference take the same references into account as this vehicle."""
        ours = self.references(own_id)
        return all(place.references in (0, ours) for place in self._on_ring() if place.has_reference)

    def shares(self) -> RingScale:
        """Return the ring that all engaged peers can fly."""
        self._on_ring()
        return self._shares

    def _on_ring(self) -> Iterable[PlaceNumbers]:
        # Used several times a tick, and constant until a peer engages or leaves, or the ring changes its size.
        if self._engaged is None:
            # In the order of their ids, so that sorting them costs little.
            self._engaged = {each: self._places[each] for each in sorted(self._places) if self._is_engaged(each)}
            self._ids = tuple(self._engaged)
            self._shares, self._references = FULL_RING, None
            for place in self._engaged.values():
                rate_share, radius_share = place.shares
                if rate_share < self._shares.rate or radius_share > self._shares.radius:
                    self._shares = self._shares.with_(RingScale(rate_share, radius_share))
        return self._engaged.values()
