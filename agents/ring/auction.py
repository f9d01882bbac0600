"""The auction of the places on several rings: each vehicle finds its ring from the bids in its peers' states.

It is the consensus-based auction of Choi, Brunet and How (CBAA, IEEE Transactions on Robotics 25(4), 2009) for rings
with several places, with one difference. CBAA spreads the winning bids, and each bid that is outbid starts another
consensus: up to one diameter of the radio graph for every place. Here each vehicle's bids for all rings spread, the
newest of each vehicle replacing older ones, and the rounds of the auction run inside each vehicle (`assignment`). So
all vehicles compute the same conflict-free assignment one diameter of messages after the last change of a bid, and it
is the one with the least sum of costs, not only a greedy one.

What is published, `payload_bytes` at most: which vehicles this one hears, its own bids, and the newest bids of those
that not all of its neighbours hear. In a team that all hear each other these are only its own. Bids pass over links
that work both ways: a vehicle relays nothing to one that it does not hear.

What keeps choices from oscillating: scores are smoothed, a published bid changes only when the score has left a band
around it, and a ring that a vehicle holds costs it less than it bids. A vehicle holds the ring that it has chosen for
`settling_s`. By then the team agrees, so that rings chosen before are not held.

A vehicle that publishes arbitrary bids of its own takes one place, as any vehicle, also one that another holds if it
claims that an operator has assigned it; while it changes them all the time, so do the choices of those that compete
with it. Bids of vehicles that are heard are those that they sent themselves, whatever others relay. Of vehicles that
are not heard only relays are known, and these are not signed: a relay between two parts of a team can alter what one
knows of the other, and bid for members that do not fly.
"""

from collections.abc import Mapping, Sequence
from math import exp, isfinite, log
from struct import Struct
from typing import Final, NamedTuple
from zlib import crc32

from agents.team.messages import RINGS_MAX

ID_MAX: Final = 254
HOP_S: Final = 0.3
"""More than the mean time until a neighbour receives a change: 0.25 s with five states a second and a fifth lost."""
HEARD_S: Final = 2.0
"""A neighbour is heard until no message of it has come for this long."""
AHEAD_MAX_S: Final = 1.0
"""Bids dated further ahead of the own clock are ignored."""
RELEASE_S: Final = 0.5
"""A bid for a ring is withdrawn when the ring has not been eligible for this long."""
_SMOOTHING_S: Final = 1.0
_PER_S: Final = 100
"""The units of a stamp in a second; a stamp is sent modulo 2^16 of them."""
_WRAP = 1 << 16
_LEVELS, _SCORE_MIN = 255, 1.0 / 512.0
"""Bids are levels from 1 to 255 of scores from 1/512 to 1, even on a logarithmic scale; 0 is no bid."""
_PER_LEVEL = log(1.0 / _SCORE_MIN) / (_LEVELS - 1)
_BAND: Final = 11.0
"""In levels: a bid changes when the score is 31 % above it or 24 % below."""
_COST_MS = [0, *(round(1e3 * exp(_PER_LEVEL * (_LEVELS - level))) for level in range(1, _LEVELS + 1))]
"""What each level costs: the reciprocal of its score. Whole numbers, so that sums do not depend on their order."""
_HELD_SHARE: Final = 4
_HELD_MS: Final = 1000
"""A ring that a vehicle holds costs it a fourth and a second less."""
_ASSIGNED_MS, _ASSIGNED_BIT = -2 * 10**9, 0x80
"""The cost of a ring that an operator has assigned to the vehicle: it comes before all others, also if one of them then
has no place. It is sent beside the ring that it holds.
"""
_NO_RING_MS = 10**9
"""The cost of no ring: more than all rings together, so that as many vehicles as possible have a place."""
_TIE_BITS: Final = 48
_ID_BITS: Final = 32
"""Costs are multiples of 2^48. What is added to them decides only between equal sums, of at most 254 vehicles."""


