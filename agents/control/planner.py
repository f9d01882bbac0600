"""What each tactic wishes for: from the situation to a wish, and what has to be remembered from tick to tick."""

from collections.abc import Collection
from functools import lru_cache
from math import atan2, cos, dist, hypot, sin

import numpy as np

from agents.control.detour import Obstacle
from agents.control.encirclement import EncirclementPlanner
from agents.control.excitation_planner import Exciter
from agents.control.formation import (
    FormationPlanner,
    Predecessor,
    mission_line,
    predecessor_of,
)
from agents.control.homing import Homing
from agents.control.joining import Joining, place_before
from agents.control.plan import Plan, extrapolated, mixed
from agents.control.rejoining import way_point
from agents.control.ring import ring_place
from agents.control.ring_feasibility import Orbit, RingFeasibility
from agents.safety.barriers import unsure_m
from agents.safety.neighbours import Neighbours
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic, mixing_share
from agents.team.team import Team
from estimation.polar import polar_from_motion
from estimation.state import POSITION, VELOCITY, Vector

SETTLED_M_S = 0.3
"""Who flies at the formation's velocity to within this has arrived."""
_STANDING = frozenset((Tactic.HOLD.value, Tactic.ASIDE.value, Tactic.LAND.value, Tactic.PILOT_OVERRIDE.value))
"""Members in these tactics stand where they are: the ring goes around them."""


