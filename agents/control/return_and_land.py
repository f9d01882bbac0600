"""Return and land: separate altitude layers, the landing order, and when vehicles leave the take-off layers.

Returning vehicles first climb to their layers above all vehicles that still fly the mission, so their paths cross at
different heights only. The lowest lands first; no vehicle descends while one below it is still flying home. Where it
begins, a vehicle chooses the nearest of its places: its start, or a spot at a rally point, which is its own.

A vehicle never lands past one that does not evade, or onto one on the ground: it waits, and after `ASIDE_AFTER_S` it
flies in its layer to the nearest free place and lands there. Without such a place it waits on.
"""

from collections.abc import Collection
from math import dist, hypot, inf
from typing import Final

import numpy as np

from agents.control.aims import along
from agents.control.plan import Plan
from agents.notes import LandingAside
from agents.safety.landing import InTheWay, LandingPlaces, OtherVehicles
from agents.safety.routes import way_of
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.messages import Goal, MemberState
from estimation.state import POSITION, VELOCITY, Vector
from estimation.vectors import Pair

HEIGHT_TOLERANCE_M: Final = 1.0
ARRIVED_M: Final = 1.0
ARRIVED_M_S: Final = 0.5
IN_PLACE_M: Final = 1.0
"""The largest distance from its place in the line at which a vehicle counts as in place."""
APART: Final = 1.5
"""In separations: vehicles farther apart than this may land at the same time and fly at the same height."""
RECEIVED_AFTER_S: Final = 1.5
"""Within this time the states of peers whose mission ended at the same moment arrive."""
NOT_RECEIVED_LONGEST_S: Final = 10.0
LANDING_LONGEST_S: Final = 60.0
ASIDE_AFTER_S: Final = 30.0
"""How long a vehicle waits for its landing place to become free, until it lands aside."""
SOUGHT_EVERY_S: Final = 1.0
"""How often a place aside is searched for where there was none: it takes some milliseconds."""
WAY_SPEED_SHARE: Final = 0.4
WAY_EXTRA_S: Final = 30.0
"""A way that takes longer than at this share of the largest speed, and this time, is given up."""
_ON_THE_WAY = Tactic.RETURN_AND_LAND.value
_COMING_DOWN = (_ON_THE_WAY, Tactic.LAND.value)