def ring_score(importance: float, threat: float, time_s: float) -> float:
    """Return a vehicle's score in [0, 1] for a ring: eta (1 - epsilon) / (1 + t / 1 s).

    `time_s` is the time to get there, 0 for a vehicle on the ring. The score rises with the importance eta and falls
    with the threat epsilon and the time. Its reciprocal is the cost that the auction minimises: among targets of one
    value the time to get there, and a target of half the value costs as much as one twice as far. Raises ValueError for
    importance or threat outside [0, 1], and a time that is negative or not finite.
    """
    for name, value in (("importance", importance), ("threat", threat)):
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{name} is a number from 0 to 1 (given: {value})")
    if not (isfinite(time_s) and time_s >= 0.0):
        raise ValueError(f"the time to get to a ring is 0 s or more (given: {time_s})")
    return importance * (1.0 - threat) / (1.0 + time_s)


class Bids(NamedTuple):
    """A vehicle's bids: the ring that it holds, and for each ring the level of its score, 0 for a ring without one.

    Where an operator has assigned a ring (`is_assigned`), that is the one with the highest level.
    """

    held: int | None
    levels: bytes
    is_assigned: bool = False

    def cost_ms(self, ring: int) -> int | None:
        """Return what the vehicle on a ring adds to the sum that is minimised, None where it does not bid."""
        cost_ms = _COST_MS[self.levels[ring]]
        if cost_ms == 0:
            return None
        if self.is_assigned and self.levels[ring] == _LEVELS:
            return _ASSIGNED_MS
        return cost_ms - (cost_ms // _HELD_SHARE + _HELD_MS if ring == self.held else 0)


def assignment(bids: Mapping[int, Bids], places: Sequence[int]) -> dict[int, int]:
    """Return the ring of each vehicle that has one: as many vehicles as possible, and of these the least sum of costs.

    `bids` are those of the vehicles by id, `places` the number of places of each ring. It depends on nothing else.
    Where sums are equal, the vehicles without a place are those with the higher ids, and a checksum of vehicle and ring
    decides between rings: so only one assignment is the best, and it remains that when its vehicles hold their rings.
    """
    flow = _Flow([*places, len(bids)], {vehicle: _costs(vehicle, own) for vehicle, own in bids.items()})
    for vehicle in sorted(bids):
        flow.place(vehicle)
    return {vehicle: ring for ring, vehicles in enumerate(flow.on[:-1]) for vehicle in vehicles}


def _costs(vehicle: int, bids: Bids) -> list[int | None]:
    """Return the costs of a vehicle on each ring, None where it does not bid, and last on none."""
    costs: list[int | None] = []
    for ring in range(len(bids.levels)):
        cost_ms = bids.cost_ms(ring)
        costs.append(None if cost_ms is None else (cost_ms << _TIE_BITS) + (crc32(bytes((vehicle, ring))) >> 8))
    return [*costs, (_NO_RING_MS << _TIE_BITS) + (ID_MAX + 1 - vehicle << _ID_BITS)]


class _Flow:
    """Vehicles on rings at the least cost: `on` has them by ring; the last ring is none, with places for all.

    Vehicles are placed one after another, each along the shortest path over rings whose vehicles move on to others
    (successive shortest paths).
    """

    def __init__(self, places: Sequence[int], costs: Mapping[int, Sequence[int | None]]) -> None:
        self._places, self._costs = places, costs
        self.on: Final[list[list[int]]] = [[] for _ in places]
        self._moves: list[dict[int, tuple[int, int]]] = [{} for _ in places]

    def place(self, vehicle: int) -> None:
        """Place another vehicle on the ring with which the sum is least; others may move for it."""
        least, last = self._paths(vehicle)
        free = [ring for ring in sorted(least) if len(self.on[ring]) < self._places[ring]]
        ring = min(free, key=least.__getitem__)
        changed = [ring]
        while ring in last:
            ring_before, mover = last[ring]
            self.on[ring_before].remove(mover)
            self.on[ring].append(mover)
            ring = ring_before
            changed.append(ring)
        self.on[ring].append(vehicle)
        for ring in changed:
            self._moves[ring] = self._cheapest_moves(ring)

    def _paths(self, vehicle: int) -> tuple[dict[int, int], dict[int, tuple[int, int]]]:
        """Return what a vehicle more on each ring adds at least, and the ring and the vehicle of the last move to it.

        It is the algorithm of Bellman and Ford. There are no negative cycles: those on rings are at the least cost.
        """
        least = {ring: cost for ring, cost in enumerate(self._costs[vehicle]) if cost is not None}
        last: dict[int, tuple[int, int]] = {}
        reached = list(least)
        while reached:
            before, reached = reached, []
            for ring in before:
                for to, (added, mover) in self._moves[ring].items():
                    cost = least[ring] + added
                    if to not in least or cost < least[to]:
                        least[to], last[to] = cost, (ring, mover)
                        if to not in reached:
                            reached.append(to)
        return least, last

    def _cheapest_moves(self, ring: int) -> dict[int, tuple[int, int]]:
        """Return the least added cost of a move from a ring to each other, and the vehicle that moves."""
        moves: dict[int, tuple[int, int]] = {}
        if ring == len(self._places) - 1:
            return moves  # a vehicle without a ring has none later either: places do not become free
        for vehicle in self.on[ring]:
            costs = self._costs[vehicle]
            own = costs[ring] or 0
            for to, cost in enumerate(costs):
                if cost is not None and to != ring and (to not in moves or cost - own < moves[to][0]):
                    moves[to] = (cost - own, vehicle)
        return moves


class _OwnBid:
    """The own bid for one ring: its `level`, 0 for none."""

    def __init__(self) -> None:
        self.level = 0
        self._smoothed = self._since_s = self._scored_s = 0.0

    def score(self, score: float | None, time_s: float) -> None:
        """Take the score at a time, None while the ring is not eligible."""
        if score is None:
            if time_s - self._scored_s > RELEASE_S:
                self.level = 0
            return
        measured = min(float(_LEVELS), max(1.0, _LEVELS + log(score) / _PER_LEVEL))
        step_s = max(0.0, time_s - self._scored_s)
        if self.level == 0:
            self._smoothed, self._since_s = measured, time_s
        elif step_s > 0.0:  # the mean of the scores until the smoothing time has passed
            share = step_s / (max(0.0, min(time_s - self._since_s, _SMOOTHING_S)) + step_s)
            self._smoothed += share * (measured - self._smoothed)
        self._scored_s = time_s
        if self.level == 0 or abs(self._smoothed - self.level) > _BAND:
            self.level = round(self._smoothed)


class _Known(NamedTuple):
    """The newest known bids of a peer, and their time in units of a stamp."""

    stamp: int
    bids: Bids


class _Heard(NamedTuple):
    """A neighbour's newest message: when it came, its stamp, and whom it hears, itself included, a bit for each."""

    time_s: float
    stamp: int
    hears: int


class Auction:
    """The auction of one vehicle: `receive` every message of a peer, `step` every tick, and publish the `payload`."""

    def __init__(self, vehicle_id: int, members: Sequence[int], places: Sequence[int]) -> None:
        """Take the own id, the ids of the team, itself included, and the number of places of each ring.

        Members and places are the same for all vehicles. Raises ValueError for an id that is not one of the members,
        members that are repeated or not from 1 to 254, more than 8 rings, and a ring without a place.
        """
        if len(set(members)) != len(members) or not set(members) <= set(range(1, ID_MAX + 1)):
            raise ValueError(f"members are different ids from 1 to {ID_MAX} (given: {list(members)})")
        if vehicle_id not in members:
            raise ValueError(f"vehicle {vehicle_id} is not one of the members {list(members)}")
        if len(places) > RINGS_MAX or any(each < 1 for each in places):
            raise ValueError(f"at most {RINGS_MAX} rings, each with a place or more (given: {list(places)})")
        self._id, self._members, self._places = vehicle_id, sorted(members), tuple(places)
        self._numbers = {each: number for number, each in enumerate(self._members)}
        self.settling_s: Final = HEARD_S + HOP_S * len(members)
        """More than the time in which a change reaches all of any team of this size; silent peers bid for so long."""
        self._row = Struct(f">BHB{len(places)}s")
        self._head_bytes = (len(members) + 7) // 8
        self._own = [_OwnBid() for _ in places]
        self._bids = Bids(None, bytes(len(places)))
        self._stamp = 0
        self._known: dict[int, _Known] = {}
        self._heard: dict[int, _Heard] = {}
        self._received: dict[int, bytes] = {}
        self._decided = -1
        self._choice: int | None = None
        self._chosen_s = 0.0
        self.revision = 0
        """How often bids have changed, the own or those of peers: a state with changed bids is due at once."""
        self.unplaced: frozenset[int] = frozenset()
        """The vehicles, this one included, that bid and have no place."""

    @property
    def payload_bytes(self) -> int:
        """The largest payload: 388 bytes for 32 members and 8 rings, 49 for 8 members and 2 rings."""
        return self._head_bytes + self._row.size * len(self._members)

    @property
    def bids(self) -> dict[int, Bids]:
        """The bids that the choice is made from, by vehicle, the own included."""
        return {self._id: self._bids} | {peer: known.bids for peer, known in self._known.items()}

    def receive(self, sender: int, payload: bytes, time_s: float) -> None:
        """Take the payload that a peer published; what is not newer than what is known changes nothing.

        Raises ValueError, and takes none of it, for a sender that is not a member, and a payload that no `Auction` of
        these members and places can publish.
        """
        if sender not in self._numbers:
            raise ValueError(f"the sender of bids, vehicle {sender}, is not one of the members {self._members}")
        if self._repeats(sender, payload, time_s):
            return
        rows = self._unpacked(payload, time_s)
        if not rows or rows[0][0] != sender:
            raise ValueError(f"the bids that vehicle {sender} published do not begin with its own")
        if sender == self._id:
            return
        stamp, heard = rows[0][1].stamp, self._heard.get(sender)
        if not self._is_current(stamp, time_s) or (heard is not None and stamp <= heard.stamp):
            return
        hears = int.from_bytes(payload[: self._head_bytes], "big")
        self._heard[sender], self._received[sender] = _Heard(time_s, stamp, hears), payload
        self._learn(sender, rows[0][1])
        for peer, relayed in rows[1:]:
            known = self._known.get(peer)
            is_newer = known is None or relayed.stamp > known.stamp
            if peer not in self._heard and peer != self._id and is_newer and self._is_current(relayed.stamp, time_s):
                self._learn(peer, relayed)

    def _repeats(self, sender: int, payload: bytes, time_s: float) -> bool:
        """Take a payload without relayed bids that differs from the sender's last in its stamp alone: most are such."""
        last, heard, known = self._received.get(sender, b""), self._heard.get(sender), self._known.get(sender)
        stamp_at = self._head_bytes + 1
        if (
            heard is None
            or known is None
            or len(payload) != len(last)
            or len(last) != self._head_bytes + self._row.size
        ):
            return False
        if payload[:stamp_at] != last[:stamp_at] or payload[stamp_at + 2 :] != last[stamp_at + 2 :]:
            return False
        stamp = _nearest(int.from_bytes(payload[stamp_at : stamp_at + 2], "big"), _units(time_s))
        if stamp > heard.stamp and self._is_current(stamp, time_s):
            self._heard[sender] = _Heard(time_s, stamp, heard.hears)
            self._known[sender] = _Known(stamp, known.bids)
        return True

    def step(self, scores: Mapping[int, float], time_s: float, assigned: int | None = None) -> int | None:
        """Return the ring to fly on, None for none, given the own scores for the rings that are eligible now.

        Scores are in (0, 1] (`ring_score`), by the ring's place in `places`. A vehicle that is `assigned` to a ring
        bids for this one before all that are not. Raises ValueError for other scores.
        """
        for ring, score in scores.items():
            if not 0 <= ring < len(self._places):
                raise ValueError(f"there is no ring {ring} among {len(self._places)}")
            if not 0.0 < score <= 1.0:
                raise ValueError(f"the score for ring {ring} is above 0 and at most 1 (given: {score})")
        self._forget(time_s)
        for ring, own in enumerate(self._own):
            own.score(scores.get(ring), time_s)
        is_settled = time_s - self._chosen_s >= self.settling_s
        levels = bytes(own.level for own in self._own)
        if assigned is not None:
            levels = bytes(
                _LEVELS if ring == assigned else min(level, _LEVELS - 1) for ring, level in enumerate(levels)
            )
        self._bid(Bids(self._choice if is_settled else self._bids.held, levels, assigned is not None))
        if self._decided != self.revision:
            self._decided = self.revision
            bids = self.bids
            found = assignment(bids, self._places)
            self.unplaced = frozenset(each for each, own in bids.items() if each not in found and any(own.levels))
            choice = found.get(self._id)
            if choice != self._choice:
                self._choice, self._chosen_s = choice, time_s
        return self._choice

    def payload(self, time_s: float) -> bytes:
        """Return what to publish in a state at a time, `payload_bytes` at most."""
        self._stamp = max(self._stamp + 1, _units(time_s))
        hears, heard_by_all = 1 << self._numbers[self._id], -1
        for peer, heard in self._heard.items():
            hears |= 1 << self._numbers[peer]
            heard_by_all &= heard.hears
        rows = [self._packed(self._id, _Known(self._stamp, self._bids))]
        rows += [self._packed(*row) for row in self._known.items() if not heard_by_all >> self._numbers[row[0]] & 1]
        return hears.to_bytes(self._head_bytes, "big") + b"".join(rows)

    def _bid(self, bids: Bids) -> None:
        if bids != self._bids:
            self._bids = bids
            self.revision += 1

    def _learn(self, peer: int, new: _Known) -> None:
        known = self._known.get(peer)
        if known is None or known.bids != new.bids:
            self.revision += 1
        self._known[peer] = new

    def _forget(self, time_s: float) -> None:
        """Forget the neighbours that are not heard any more, and the bids of peers that are silent."""
        for peer in [peer for peer, heard in self._heard.items() if time_s - heard.time_s > HEARD_S]:
            del self._heard[peer]
        for peer in [peer for peer, known in self._known.items() if not self._is_current(known.stamp, time_s)]:
            del self._known[peer]
            self.revision += 1

    def _is_current(self, stamp: int, time_s: float) -> bool:
        return -AHEAD_MAX_S * _PER_S <= _units(time_s) - stamp <= self.settling_s * _PER_S

    def _packed(self, peer: int, known: _Known) -> bytes:
        held = 0 if known.bids.held is None else known.bids.held + 1
        held |= _ASSIGNED_BIT * known.bids.is_assigned
        return self._row.pack(self._numbers[peer], known.stamp % _WRAP, held, known.bids.levels)

    def _unpacked(self, payload: bytes, time_s: float) -> list[tuple[int, _Known]]:
        """Return the peers and their bids; the stamps are those nearest to a time."""
        if len(payload) > self.payload_bytes or (len(payload) - self._head_bytes) % self._row.size:
            raise ValueError(f"{len(payload)} bytes are no bids of {len(self._members)} members for these rings")
        now, rows = _units(time_s), dict[int, _Known]()
        for number, stamp, flags, levels in self._row.iter_unpack(payload[self._head_bytes :]):
            peer = self._members[number] if number < len(self._members) else None
            if peer is None or peer in rows:
                raise ValueError(f"bids of member number {number}: there is none, or they are repeated")
            is_assigned, held = bool(flags & _ASSIGNED_BIT), flags & ~_ASSIGNED_BIT
            if held > len(self._places):
                raise ValueError(f"vehicle {peer} holds ring {held - 1} of {len(self._places)}")
            bids = Bids(None if held == 0 else held - 1, levels, is_assigned)
            rows[peer] = _Known(_nearest(stamp, now), bids)
        return list(rows.items())


def _nearest(stamp: int, now: int) -> int:
    """Return the time nearest to now of a stamp as it was sent."""
    return now - ((now - stamp + _WRAP // 2) % _WRAP - _WRAP // 2)


def _units(time_s: float) -> int:
    return round(time_s * _PER_S)
