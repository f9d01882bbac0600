"""The peers of a vehicle: the newest of each kind of message from each, while it is fresh."""

from collections.abc import Iterable, Mapping
from math import hypot

from agents.tactics import Tactic
from agents.team.credibility import Credibility, Doubt
from agents.team.messages import TOPICS, MemberState, NeighbourAngle
from agents.team.ring_scale import FULL_RING, RingScale
from estimation.state import Vector

_MEMBER_AGE_MAX_S = TOPICS[MemberState].age_max_s
_ANGLE_AGE_MAX_S = TOPICS[NeighbourAngle].age_max_s
_IN_FORMATION, _ON_RING = Tactic.FORMATION.value, Tactic.ENCIRCLE.value
_LEAVING = (Tactic.LAND.value, Tactic.PILOT_OVERRIDE.value)
"""Peers whose last state had one of these tactics may fall silent."""


class Team:
    """The peers of one vehicle, by their last messages; stale means gone."""

    def __init__(self, credibility: Credibility) -> None:
        """Take what decides whether a state is its sender's."""
        self._credibility = credibility
        self._members: dict[int, MemberState] = {}
        self._angles: dict[int, NeighbourAngle] = {}
        self._lost: dict[int, MemberState] = {}
        self._heard: set[int] = set()

    def hear_member(self, message: MemberState) -> None:
        """Take in a peer's state unless a newer one is known, or it contradicts what is."""
        known = self._members.get(message.sender)
        if not self._credibility.accepts(message, known=known is not None):
            return
        if known is None or message.time_s > known.time_s:
            self._members[message.sender] = message
            if known is None:
                self._lost.pop(message.sender, None)
                self._heard.add(message.sender)

    def hear_angle(self, message: NeighbourAngle) -> None:
        """Take in a peer's place on the ring unless a newer one is known."""
        known = self._angles.get(message.sender)
        if known is None or message.time_s > known.time_s:
            self._angles[message.sender] = message

    def forget(self, vehicle_id: int) -> None:
        """Drop a peer whose presence has ended: it is lost, at the altitude of its last state, be that the ground."""
        member = self._members.pop(vehicle_id, None)
        self._angles.pop(vehicle_id, None)
        if member is not None:
            self._lost[vehicle_id] = member

    def expire(self, now_s: float, time_scale: float = 1.0) -> None:
        """Drop what has become too old to act on, which takes `time_scale` times as long as on the wall's clock."""
        member_s, angle_s = now_s - _MEMBER_AGE_MAX_S * time_scale, now_s - _ANGLE_AGE_MAX_S * time_scale
        for sender in [s for s, m in self._members.items() if m.time_s < member_s]:
            self._lost[sender] = self._members.pop(sender)
        for sender in [s for s, a in self._angles.items() if a.time_s < angle_s]:
            del self._angles[sender]
        if self._credibility.contested:
            self._credibility.expire(now_s, time_scale)

    def in_formation(self) -> Iterable[int]:
        """Return the ids of the peers that fly in formation."""
        return [s for s, m in self._members.items() if m.tactic == _IN_FORMATION]

    def members(self) -> tuple[MemberState, ...]:
        """Return the newest state of every peer that is known to be there."""
        return tuple(self._members.values())

    def angles(self) -> dict[int, NeighbourAngle]:
        """Return the newest place on the ring of every peer that has one, by sender."""
        return dict(self._angles)

    def lost(self, now_s: float, for_s: float) -> tuple[MemberState, ...]:
        """Return the last state of every peer that fell silent less than `for_s` ago, in the air or landed.

        So is where a peer may be beside its state, as other states in its name claim or as it was known before.
        """
        if not self._lost and not self._credibility.contested:
            return ()
        silent = tuple(member for member in self._lost.values() if now_s - member.time_s < for_s)
        return silent + self._credibility.elsewhere()

    @property
    def doubts(self) -> Mapping[int, Doubt]:
        """The peers whose states contradict each other."""
        return self._credibility.doubts if self._credibility.contested else {}

    @property
    def gone_s(self) -> dict[int, float]:
        """When each peer was received last that fell silent without having published that it leaves the team."""
        if not self._lost:
            return {}
        return {sender: last.time_s for sender, last in self._lost.items() if last.tactic not in _LEAVING}

    @property
    def count_heard(self) -> int:
        """From how many peers messages have come so far, silent by now or not."""
        return len(self._heard)

    def member(self, vehicle_id: int) -> MemberState:
        """Return the newest state of a peer that is known to be there."""
        return self._members[vehicle_id]

    def bearings_rad(self, at_s: float, rate_rad_s: float) -> list[float]:
        """Return the bearings of all engaged peers at a moment, going on at the ring's rate - (25), (26)."""
        return [
            angle.bearing_rad + rate_rad_s * (at_s - angle.time_s)
            for sender, angle in self._angles.items()
            if self._engaged(sender)
        ]

    def reference_bearings_rad(self, at_s: float) -> list[float]:
        """Return the bearings of all engaged peers' references at a moment, going on as they published."""
        return [
            angle.reference_rad + angle.reference_rate_rad_s * (at_s - angle.time_s)
            for sender, angle in self._angles.items()
            if angle.reference_rad is not None and self._engaged(sender)
        ]

    def shares(self) -> RingScale:
        """Return the ring that all engaged peers can fly."""
        shares = FULL_RING
        for sender, angle in self._angles.items():
            if (angle.rate_share < shares.rate or angle.radius_share > shares.radius) and self._engaged(sender):
                shares = shares.with_(RingScale(angle.rate_share, angle.radius_share))
        return shares

    def within(self, position_m: Vector, radius_m: float) -> tuple[int, ...]:
        """Return the peers within a radius of a position (2,)."""
        x, y = position_m.tolist()
        return tuple(s for s, m in self._members.items() if hypot(m.position_m[0] - x, m.position_m[1] - y) <= radius_m)

    def _engaged(self, sender: int) -> bool:
        # A vehicle that has left the ring publishes so before its last bearing goes stale.
        member = self._members.get(sender)
        return member is None or member.tactic == _ON_RING
