"""The ring of one vehicle among a mission's several: the rule of decision for each target, and the auction of places.

A vehicle bids for the rings whose targets it decides to encircle (paper, section 5), each by what the target is worth
and the time to get there. Once it has a ring it bids for this one alone, as long as the rule holds for its target. It
bids for the others as well when it loses its place, or when another vehicle has had none for long, and for those that
it would not choose with the least score. An operator may assign a ring: it then bids for this one before all others,
and keeps its own while there is no place.
"""

from collections.abc import Mapping
from math import hypot, inf
from typing import Final, NamedTuple

from agents.ring.auction import Auction, ring_score
from agents.settings.config import AgentConfig
from agents.settings.sections import DecisionSettings
from agents.team.messages import RingChoice
from estimation.state import TargetEstimate
from estimation.vectors import Pair

_LEAST, _OWN_LEAST = 1.0 / 512.0, 1.0 / 64.0
"""The scores of rings that a vehicle off the formation would not choose, and of its own one of these."""
_MARGIN: Final = 0.05
_FARTHER: Final = 1.1
"""By how much importance and threat may miss, and how much farther, in shares, a target may be once it was chosen: a
noisy estimate at a threshold must not change the bids.
"""
YIELDS_AFTER_S: Final = 10.0
YIELDS_S: Final = 5.0
"""After a vehicle has had no place for this long, those on rings bid for others as well, for so long: enough to agree
and to set out.
"""
SURE_S: Final = 1.0
"""A ring is chosen once the auction has given it to the vehicle for this long: by then it has its neighbours' bids."""


class Wanted(NamedTuple):
    """A ring that the vehicle is to fly, and whether an operator has assigned it."""

    ring: int
    assigned: bool


class RingChooser:
    """Chooses the ring of one vehicle; `assigned` is the number of the ring that an operator has assigned, or None."""

    def __init__(self, config: AgentConfig) -> None:
        self._vehicle_id, self._decision = config.vehicle_id, config.decision
        self._planned_m = [each.encirclement.radius_m for each in config.rings]
        self._auction = Auction(config.vehicle_id, config.slots, [each.places for each in config.rings])
        self._eligible: set[int] = set()
        self._won: int | None = None
        self._won_s = self._unplaced_s = self._yields_until_s = 0.0
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
        own = config.ring if on_ring else None
        # Where the target is not known, the vehicle could not fly there: it keeps its place until then.
        assigned = self.assigned
        if assigned is not None and config.rings[assigned].target not in targets:
            assigned = None
        away_m = {ring: self._away_m(config, ring, targets, position_m) for ring in range(len(config.rings))}
        eligible = {
            ring for ring in away_m if self._decides(ring, targets.get(config.rings[ring].target), away_m[ring])
        }
        self._eligible = eligible
        if own is not None and own in eligible and now_s >= self._yields_until_s:
            scores = {own: self._score(config, own, targets, 0.0)}
        elif assigned is not None and own is not None:
            scores = {own: _OWN_LEAST}
        else:
            scores = {
                ring: self._score(config, ring, targets, 0.0 if ring == own else away_m[ring]) for ring in eligible
            }
            if own is not None:
                scores = {ring: _LEAST for ring, far_m in away_m.items() if far_m < inf} | {own: _OWN_LEAST} | scores
        won = self._auction.step(scores, now_s, assigned)
        self._yield(now_s)
        if won != self._won:
            self._won, self._won_s = won, now_s
        if won is None:
            return None
        if now_s - self._won_s >= SURE_S:
            return Wanted(won, assigned == won)
        return None if own is None else Wanted(own, assigned=False)

    def _away_m(self, config: AgentConfig, ring: int, targets: Mapping[str, TargetEstimate], position_m: Pair) -> float:
        """Return the distance of a ring's target, less what the ring is larger than planned; infinite if not known.

        Vehicles engage from as far outside a larger ring as before.
        """
        target = targets.get(config.rings[ring].target)
        if target is None:
            return inf
        larger_m = max(0.0, config.rings[ring].encirclement.radius_m - self._planned_m[ring])
        return hypot(target.mean.item(0) - position_m[0], target.mean.item(1) - position_m[1]) - larger_m

    def _yield(self, now_s: float) -> None:
        """Bid for the other rings as well for some time, if the vehicle or, for long, another one has no place."""
        unplaced = self._auction.unplaced
        if not unplaced:
            self._unplaced_s = now_s
        elif self._vehicle_id in unplaced or now_s - self._unplaced_s >= YIELDS_AFTER_S:
            self._yields_until_s, self._unplaced_s = now_s + YIELDS_S, now_s

    def _decides(self, ring: int, target: TargetEstimate | None, away_m: float) -> bool:
        """Return whether the rule of decision holds for a ring's target, with a margin once it held."""
        return target is not None and _decides(target, away_m, self._decision, was_chosen=ring in self._eligible)

    def _score(self, config: AgentConfig, ring: int, targets: Mapping[str, TargetEstimate], away_m: float) -> float:
        """Return the score of a ring for whose target the rule holds: the time is that to the ring from outside."""
        target, flown = targets[config.rings[ring].target], config.rings[ring].encirclement
        time_s = max(0.0, away_m - self._planned_m[ring]) / flown.speed_max_m_s
        return max(ring_score(target.importance, target.threat, time_s), _OWN_LEAST)


def _decides(target: TargetEstimate, away_m: float, decision: DecisionSettings, *, was_chosen: bool) -> bool:
    margin, farther = (_MARGIN, _FARTHER) if was_chosen else (0.0, 1.0)
    return (
        target.importance > decision.importance_min - margin
        and target.threat < decision.threat_max + margin
        and away_m < farther * decision.distance_max_m
    )
