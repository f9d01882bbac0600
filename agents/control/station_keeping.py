"""Station keeping in the formation: the peer or line to follow, and the route into the vehicle's slot.

A single vehicle that joins a formation in flight goes around it, then into its slot along a free lane. On a straight
route it would displace other vehicles, and those that keep station on them.
"""

from collections.abc import Collection, Sequence
from functools import lru_cache
from math import dist, hypot, inf
from typing import Final

import numpy as np

from agents.control.aims import extrapolated
from agents.control.formation import FormationPlanner, Predecessor, mission_line, predecessor_of
from agents.control.plan import Plan
from agents.safety.routes import REACHED_M, way_of
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.team.team import Team
from estimation.state import POSITION
from estimation.vectors import Pair

CLEAR: Final = 2.0
"""In separations: the distance from all slots at which a vehicle flies around them."""
_LANE: Final = 0.15
_LANE_KEPT: Final = 0.5
"""In separations: the largest offset from the middle of its lane when a vehicle turns in, and after that."""
_FROM = ((-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 0.0))
"""The directions of lanes; the first free one is taken: behind, left, right, ahead."""
SETTLED_M_S: Final = 0.3
"""A vehicle has arrived if its velocity differs from the formation's by less than this."""


class StationKeeping:
    """Plans one vehicle's flight in formation; its state is which vehicles have arrived, and which one it follows."""

    def __init__(self, config: AgentConfig, team: Team) -> None:
        self._take(config)
        self._team = team
        self._formation = FormationPlanner(config)
        self._start_s = inf
        self._predecessor_id: int | None = None
        self._in_place: set[int] = set()
        self._arrived = False
        self._way = way_of(config, config.formation.speed_max_m_s)

    def start(self, at_s: float) -> None:
        """Begin the mission line at `at_s`."""
        self._start_s = at_s

    def reset(self) -> None:
        """Restart, when the vehicle comes from another tactic."""
        self._formation.reset()
        self._arrived = False

    def reshape(self, config: AgentConfig) -> None:
        """Change the shape of the formation; every vehicle has to reach its new slot first."""
        self._take(config)
        self._formation.reset()
        self._in_place.clear()

    def change(self, config: AgentConfig) -> None:
        """Fly in the same formation as a part of another team, and come from the heights of another ring."""
        self._take(config)
        self._way = way_of(config, config.formation.speed_max_m_s, before=self._way)

    def plan(self, situation: Situation) -> Plan:
        """Plan relative to the predecessor, or to the mission's line."""
        config = self._config
        predecessor_id, offset = None, (0.0, 0.0)
        if (around_m := self._around_m(situation)) is not None:
            offset, self._arrived = around_m, False
        elif config.formation.station == "predecessor":
            formed = self._formed()
            offset = self._way_in(situation, formed)
            predecessor_id = self._predecessor(formed) if self._arrived else None
        if predecessor_id != self._predecessor_id:
            self._formation.reset()
            self._predecessor_id = predecessor_id
        if predecessor_id is None:
            predecessor = self._own_line(situation.acting_s)
        else:
            predecessor = extrapolated(self._team.member(predecessor_id), situation.acting_s)
            offset = self._slot_offset_m(config.vehicle_id, predecessor_id)
        plan = self._formation.plan(situation.acting_motion, situation.compensation, predecessor, offset)
        return Plan(plan.aim_m, plan.undisturbed_aim_m, self._line_rate_m_s, plan.status)

    def _take(self, config: AgentConfig) -> None:
        self._config = config
        # Needed in every tick, and constant until the formation changes its shape.
        self._slot_offset_m = lru_cache(config.slot_offset_m)
        self._line_rate_m_s = np.array((config.formation.speed_m_s, 0.0))

    def _way_in(self, situation: Situation, formed: Collection[int]) -> tuple[float, float]:
        """Return the next waypoint relative to the own slot, from far away around the vehicles that have arrived.

        The first vehicles, and all at the start, fly straight to their slots.
        """
        if self._arrived:
            return 0.0, 0.0
        config = self._config
        off_x, off_y = (situation.acting_motion - self._own_line(situation.acting_s).motion)[POSITION].tolist()
        self._arrived = hypot(off_x, off_y) < config.formation.spacing_m / 2.0
        if self._arrived or not formed:
            return 0.0, 0.0
        others_m = [self._slot_offset_m(each, config.vehicle_id) for each in formed]
        return way_point((off_x, off_y), others_m, config.safety.separation_m)

    def _around_m(self, situation: Situation) -> Pair | None:
        """Return the next place of the way around zones, relative to the own slot; None where the way is straight."""
        if self._way is None:
            return None
        slot_x, slot_y = self._own_line(situation.acting_s).motion[POSITION].tolist()
        x, y = situation.acting_motion[POSITION].tolist()
        is_near = dist((x, y), (slot_x, slot_y)) < REACHED_M
        if is_near or self._way.routes.is_straight((x, y), (slot_x, slot_y)):
            return None
        next_x, next_y = self._way.next_m((x, y), self._way.routes.free_m((slot_x, slot_y)))
        return next_x - slot_x, next_y - slot_y

    def _predecessor(self, formed: Collection[int]) -> int | None:
        config = self._config
        flying = frozenset((*formed, config.vehicle_id)).intersection(config.slots)
        return predecessor_of(config.vehicle_id, flying, config.slots, config.formation.leader)

    def _formed(self) -> set[int]:
        """Return the peers to keep station on: those that have reached their slots since they came to formation.

        A vehicle on its way to its slot is not followed, not even the leader: it would move its followers out of their
        slots.
        """
        flying, formation = set(self._team.in_formation()), self._config.formation
        self._in_place &= flying
        for vehicle_id in flying - self._in_place:
            member, (slot_x, slot_y) = self._team.member(vehicle_id), self._slot_m(vehicle_id)
            flown_m = formation.speed_m_s * max(member.time_s - self._start_s, 0.0)
            near = dist(member.position_m, (slot_x + flown_m, slot_y)) < formation.spacing_m / 2.0
            if near and dist(member.velocity_m_s, (formation.speed_m_s, 0.0)) < SETTLED_M_S:
                self._in_place.add(vehicle_id)
        return self._in_place

    def _slot_m(self, vehicle_id: int) -> tuple[float, float]:
        """Return a vehicle's slot at the mission's start."""
        config = self._config
        shift_x, shift_y = self._slot_offset_m(vehicle_id, config.formation.leader)
        return config.line_start_m[0] + shift_x, config.line_start_m[1] + shift_y

    def _own_line(self, at_s: float) -> Predecessor:
        """Return the mission line shifted to this vehicle's slot, so that a new leader continues without a jump."""
        config, flown_s = self._config, max(at_s - self._start_s, 0.0)
        return mission_line(config.plant, self._slot_m(config.vehicle_id), config.formation.speed_m_s, flown_s)