class Planner:
    """Plans one vehicle's flight in every tactic."""

    def __init__(self, config: AgentConfig, team: Team) -> None:
        self._take(config)
        self._team = team
        self._formation = FormationPlanner(config)
        self._encirclement = EncirclementPlanner(config)
        self.ring_feasibility = RingFeasibility(config)
        self._news: list[str] = []
        self._joining = Joining(config)
        self._neighbours = Neighbours(config)
        self.homing = Homing(config)
        self._exciter = None if config.excitation is None else Exciter(config, config.excitation)
        self._start_s = np.inf
        self._engaged_s = -np.inf
        self._leaving_m: Vector | None = None
        self._hold_m: Vector | None = None
        self._predecessor_id: int | None = None
        self._in_place: set[int] = set()
        self._left_ring = False
        self._arrived = False

    @property
    def joined(self) -> bool:
        """Whether the vehicle counts as one on the ring."""
        return self._joining.joined

    def start(self, at_s: float) -> None:
        """Let the mission's line, or the programme of a flight for identification, begin at `at_s`."""
        self._start_s = at_s
        if self._exciter is not None:
            self._exciter.start(at_s)

    def begin(self, tactic: Tactic, *, to_home: bool) -> None:
        """Begin a tactic anew, with nothing left of what was planned before; coming down may have to be `to_home`."""
        self._hold_m = None
        if tactic is Tactic.FORMATION:
            self._formation.reset()
            self._arrived = self._left_ring = False
        if tactic is Tactic.ENCIRCLE:
            self._left_ring = True
            self._encirclement.reset()
            self.ring_feasibility.reset()
            self._joining.reset()
        if tactic is Tactic.EXCITE and self._exciter is not None:
            self._exciter.reset()
        if tactic is Tactic.RETURN_AND_LAND:
            self.homing.reset(to_home=to_home)

    def reshape(self, config: AgentConfig) -> None:
        """Take a formation of another shape: nobody is in place until it is in its new one."""
        self._take(config)
        self._formation.reset()
        self._in_place.clear()

    def _take(self, config: AgentConfig) -> None:
        self._config = config
        # Asked for in every tick, and always the same until the formation changes its shape.
        self._slot_offset_m = lru_cache(config.slot_offset_m)
        self._line_rate_m_s = np.array((config.formation.speed_m_s, 0.0))

    def engage(self, now_s: float, leaving_m: Vector | None) -> None:
        """Begin to leave for the ring: from the formation, or (2,) from a place of its own."""
        self._engaged_s = now_s
        self._leaving_m = None if leaving_m is None else leaving_m.copy()

    def mixing_share(self, tactic: Tactic, now_s: float) -> float:
        """Return the share of the encirclement in the setpoint."""
        if tactic is not Tactic.ENCIRCLE:
            return 0.0
        return mixing_share(now_s - self._engaged_s, self._config.encirclement.smoothing_time_s)

    def plan(self, tactic: Tactic, situation: Situation, height_m: float) -> Plan:
        """Return where a tactic wants to go; `height_m` is where the vehicle is."""
        if tactic is Tactic.FORMATION:
            return self._form(situation)
        if tactic is Tactic.ENCIRCLE and situation.acting_centre is not None:
            ring = self._encircle(situation, situation.acting_centre, height_m)
            share = self.mixing_share(tactic, situation.now_s)
            return ring if share >= 1.0 else mixed(self._left_behind(situation), ring, share)
        if tactic is Tactic.EXCITE and self._exciter is not None:
            return self._exciter.plan(situation)
        if tactic is Tactic.PILOT_OVERRIDE:
            # Somebody else flies: all that is known of the vehicle's input is that it is near where the vehicle is.
            return _resting(situation.own.mean[POSITION])
        if tactic is Tactic.RETURN_AND_LAND:
            return self.homing.plan(situation, height_m)
        return self._step_aside(situation) if tactic is Tactic.ASIDE else self._hold(situation)

    def _left_behind(self, situation: Situation) -> Plan:
        """Return what a vehicle would do had it not engaged."""
        return self._form(situation) if self._leaving_m is None else _resting(self._leaving_m)

    def _form(self, situation: Situation) -> Plan:
        config = self._config
        predecessor_id, offset = None, (0.0, 0.0)
        if config.formation.station == "predecessor":
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
        return Plan(plan.setpoint_m, plan.undisturbed_setpoint_m, self._line_rate_m_s, qp=plan.status)

    def _way_in(self, situation: Situation, formed: Collection[int]) -> tuple[float, float]:
        """Return where to go relative to its slot: a vehicle that is far from it goes around those that have arrived.

        The first ones, and all at the start, go straight.
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

    def _predecessor(self, formed: Collection[int]) -> int | None:
        config = self._config
        flying = frozenset((*formed, config.vehicle_id)).intersection(config.slots)
        return predecessor_of(config.vehicle_id, flying, config.slots, config.formation.leader)

    def _formed(self) -> set[int]:
        """Return the peers to keep station on: those that have arrived, near their slots, since they came to formation.

        Whoever comes from elsewhere would lead others astray, be it the leader itself: it is not followed on its way.
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
        """Return where a vehicle's slot is when the mission starts."""
        config = self._config
        shift_x, shift_y = self._slot_offset_m(vehicle_id, config.formation.leader)
        return config.line_start_m[0] + shift_x, config.line_start_m[1] + shift_y

    def _own_line(self, at_s: float) -> Predecessor:
        """Return the mission line, shifted to this vehicle's own slot: a successor leads on without a jump."""
        config, flown_s = self._config, max(at_s - self._start_s, 0.0)
        return mission_line(config.plant, self._slot_m(config.vehicle_id), config.formation.speed_m_s, flown_s)

    def news(self) -> list[str]:
        """Return what is new about the ring, for people, since the last time."""
        news, self._news = self._news, []
        return news

    def _encircle(self, situation: Situation, centre: Vector, height_m: float) -> Plan:
        polar = polar_from_motion(situation.acting_motion, centre)
        orbit = self._orbit(situation.now_s, hypot(*centre[VELOCITY].tolist()))
        bearings_rad = self._team.bearings_rad(situation.acting_s, orbit.angular_rate_rad_s)
        gap = self._joining.look(polar, bearings_rad)
        place = ring_place(polar.bearing_rad, bearings_rad) if gap is None else place_before(gap)
        radius_m = self._joining.radius_m(polar, place) if gap is None else self._joining.waiting_m
        plan = self._encirclement.plan(
            situation.acting_motion,
            centre,
            situation.compensation,
            place,
            orbit,
            authority=situation.authority,
            radius_m=radius_m,
            obstacles=self._obstacles(situation, centre, height_m),
        )
        return Plan(
            plan.setpoint_m,
            plan.setpoint_m,
            situation.acting_motion[VELOCITY],
            place if gap is None else None,
            plan.approach,
            plan.status,
        )

    def _orbit(self, now_s: float, target_m_s: float) -> Orbit:
        """Return the ring of this moment: the one that all on it fly. Who waits outside takes it over without delay."""
        told = self.ring_feasibility.find(target_m_s, self._team.shares(), now_s, joined=self._joining.joined)
        if told is not None:
            self._news.append(told or "ring as the mission asks for it")
        self._joining.ring_m = self.ring_feasibility.orbit.radius_m
        return self.ring_feasibility.orbit

    def _obstacles(self, situation: Situation, centre: Vector, height_m: float) -> list[Obstacle]:
        """Return what stands in the ring's way: who was lost there, and who does not fly on."""
        standing = [member for member in self._team.members() if member.tactic in _STANDING]
        lost = self._team.lost(situation.now_s, self._config.safety.lost_avoided_s)
        if not (standing or lost):
            return []
        bodies = self._neighbours.bodies(situation, height_m, standing, lost)
        centre_x, centre_y = centre[POSITION].tolist()
        away_m = [(body.position_m[0] - centre_x, body.position_m[1] - centre_y) for body in bodies]
        return [
            Obstacle(atan2(y, x), max(hypot(x, y), self._config.encirclement.radius_min_m), body.distance_m)
            for body, (x, y) in zip(bodies, away_m, strict=True)
        ]

    def _step_aside(self, situation: Situation) -> Plan:
        """Leave the ring straight outwards, to where it is in nobody's way; outside of it, or without one, hold.

        The others cannot mind one that they do not hear: it keeps clear of a ring that comes after it.
        """
        unheard = not self._team.members() and bool(self._team.gone_s)
        if self._left_ring and situation.polar is not None and (self._hold_m is None or unheard):
            short_m = self._clear_m(situation, unheard=unheard) - situation.polar.radius_m
            bearing_rad = situation.polar.bearing_rad
            if short_m > 0.0:
                self._hold_m = situation.own.mean[POSITION] + short_m * np.array([cos(bearing_rad), sin(bearing_rad)])
        return self._hold(situation)

    def _clear_m(self, situation: Situation, *, unheard: bool) -> float:
        """Return the radius from which on a vehicle is in nobody's way."""
        if not unheard:
            return self._joining.waiting_m
        sigma_m = situation.position_sigma_m
        return self._joining.unheard_m(unsure_m(self._config.safety.uncertainty_sigmas, sigma_m, sigma_m))

    def _hold(self, situation: Situation) -> Plan:
        if self._hold_m is None:
            self._hold_m = situation.own.mean[POSITION].copy()
        return _resting(self._hold_m)


def _resting(place_m: Vector) -> Plan:
    return Plan(place_m, place_m, np.zeros(2), velocity_m_s=(0.0, 0.0))