class Homing:
    """Plans one vehicle's return, from the end of its mission to the moment when it may land."""

    def __init__(self, config: AgentConfig) -> None:
        self._config = config
        self._places = LandingPlaces(config)
        self._home_m: Pair | None = None
        self._aside_m: Pair | None = None
        self._aside_until_s = 0.0
        self._hindered_s: float | None = None
        self._sought_s = -inf
        self._news: LandingAside | None = None
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
        self._aside_m = self._hindered_s = None
        self._sought_s = -inf
        if self._way is not None:
            self._way.reset()

    def stay(self) -> None:
        """End the way to a place aside, with the tactic."""
        self._aside_m = None

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

    def may_land(self, situation: Situation, others: OtherVehicles, time_scale: float) -> bool:
        """Return whether the vehicle has arrived, or its time limit is over, and the place below is free.

        `time_scale` is mission seconds per wall second: peers' messages may take that much longer.
        """
        if self._began_s is None:
            return False
        if self._aside_m is not None:
            return self._may_land_aside(self._aside_m, situation, others)
        is_over = situation.now_s - self._began_s > self._limit_s
        if not is_over and not self._is_in_turn(situation, others.members, time_scale):
            return False
        obstacle = self._obstacle_here(situation, others)
        if obstacle is None:
            return True
        if is_over or not obstacle.comes_down:
            wanted_m = self._goal_m if self._there(situation) else _here_m(situation)
            self._wait_or_evade(wanted_m, obstacle, situation, others)
        return False

    @property
    def goal(self) -> Goal | None:
        """The place aside at which it lands, None without one: others keep away from it."""
        return None if self._aside_m is None else Goal(*self._aside_m, lands=True)

    def news(self) -> LandingAside | None:
        """Return what it does about a landing place that is not free, once."""
        news, self._news = self._news, None
        return news

    def obstacle(self, situation: Situation, others: OtherVehicles) -> InTheWay | None:
        """Return a vehicle past or onto which it would land where it is, None if the place is free."""
        return self._places.obstacle(_here_m(situation), situation, others)

    def _obstacle_here(self, situation: Situation, others: OtherVehicles) -> InTheWay | None:
        """Return that at its landing place, if it is there, or where it is."""
        at_goal = self._places.obstacle(self._goal_m, situation, others) if self._there(situation) else None
        return at_goal or self.obstacle(situation, others)

    def _is_in_turn(self, situation: Situation, peers: Collection[MemberState], time_scale: float) -> bool:
        """Return whether it has arrived, and no peer near or below lands before it."""
        assert self._began_s is not None
        here = situation.own.mean[POSITION]
        near_m = APART * self._config.safety.separation_m
        known = [(peer, dist(peer.position_m, here.tolist())) for peer in peers]
        since_s = situation.now_s - self._began_s
        awaited = since_s < RECEIVED_AFTER_S * time_scale and any(away_m < near_m for _, away_m in known)
        if awaited or not self._there(situation):
            return False
        return not any(self._waits_for(*each, near_m) for each in known)

    def _wait_or_evade(self, place_m: Pair, obstacle: InTheWay, situation: Situation, others: OtherVehicles) -> None:
        """Wait for a landing place to become free; then choose the free place that is nearest to it."""
        now_s = situation.now_s
        if self._hindered_s is None:
            self._hindered_s = now_s
            self._news = LandingAside(obstacle.text, waits_s=ASIDE_AFTER_S)
        if now_s - self._hindered_s < ASIDE_AFTER_S or now_s - self._sought_s < SOUGHT_EVERY_S:
            return
        self._sought_s = now_s
        aside_m = self._places.nearest_m(place_m, situation, others, from_landing_places=self.returns)
        if aside_m is None:
            return
        way_s = dist(_here_m(situation), aside_m) / (WAY_SPEED_SHARE * self._config.formation.speed_max_m_s)
        self._aside_m, self._aside_until_s = aside_m, now_s + way_s + WAY_EXTRA_S
        self._news = LandingAside(obstacle.text, aside_m)

    def _may_land_aside(self, aside_m: Pair, situation: Situation, others: OtherVehicles) -> bool:
        """Return whether it is at its place aside and that is free; choose another one if it is not, or not reached."""
        wanted_m = self._goal_m
        obstacle = self._places.obstacle(aside_m, situation, others) or self._chosen_by_other(aside_m, others)
        if obstacle is None and situation.now_s > self._aside_until_s:
            wanted_m, obstacle = _here_m(situation), InTheWay("the former place is out of reach")
        if obstacle is None:
            return self._there(situation) and self.obstacle(situation, others) is None
        self._wait_or_evade(wanted_m, obstacle, situation, others)
        return False

    def _chosen_by_other(self, aside_m: Pair, others: OtherVehicles) -> InTheWay | None:
        """Return a vehicle that lands before this one, and has chosen about the same place at the same time."""
        order = self._config.landing_order
        for peer in others.members:
            if peer.goal is None or peer.sender not in order or order.index(peer.sender) > self._number:
                continue
            away_m = dist((peer.goal.x_m, peer.goal.y_m), aside_m)
            if away_m < self._config.safety.separation_m:
                return InTheWay(f"vehicle {peer.sender} goes to a place {away_m:.1f} m away")
        return None

    def _there(self, situation: Situation) -> bool:
        if not self.returns and self._aside_m is None:
            return True
        speed_m_s = hypot(*situation.own.mean[VELOCITY].tolist())
        away_m = hypot(*(situation.own.mean[POSITION] - self._goal).tolist())
        return not self._rising and away_m < ARRIVED_M and speed_m_s < ARRIVED_M_S

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
        return np.array(self._goal_m if self._aside_m is None else self._aside_m)

    @property
    def _goal_m(self) -> Pair:
        """Where it lands if that place is free."""
        if self._home_m is not None:
            return self._home_m
        x, y = self._from_m.tolist()
        return x, y

    @property
    def _limit_s(self) -> float:
        way_s = self._length_m / self._config.formation.speed_max_m_s
        flying_s = self._config.rising_s + 2.0 * way_s if self.returns else RECEIVED_AFTER_S
        return flying_s + (self._number + 1) * LANDING_LONGEST_S


def _here_m(situation: Situation) -> Pair:
    x, y = situation.own.mean[POSITION].tolist()
    return x, y


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