def way_point(off_m: Pair, others_m: Sequence[Pair], separation_m: float) -> Pair:
    """Return the next waypoint from `off_m`, both relative to the own slot; `others_m` are the other slots.

    It is the slot, (0, 0), once the vehicle is in its lane.
    """
    clear_m = CLEAR * separation_m
    x, y = next((lane for lane in _FROM if _free(lane, others_m, separation_m)), _FROM[0])
    # Coordinates along the lane (outwards) and across it.
    out_m, aside_m = off_m[0] * x + off_m[1] * y, off_m[1] * x - off_m[0] * y
    slots = [(a * x + b * y, b * x - a * y) for a, b in ((0.0, 0.0), *others_m)]
    out_most_m, right_m, left_m = max(s[0] for s in slots), min(s[1] for s in slots), max(s[1] for s in slots)
    lane_m = (_LANE if out_m >= out_most_m else _LANE_KEPT) * separation_m
    if abs(aside_m) <= lane_m and out_m >= -separation_m / 2.0:
        goal_m = 0.0, 0.0
    elif out_m >= out_most_m + clear_m / 2.0:
        goal_m = out_most_m + clear_m, 0.0
    elif right_m - clear_m / 2.0 < aside_m < left_m + clear_m / 2.0 and out_m < 0.0:
        goal_m = out_m, right_m - clear_m if aside_m - right_m < left_m - aside_m else left_m + clear_m
    else:
        goal_m = out_most_m + clear_m, aside_m
    return goal_m[0] * x - goal_m[1] * y, goal_m[0] * y + goal_m[1] * x


def _free(lane: Pair, others_m: Sequence[Pair], separation_m: float) -> bool:
    """Return whether no other slot lies in the lane to the own slot."""
    x, y = lane
    nearest_m = min((abs(b * x - a * y) for a, b in others_m if a * x + b * y > 0.0), default=inf)
    return nearest_m >= separation_m
