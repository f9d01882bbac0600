"""The ring of one vehicle among a mission's several: the rule of decision for each target, and the auction of places.

A vehicle bids for the rings whose targets it decides to encircle (paper, section 5), each by what the target is worth
and the time to get there. One that has left the formation bids for the others as well, with the least score: only where
it has no place otherwise does it fly on a ring that it would not choose. An operator may assign a ring, which is then
the only one that it bids for, with the highest score.
"""

from collections.abc import Mapping
from math import hypot
from typing import NamedTuple

from agents.ring.auction import Auction, ring_score
from agents.settings.config import AgentConfig
from agents.settings.sections import DecisionSettings
from agents.team.messages import RingChoice
from estimation.state import TargetEstimate
from estimation.vectors import Pair

_LEAST, _OWN_LEAST = 1.0 / 512.0, 1.0 / 64.0
"""The scores of rings that a vehicle off the formation would not choose, and of its own one of these."""
_MARGIN, _FARTHER = 0.05, 1.1
"""By how much importance and threat may miss, and how much farther, in shares, a target may be once it was chosen: a
noisy estimate at a threshold must not change the bids.
"""


SURE_S = 1.0
"""A ring is chosen once the auction has given it to the vehicle for this long: by then it has its neighbours' bids."""


class Wanted(NamedTuple):
    """A ring that the vehicle is to fly, and whether an operator has assigned it."""

    ring: int
    assigned: bool


class RingChooser:
    """Chooses the ring of one vehicle; `assigned` is the number of the ring that an operator has assigned, or None."""

    def __init__(self, config: AgentConfig) -> None:
        self._vehicle_id, self._decision = config.vehicle_id, config.decision
        self._targets = [each.target for each in config.rings]
        self._planned_m = [each.encirclement.radius_m for each in config.rings]
        self._auction = Auction(config.vehicle_id, config.slots, [each.places for each in config.rings])
        self._eligible: set[int] = set()
        self._won: int | None = None
        self._won_s = 0.0
        self.assigned: int | None = None

    @property
    def revision(self) -> int:
        """How often bids have changed: a state with changed bids is due at once."""
        return self._auction.revision

    def payload(self, now_s: float) -> bytes:
        """Return the bids to publish."""
        return self._auction.payload(now_s)

    def receive(self, sender: int, choice: RingChoice, now_s: float) -> bool:
        """Take a peer's bids; return False for bids that no vehicle of this mission publishes."""
        try:
            self._auction.receive(sender, choice.bids, now_s)
        except ValueError:
            return False
        return True

    def withdraw(self, now_s: float) -> None:
        """Bid for no ring any more, once a tick: others may have the vehicle's place."""
        self._won = self._auction.step({}, now_s)

    def choose(
        self,
        config: AgentConfig,
        position_m: Pair,
        targets: Mapping[str, TargetEstimate],
        now_s: float,
        *,
        on_ring: bool,
    ) -> Wanted | None:
        """Return the ring to fly, None for none.

        `config` has the rings as they are flown, and the number of the own one if the vehicle is `on_ring`, or on its
        way from one to another.
        """
        scores: dict[int, float] = {}
        for ring, each in enumerate(config.rings):
            target = targets.get(each.target)
            if self.assigned is not None and ring != self.assigned:
                continue
            if target is None:
                if on_ring and ring == config.ring:
                    scores[ring] = _OWN_LEAST  # it waits for its target to be seen again
                continue
            score = self._score(ring, target, position_m, config, on_ring=on_ring)
            if score is not None:
                scores[ring] = score
        won = self._auction.step(scores, now_s)
        if won != self._won:
            self._won, self._won_s = won, now_s
        if won is None:
            return None
        is_assigned = self.assigned == won
        if is_assigned or now_s - self._won_s >= SURE_S:
            return Wanted(won, is_assigned)
        return Wanted(config.ring, assigned=False) if on_ring else None

    def _score(
        self, ring: int, target: TargetEstimate, position_m: Pair, config: AgentConfig, *, on_ring: bool
    ) -> float | None:
        if self.assigned == ring:
            return 1.0
        flown = config.rings[ring].encirclement
        away_m = hypot(target.mean.item(0) - position_m[0], target.mean.item(1) - position_m[1])
        # Vehicles engage from as far outside a larger ring as before.
        farther_m = max(0.0, flown.radius_m - self._planned_m[ring])
        if _decides(target, away_m - farther_m, self._decision, was_chosen=ring in self._eligible):
            self._eligible.add(ring)
            is_own = on_ring and ring == config.ring
            time_s = 0.0 if is_own else max(0.0, away_m - flown.radius_m) / flown.speed_max_m_s
            return max(ring_score(target.importance, target.threat, time_s), _OWN_LEAST)
        self._eligible.discard(ring)
        if not on_ring:
            return None
        return _OWN_LEAST if ring == config.ring else _LEAST


def _decides(target: TargetEstimate, away_m: float, decision: DecisionSettings, *, was_chosen: bool) -> bool:
    margin, farther = (_MARGIN, _FARTHER) if was_chosen else (0.0, 1.0)
    return (
        target.importance > decision.importance_min - margin
        and target.threat < decision.threat_max + margin
        and away_m < farther * decision.distance_max_m
    )
