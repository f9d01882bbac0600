"""Return and land: separate altitude layers, the landing order, and when vehicles leave the take-off layers.

Returning vehicles first climb to their layers above all vehicles that still fly the mission, so their paths cross at
different heights only. The lowest lands first; no vehicle descends while one below it is still flying home. Where it
begins, a vehicle chooses the nearest of its places: its start, or a spot at a rally point, which is its own.
"""

from collections.abc import Collection, Iterable
from math import dist, hypot

import numpy as np

from agents.control.aims import along
from agents.control.plan import Plan
from agents.safety.routes import way_of
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.state import POSITION, VELOCITY, Vector

HEIGHT_TOLERANCE_M = 1.0
ARRIVED_M, ARRIVED_M_S = 1.0, 0.5
IN_PLACE_M = 1.0
"""The largest distance from its place in the line at which a vehicle counts as in place."""
APART = 1.5
"""In separations: vehicles farther apart than this may land at the same time and fly at the same height."""
RECEIVED_AFTER_S = 1.5
"""Within this time the states of peers whose mission ended at the same moment arrive."""
NOT_RECEIVED_LONGEST_S = 10.0
LANDING_LONGEST_S = 60.0
_ON_THE_WAY = Tactic.RETURN_AND_LAND.value
_PILOTED = Tactic.PILOT_OVERRIDE.value
_COMING_DOWN = (_ON_THE_WAY, Tactic.LAND.value)


class Homing:
    """Plans one vehicle's return, from the end of its mission to the moment when it may land."""

    def __init__(self, config: AgentConfig) -> None:
        self._config = config
        self._home_m: tuple[float, float] | None = None
        self._number = config.landing_order.index(config.vehicle_id)
        self._began_s: float | None = None
        self._from_m: Vector = np.zeros(2)
        self._rising = True
        self._way = way_of(config, config.formation.speed_max_m_s)
        self._length_m = 0.0

    def change(self, config: AgentConfig) -> None:
        """Return from the heights of another ring from now on."""
        self._config = config
        self._way = way_of(config, config.formation.speed_max_m_s, before=self._way)

    @property
    def returns(self) -> bool:
        """Whether it flies home, in its own layer, before it lands."""
        return self._home_m is not None

    def reset(self, *, to_home: bool = False) -> None:
        """Restart with the next plan; `to_home` returns home also if the mission lands in place."""
        returns = to_home or self._config.choreography.landing == "return"
        self._home_m = self._config.home_m if returns else None
        self._began_s, self._rising = None, self.returns
        if self._way is not None:
            self._way.reset()

    def plan(self, situation: Situation) -> Plan:
        """Climb to the layer in place, then fly home by the shortest way; without a home, stay."""
        if self._began_s is None:
            self._began_s, self._from_m = situation.now_s, situation.own.mean[POSITION].copy()
            if self.returns:
                self._home_m = self._nearest_m()
            self._length_m = self._home_length_m()
        risen = abs(situation.height_m - self._config.return_altitude_m) < HEIGHT_TOLERANCE_M
        if risen and situation.now_s - self._began_s > self._config.rising_s:
            self._rising = False
        goal = self._from_m if self._rising else self._next_m(situation)
        return along(situation, (goal.item(0), goal.item(1)), self._config.plant, self._config.formation.speed_max_m_s)

    def may_land(self, situation: Situation, peers: Iterable[MemberState], time_scale: float) -> bool:
        """Return whether the vehicle has arrived and the airspace below is free, or its time limit is over.

        `time_scale` is mission seconds per wall second: peers' messages may take that much longer.
        """
        if self._began_s is None:
            return False
        since_s = situation.now_s - self._began_s
        if since_s > self._limit_s:
            return True
        here = situation.own.mean[POSITION]
        near_m = APART * self._config.safety.separation_m
        known = [(peer, dist(peer.position_m, here.tolist())) for peer in peers]
        awaited = since_s < RECEIVED_AFTER_S * time_scale and any(away_m < near_m for _, away_m in known)
        if awaited or not self._there(situation) or any(self._is_over_pilots(*each, situation) for each in known):
            return False
        return not any(self._waits_for(*each, near_m) for each in known)

    def _there(self, situation: Situation) -> bool:
        if not self.returns:
            return True
        speed_m_s = hypot(*situation.own.mean[VELOCITY].tolist())
        away_m = hypot(*(situation.own.mean[POSITION] - self._goal).tolist())
        return not self._rising and away_m < ARRIVED_M and speed_m_s < ARRIVED_M_S

    def _is_over_pilots(self, peer: MemberState, away_m: float, situation: Situation) -> bool:
        """Return whether it would land past a vehicle that a pilot flies: what lands is not guarded."""
        is_below = peer.altitude_m < situation.height_m
        return peer.tactic == _PILOTED and is_below and away_m < self._config.safety.separation_m

    def _waits_for(self, peer: MemberState, away_m: float, near_m: float) -> bool:
        order = self._config.landing_order
        if peer.tactic not in _COMING_DOWN or peer.sender not in order or order.index(peer.sender) >= self._number:
            return False
        return away_m < near_m or (self.returns and peer.tactic == _ON_THE_WAY)

    def _next_m(self, situation: Situation) -> Vector:
        """Return the goal, or the next place of the way around zones."""
        if self._way is None:
            return self._goal
        (x, y), (home_x, home_y) = situation.acting_motion[POSITION].tolist(), self._goal.tolist()
        return np.array(self._way.next_m((x, y), (home_x, home_y)))

    def _nearest_m(self) -> tuple[float, float] | None:
        """Return the landing place with the shortest way from where the return begins; without ways, the nearest."""
        from_x, from_y = self._from_m.tolist()
        goals = self._config.landing_places_m
        way = () if self._way is None else self._way.routes.way_m((from_x, from_y), goals)
        return min(goals, key=lambda goal: dist(goal, way[-1] if way else (from_x, from_y)))

    def _home_length_m(self) -> float:
        """Return the length of the way home from where the return began."""
        straight_m = hypot(*(self._goal - self._from_m).tolist())
        if self._way is None or straight_m == 0.0:
            return straight_m
        (x, y), (home_x, home_y) = self._from_m.tolist(), self._goal.tolist()
        self._way.next_m((x, y), (home_x, home_y))
        return max(straight_m, self._way.length_m)

    @property
    def _goal(self) -> Vector:
        return self._from_m if self._home_m is None else np.array(self._home_m)

    @property
    def _limit_s(self) -> float:
        way_s = self._length_m / self._config.formation.speed_max_m_s
        flying_s = self._config.rising_s + 2.0 * way_s if self.returns else RECEIVED_AFTER_S
        return flying_s + (self._number + 1) * LANDING_LONGEST_S


def assembled(
    config: AgentConfig, tactic: Tactic, position_m: Vector, peers: Collection[MemberState], flown_s: float
) -> bool:
    """Return whether every peer is in its place in the line, or well clear of this vehicle at (2,).

    Peers that have not been received yet are waited for until a timeout; `flown_s` is the time since the mission's
    start.
    """
    if len(peers) + 1 < len(config.starters) and flown_s < NOT_RECEIVED_LONGEST_S:
        return False
    here_x, here_y = position_m.tolist()
    for peer in peers:
        if tactic is Tactic.FORMATION and peer.tactic == tactic.value:
            x, y = config.slot_offset_m(peer.sender, config.vehicle_id)
            if dist(peer.position_m, (here_x + x, here_y + y)) > IN_PLACE_M:
                return False
        elif dist(peer.position_m, (here_x, here_y)) < APART * config.safety.separation_m:
            return False
    return True
