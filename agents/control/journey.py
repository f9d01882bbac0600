"""The way of one vehicle to a place that an operator has named; there it holds, or lands.

It flies the shortest way around no-fly zones, at the formation's largest speed at most, in its own height. The guard
keeps fence, zones and the distance to others, so that it may come to rest before the place. It gives up after a while,
and holds where it is.
"""

from collections.abc import Iterable
from math import dist, hypot
from typing import Final, NamedTuple

from agents.control.aims import along
from agents.control.plan import Plan
from agents.control.return_and_land import ARRIVED_M, ARRIVED_M_S, WAY_EXTRA_S, WAY_SPEED_SHARE
from agents.safety.routes import way_of
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.team.messages import Goal, MemberState
from estimation.state import POSITION, VELOCITY
from estimation.vectors import Pair


class JourneyEnd(NamedTuple):
    """How the way to a place ended, as text, and whether the vehicle is there."""

    did: str
    has_arrived: bool = False


class Journey:
    """One vehicle's way to a place, from its first plan on."""

    def __init__(self, config: AgentConfig, place: Goal, origin: str, sent_s: float, height_m: float) -> None:
        """Take the place, the name of the operator who sends the vehicle there, when, and the height that it keeps."""
        self.place: Final = place
        self.origin: Final = origin
        self.sent_s: Final = sent_s
        self._vehicle_id = config.vehicle_id
        self._separation_m = config.safety.separation_m
        self.goal_m: Final[Pair] = (place.x_m, place.y_m)
        self._speed_m_s = config.formation.speed_max_m_s
        self._plant = config.plant
        self._height_m = height_m
        self._way = way_of(config, self._speed_m_s, height_m)
        self._until_s: float | None = None

    def change(self, config: AgentConfig) -> None:
        """Go on with the ring of another configuration: others may fly at other heights, but the zones are the same."""
        self._way = way_of(config, self._speed_m_s, self._height_m, before=self._way)

    def plan(self, situation: Situation) -> Plan:
        """Return the plan of this tick."""
        x, y = situation.acting_motion[POSITION].tolist()
        next_m = self.goal_m if self._way is None else self._way.next_m((x, y), self.goal_m)
        if self._until_s is None:
            way_m = max(dist((x, y), self.goal_m), 0.0 if self._way is None else self._way.length_m)
            self._until_s = situation.now_s + way_m / (WAY_SPEED_SHARE * self._speed_m_s) + WAY_EXTRA_S
        return along(situation, next_m, self._plant, self._speed_m_s)

    def end(self, situation: Situation, peers: Iterable[MemberState], stopped_by: str) -> JourneyEnd | None:
        """Return how it ends now, None while it goes on; `stopped_by` is the condition that stops the vehicle.

        Peers' goals are known only with their next states: of two vehicles that are sent to one place at about the same
        time the one that was sent later gives its way up, of the same time that of the larger id.
        """
        if stopped_by:
            return JourneyEnd(f"stops on its way: {stopped_by}")
        for peer in peers:
            if peer.goal is None or (peer.goal_s or 0.0, peer.sender) > (self.sent_s, self._vehicle_id):
                continue
            away_m = dist((peer.goal.x_m, peer.goal.y_m), self.goal_m)
            if away_m < self._separation_m:
                before = f"vehicle {peer.sender} was sent before to {away_m:.1f} m from there"
                return JourneyEnd(f"gives its way up, and holds where it is: {before}")
        if self._has_arrived(situation):
            return JourneyEnd(f"has arrived, and {'lands' if self.place.lands else 'holds'}", has_arrived=True)
        if self._until_s is not None and situation.now_s > self._until_s:
            return JourneyEnd("does not get there: holds where it is")
        return None

    def _has_arrived(self, situation: Situation) -> bool:
        """Return whether the vehicle is there, and almost at rest."""
        x, y = situation.own.mean[POSITION].tolist()
        is_slow = hypot(*situation.own.mean[VELOCITY].tolist()) < ARRIVED_M_S
        return is_slow and dist((x, y), self.goal_m) < ARRIVED_M
