"""The peers of a vehicle: the newest fresh message of each kind from each peer."""

from collections.abc import Iterable, Mapping, Sequence
from math import inf
from typing import Final

from agents.tactics import Tactic
from agents.team.consistency_check import ConsistencyCheck, Inconsistency
from agents.team.messages import TOPICS, MemberState
from agents.team.numbers import StateNumbers
from agents.team.ring_members import RingMembers
from agents.team.send_rate import task_goes_on
from estimation.state import Vector
from estimation.vectors import length

_SILENT_S = TOPICS[MemberState].age_max_s
"""A peer that is not received for this long is silent: the guard assumes that it does not evade."""
GONE_S: Final = 2.0
"""After this it is gone: it is no member any more, and its place is taken. Ten of its states are then missing."""
_IN_FORMATION = Tactic.FORMATION.value
_LEAVING = (Tactic.LAND.value, Tactic.PILOT_OVERRIDE.value)
"""Peers with one of these tactics in their last state are expected to fall silent."""
_WATCHED_MAX_S: Final = 1.0
"""A selection of near peers that seems valid for longer dates from before a step of the clock."""
_FAR_PERIOD_S: Final = 0.75
"""The period at which states of a distant peer with an unchanged task are processed."""


class Team:
    """The peers of one vehicle, from their last messages: silent after one second, gone after two.

    States of `near` peers are processed at once; until the first `watch` all are near. A state of another peer waits
    while its task is unchanged, so that the cost of a tick does not grow with their number.
    """

    def __init__(self, consistency: ConsistencyCheck) -> None:
        """Take the consistency check of states."""
        self._consistency = consistency
        self._members: dict[int, MemberState] = {}
        self._numbers: dict[int, StateNumbers] = {}
        self._all: tuple[MemberState, ...] | None = None
        self._waiting: dict[int, MemberState] = {}
        self._silent: dict[int, MemberState] = {}
        self._lost: dict[int, MemberState] = {}
        self._received: set[int] = set()
        self._near: tuple[MemberState, ...] | None = None
        self._near_numbers: tuple[StateNumbers, ...] | None = None
        self._near_ids: dict[int, None] | None = None
        self._watched_until_s = -inf
        self._oldest_s = inf
        self.ring = RingMembers(self._engaged)
        self.ring_number = 0
        """The number of the vehicle's ring among the mission's: `ring` has the peers on this one."""

    def waits(self, state: MemberState) -> bool:
        """Return whether a state may wait: from a distant peer with an unchanged task, without a sighting.

        A waiting state is processed when the next one is due, or when the peer falls silent.
        """
        if self._near_ids is None:
            return False
        numbers = state.numbers
        sender = numbers.sender
        if sender in self._near_ids or numbers.has_sightings:
            return False
        known = self._numbers.get(sender)
        if known is None or not 0.0 < numbers.time_s - known.time_s < _FAR_PERIOD_S:
            return False
        # Nearly all vehicles of a process compare the same two states.
        if numbers.compared_id != known.state_id:
            numbers.goes_on, numbers.compared_id = task_goes_on(self._members[sender], state), known.state_id
        if not numbers.goes_on:
            return False
        self._waiting[sender] = state
        return True

    def watch_due(self, now_s: float) -> bool:
        """Return whether the near peers have to be selected again."""
        return not self._watched_until_s - _WATCHED_MAX_S <= now_s < self._watched_until_s

    def watch(self, near: Sequence[MemberState], until_s: float) -> None:
        """Set the near members until a time less than a second from now."""
        self._near_ids = None if len(near) == len(self._members) else dict.fromkeys([each.sender for each in near])
        self._near, self._near_numbers, self._watched_until_s = None, None, until_s

    def receive(self, state: MemberState) -> None:
        """Take a peer's state, unless a newer one is known or it is inconsistent; and its place on the ring."""
        numbers = state.numbers
        sender, time_s = numbers.sender, numbers.time_s
        if self._waiting:
            self._waiting.pop(sender, None)
        known = self._numbers.get(sender)
        known_s = -inf if known is None else known.time_s
        if self._consistency.accepts(state, known=time_s - known_s <= _SILENT_S) and time_s > known_s:
            self._members[sender], self._numbers[sender] = state, numbers
            self._all = self._near = self._near_numbers = None
            if self._silent:
                self._silent.pop(sender, None)
            self._oldest_s = min(self._oldest_s, time_s)
            if known is None:
                self._lost.pop(sender, None)
                self._received.add(sender)
                if self._near_ids is not None:
                    self._near_ids[sender] = None
            if known is None or numbers.on_ring != known.on_ring:
                self.ring.changed()
        if numbers.place is not None:
            self.ring.receive(numbers.place)

    def forget(self, vehicle_id: int) -> None:
        """Drop a peer whose presence has ended: it is lost at its last altitude, which may be the ground."""
        self._waiting.pop(vehicle_id, None)
        self._silent.pop(vehicle_id, None)
        member = self._members.pop(vehicle_id, None)
        self.ring.forget(vehicle_id)
        if member is not None:
            del self._numbers[vehicle_id]
            self._lost[vehicle_id] = member
            self._all = self._near = self._near_numbers = None
            self.ring.changed()

    def expire(self, now_s: float, time_scale: float = 1.0) -> None:
        """Drop messages that are too old; `time_scale` is mission seconds per wall second."""
        silent_s, gone_s = now_s - _SILENT_S * time_scale, now_s - GONE_S * time_scale
        if self._oldest_s < silent_s:
            for sender in [s for s, numbers in self._numbers.items() if numbers.time_s < silent_s]:
                if sender in self._waiting:
                    self.receive(self._waiting[sender])
                member = self._members[sender]
                if member.time_s < gone_s:
                    self._lost[sender] = self._members.pop(sender)
                    del self._numbers[sender]
                    self._silent.pop(sender, None)
                    self._all = None
                    self.ring.changed()
                elif member.time_s < silent_s:
                    self._silent[sender] = member
                self._near = self._near_numbers = None
            self._oldest_s = min([numbers.time_s for numbers in self._numbers.values()], default=inf)
        if self.ring.oldest_s < gone_s:
            self.ring.expire(gone_s)
        if self._consistency.contested:
            self._consistency.expire(now_s, time_scale)

    def in_formation(self) -> Iterable[int]:
        """Return the ids of the peers that fly in formation."""
        return [s for s, m in self._members.items() if m.tactic == _IN_FORMATION]

    def members(self) -> tuple[MemberState, ...]:
        """Return the newest state of every member."""
        if self._all is None:
            self._all = tuple(self._members.values())
        return self._all

    def near(self) -> tuple[MemberState, ...]:
        """Return the newest states of the near members that are not silent."""
        if self._near_ids is None and not self._silent:
            return self.members()
        if self._near is None:
            near, members = self._members if self._near_ids is None else self._near_ids, self._members
            self._near = tuple([members[each] for each in near if each in members and each not in self._silent])
        return self._near

    def near_numbers(self) -> tuple[StateNumbers, ...]:
        """Return the numbers of the same states, in the same order."""
        if self._near_numbers is None:
            self._near_numbers = tuple([each.numbers for each in self.near()])
        return self._near_numbers

    def lost(self, now_s: float, for_s: float) -> tuple[MemberState, ...]:
        """Return the last state of every peer that fell silent less than `for_s` ago, in flight or landed.

        The states of other tracks about peers are included (`ConsistencyCheck.elsewhere`).
        """
        if not (self._lost or self._silent or self._consistency.contested):
            return ()
        silent = [*self._silent.values(), *self._lost.values()]
        return (*(each for each in silent if now_s - each.time_s < for_s), *self._consistency.elsewhere())

    @property
    def inconsistencies(self) -> Mapping[int, Inconsistency]:
        """The peers whose states contradict each other, unless their own alert explains it."""
        if not self._consistency.contested:
            return {}
        found = self._consistency.inconsistencies
        return {sender: each for sender, each in found.items() if not self.explanation(sender)}

    @property
    def explained(self) -> dict[int, str]:
        """The peers whose own alert explains why their states contradict each other, and the alert."""
        if not self._consistency.contested:
            return {}
        return {sender: alert for sender in sorted(self._consistency.contested) if (alert := self.explanation(sender))}

    def explanation(self, sender: int) -> str:
        """Return a member's alert if it explains a wrong position, else an empty text."""
        member = self._members.get(sender)
        return member.alert if member is not None and self._consistency.explains(member) else ""

    @property
    def gone_s(self) -> dict[int, float]:
        """The time of the last state of each peer that is gone without having published that it leaves the team."""
        if not self._lost:
            return {}
        return {sender: last.time_s for sender, last in self._lost.items() if last.tactic not in _LEAVING}

    @property
    def count_received(self) -> int:
        """The number of peers received so far, including silent ones."""
        return len(self._received)

    def member(self, vehicle_id: int) -> MemberState:
        """Return the newest state of a member."""
        return self._members[vehicle_id]

    def within(self, position_m: Vector, radius_m: float) -> tuple[int, ...]:
        """Return the peers within a radius of a position (2,)."""
        x, y = position_m.tolist()
        found = list[int]()
        for sender, numbers in self._numbers.items():
            its_x, its_y = numbers.position_m
            if length(its_x - x, its_y - y) <= radius_m:
                found.append(sender)
        return tuple(found)

    def follow_ring(self, number: int) -> None:
        """Take the number of the vehicle's ring."""
        self.ring_number = number
        self.ring.changed()

    def encircles(self, member: MemberState) -> bool:
        """Return whether a member is on the vehicle's ring, or comes to it."""
        return member.numbers.on_ring == self.ring_number

    def _engaged(self, sender: int) -> bool:
        member = self._members.get(sender)
        return member is None or self.encircles(member)
