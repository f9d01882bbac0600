"""The plan stage: from the task of a tick to a plan, with the planners' state between ticks."""

from collections.abc import Callable
from math import cos, isfinite, sin
from re import compile as pattern
from typing import Final

import numpy as np

from agents.control.aims import mixed, resting
from agents.control.excitation import Exciter
from agents.control.journey import Journey
from agents.control.plan import NO_VALUES, Plan, PlannerError, PlannerFactory, RingReport
from agents.control.return_and_land import Homing
from agents.control.ring_flight import RingFlight
from agents.control.station_keeping import StationKeeping
from agents.control.transit import Transit
from agents.notes import LandingAside
from agents.ring.place import ring_place, weights_of
from agents.ring.reference import RingPoint
from agents.ring.transition import ShapedCoordinate
from agents.safety.landing import InTheWay, OtherVehicles
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.situation.task import Task
from agents.tactics import Tactic, mixing_share
from agents.team.messages import Goal
from agents.team.ring_members import FULL_RING
from agents.team.team import Team
from estimation.polar import polar_from_motion
from estimation.state import POSITION, Vector
from estimation.vectors import Pair

_PLANNED = (Tactic.FORMATION, Tactic.ENCIRCLE)
"""The tactics that a plug-in planner plans."""
_VALUE_NAME: Final = pattern(r"[A-Za-z][A-Za-z0-9_]{0,31}")


class Planner:
    """Plans one vehicle's flight in every tactic."""

    def __init__(self, config: AgentConfig, team: Team) -> None:
        self._team = team
        self._station = StationKeeping(config, team)
        self._ring = RingFlight(config, team)
        self._homing = Homing(config)
        self._transit = Transit(config)
        self._crosses = False
        self._exciter = None if config.excitation is None else Exciter(config, config.excitation)
        self._plans: dict[Tactic, Callable[[Situation], Plan]] = {
            Tactic.FORMATION: self._station.plan,
            Tactic.ENCIRCLE: self._encircle,
            Tactic.TRANSIT: self._cross,
            Tactic.PILOT_OVERRIDE: self._yield,
            Tactic.RETURN_AND_LAND: self._homing.plan,
            Tactic.ASIDE: self._step_aside,
        }
        if self._exciter is not None:
            self._plans[Tactic.EXCITE] = self._exciter.plan
        self._smoothing_time_s = config.encirclement.smoothing_time_s
        self._encircles = False
        self._engaged_s = -np.inf
        self._leaving_m: Vector | None = None
        self._hold_m: Vector | None = None
        self.journey: Journey | None = None
        """The way to a place that a holding vehicle is on."""
        self._left_ring = False

    @property
    def ring_rate_rad_s(self) -> float:
        """The angular rate at which the ring is flown; 0 off the ring."""
        return self._ring.rate_rad_s if self._encircles else 0.0

    @property
    def returns_home(self) -> bool:
        """Whether the return leads home, in its own layer."""
        return self._homing.returns

    def may_land(self, situation: Situation, others: OtherVehicles, time_scale: float) -> bool:
        """Return whether the return is over: see `Homing.may_land`."""
        return self._homing.may_land(situation, others, time_scale)

    def landing_obstacle(self, situation: Situation, others: OtherVehicles) -> InTheWay | None:
        """Return a vehicle past or onto which this one would land where it is, None if the place is free."""
        return self._homing.obstacle(situation, others)

    def landing_news(self) -> LandingAside | None:
        """Return what the vehicle does about a landing place that is not free, once."""
        return self._homing.news()

    @property
    def goal(self) -> Goal | None:
        """The place that the vehicle is on its way to, apart from its start: others keep away from it."""
        return self._homing.goal if self.journey is None else self.journey.place

    @property
    def goal_s(self) -> float | None:
        """When an operator sent it to its goal; None for a place to land aside, before which no way of others comes."""
        return None if self.journey is None else self.journey.sent_s

    def start(self, at_s: float) -> None:
        """Begin the mission line, or the programme of an identification flight, at `at_s`."""
        self._station.start(at_s)
        if self._exciter is not None:
            self._exciter.start(at_s)

    def begin(self, tactic: Tactic, *, to_home: bool) -> None:
        """Start a tactic; `to_home` returns home also if the mission lands in place."""
        self._hold_m = self.journey = None
        self._encircles = tactic is Tactic.ENCIRCLE
        if tactic is not Tactic.ENCIRCLE:
            self._crosses = tactic is Tactic.TRANSIT
        if tactic is Tactic.FORMATION:
            self._station.reset()
            self._left_ring = False
        if tactic is Tactic.ENCIRCLE:
            self._left_ring = True
            self._ring.reset()
        if tactic is Tactic.EXCITE and self._exciter is not None:
            self._exciter.reset()
        if tactic is Tactic.RETURN_AND_LAND:
            self._homing.reset(to_home=to_home)
        else:
            self._homing.stay()

    def reshape(self, config: AgentConfig) -> None:
        """Change the shape of the formation."""
        self._station.reshape(config)

    def change(self, config: AgentConfig) -> None:
        """Fly the ring of another configuration from now on."""
        self._ring.change(config)
        self._homing.change(config)
        self._station.change(config)
        self._transit.change(config)
        if self.journey is not None:
            self.journey.change(config)

    def leave_for(self, config: AgentConfig) -> None:
        """Fly another of the mission's rings from now on, once the vehicle is there."""
        self._ring.leave_for(config)
        self._homing.change(config)
        self._station.change(config)
        self._transit.change(config)

    @property
    def arrived(self) -> bool:
        """Whether the transit to another ring is over."""
        return self._transit.arrived

    def go(self, journey: Journey) -> None:
        """Go to a place, in the tactic hold."""
        self._hold_m, self.journey = None, journey

    def stay(self, at_m: Pair | None = None) -> None:
        """End the way to a place, and hold at a place, or where the vehicle is."""
        self._hold_m, self.journey = None if at_m is None else np.array(at_m), None

    def engage(self, now_s: float, leaving_m: Vector | None) -> None:
        """Start the transition to the ring: from the formation, or from a place (2,) off it."""
        self._engaged_s = now_s
        self._leaving_m = None if leaving_m is None else leaving_m.copy()

    def sent(self, *, guarded: bool) -> None:
        """Record whether the guard has changed the aim of the last plan."""
        self._ring.sent(guarded=guarded)

    def plan(self, task: Task) -> Plan:
        """Return the plan of the task's tactic."""
        return self._plans.get(task.tactic, self._rest)(task.situation)

    def _rest(self, situation: Situation) -> Plan:
        """Hold the place, or go to another one."""
        if self.journey is not None:
            return self.journey.plan(situation)
        return resting(self._held_m(situation))

    def _yield(self, situation: Situation) -> Plan:
        """Rest where the vehicle is: a pilot flies, the input is unknown, and its position approximates it."""
        return resting(situation.own.mean[POSITION])

    def _encircle(self, situation: Situation) -> Plan:
        """Encircle the centre, mixed with the plan of the tactic being left; without a target, hold."""
        mixing = mixing_share(situation.now_s - self._engaged_s, self._smoothing_time_s)
        if situation.acting_centre is None:
            return resting(self._held_m(situation), self._ring.report(mixing))
        ring = self._ring.plan(situation, situation.acting_centre, mixing)
        return ring if mixing >= 1.0 else mixed(self._left_behind(situation), ring, mixing)

    def _left_behind(self, situation: Situation) -> Plan:
        """Return the plan that the vehicle would have without engaging."""
        if self._crosses:
            return self._cross(situation)
        return self._station.plan(situation) if self._leaving_m is None else resting(self._leaving_m)

    def _cross(self, situation: Situation) -> Plan:
        """Fly to another ring; while its target is not known, hold."""
        plan = self._transit.plan(situation)
        if plan is None:
            return resting(self._held_m(situation))
        self._hold_m = None
        return plan

    def _step_aside(self, situation: Situation) -> Plan:
        """Leave the ring radially outwards until clear of it; outside it, or without a ring, hold.

        The others do not avoid a vehicle that they do not receive: it also keeps clear of an approaching ring.
        """
        isolated = not self._team.members() and bool(self._team.gone_s)
        if self._left_ring and situation.polar is not None and (self._hold_m is None or isolated):
            short_m = self._ring.clear_m(situation, isolated=isolated) - situation.polar.radius_m
            bearing_rad = situation.polar.bearing_rad
            if short_m > 0.0:
                self._hold_m = situation.own.mean[POSITION] + short_m * np.array([cos(bearing_rad), sin(bearing_rad)])
        return resting(self._held_m(situation))

    def _held_m(self, situation: Situation) -> Vector:
        if self._hold_m is None:
            self._hold_m = situation.own.mean[POSITION].copy()
        return self._hold_m


class PluggedPlanner(Planner):
    """Cordon's planner with a plug-in planner in front of it."""

    def __init__(self, config: AgentConfig, team: Team, factory: PlannerFactory) -> None:
        super().__init__(config, team)
        self._vehicle_id = config.vehicle_id
        self._gaps = config.gaps
        self._took_over = False
        self._start_s = 0.0
        self._names: frozenset[str] | None = None
        try:
            self._plugged = factory(config)
        except Exception as error:
            raise PlannerError(f"vehicle {self._vehicle_id}: {_named(error)}, as its planner is made") from error
        if not callable(getattr(self._plugged, "plan", None)):
            raise PlannerError(f"vehicle {self._vehicle_id}: its planner has no method plan (task): {self._plugged!r}")

    def begin(self, tactic: Tactic, *, to_home: bool) -> None:
        """See Planner."""
        super().begin(tactic, to_home=to_home)
        self._took_over = False

    def start(self, at_s: float) -> None:
        """See Planner."""
        super().start(at_s)
        self._start_s = at_s

    def plan(self, task: Task) -> Plan:
        """Return the plug-in planner's plan, else cordon's; raises PlannerError if it fails or its plan is unusable."""
        plan = self._asked(task) if task.tactic in _PLANNED else None
        if plan is None:
            if self._took_over:
                # The state of cordon's planner is outdated: restart it from the vehicle's motion.
                self.begin(task.tactic, to_home=self.returns_home)
            return super().plan(task)
        self._took_over = True
        centre = task.situation.acting_centre
        if task.tactic is Tactic.ENCIRCLE and plan.ring is None and centre is not None:
            report = self._report(task.situation, centre)
            return Plan(
                plan.aim_m, plan.undisturbed_aim_m, plan.aim_rate_m_s, plan.qp, plan.velocity_m_s, report, plan.values
            )
        return plan

    def _asked(self, task: Task) -> Plan | None:
        """Return the plug-in planner's plan with arrays of floats, None without one; raises PlannerError."""
        place = f"vehicle {self._vehicle_id}, {task.situation.now_s - self._start_s:.1f} s"
        try:
            plan = self._plugged.plan(task)
        except Exception as error:
            raise PlannerError(f"{place}: {_named(error)}, raised by its planner") from error
        if plan is None:
            return None
        if not isinstance(plan, Plan):
            raise PlannerError(f"{place}: its planner returned {plan!r}: return a cordon.Plan, or None")
        return Plan(
            _numbers(plan.aim_m, "aim_m", place),
            _numbers(plan.undisturbed_aim_m, "undisturbed_aim_m", place),
            _numbers(plan.aim_rate_m_s, "aim_rate_m_s", place),
            plan.qp,
            None if plan.velocity_m_s is None else _pair(_numbers(plan.velocity_m_s, "velocity_m_s", place)),
            plan.ring,
            self._checked_values(plan, place) if plan.values else NO_VALUES,
        )

    def _checked_values(self, plan: Plan, place: str) -> dict[str, float]:
        """Return the plan's values in order of their names; raises PlannerError for others than the flight's."""
        names = frozenset(plan.values)
        if self._names is None:
            for name in plan.values:
                if not _VALUE_NAME.fullmatch(str(name)):
                    raise PlannerError(f"{place}: values: {name!r}: a name has up to 32 letters, digits and _")
            self._names = names
        if names != self._names:
            changed = ", ".join(map(repr, sorted(names ^ self._names, key=repr)))
            raise PlannerError(f"{place}: values: {changed} come or go: their names stay the same in a flight")
        values: dict[str, float] = {}
        for name in sorted(names):
            try:
                values[name] = float(plan.values[name])
            except (TypeError, ValueError):
                values[name] = np.nan
            if not isfinite(values[name]):
                raise PlannerError(f"{place}: values[{name!r}] is {plan.values[name]!r}, not a finite number")
        return values

    def _report(self, situation: Situation, centre: Vector) -> RingReport:
        """Return the report of a vehicle on the mission's ring, with its own position as its reference."""
        polar, rate_rad_s = polar_from_motion(situation.acting_motion, centre), self.ring_rate_rad_s
        ring = self._team.ring
        bearings_rad = ring.bearings_rad(situation.acting_s, ring.ids)
        weights = weights_of((self._vehicle_id, *ring.ids), self._gaps)
        radius = ShapedCoordinate(polar.radius_m, polar.radial_speed_m_s)
        bearing = ShapedCoordinate(polar.bearing_rad, polar.angular_rate_rad_s)
        return RingReport(
            mixing=1.0,
            rate_rad_s=rate_rad_s,
            slowed="",
            needed=FULL_RING,
            joined=True,
            place=ring_place(polar.bearing_rad, bearings_rad, weights),
            reference=RingPoint(radius, bearing, situation.acting_s),
        )


def planner_of(config: AgentConfig, team: Team, factory: PlannerFactory | None) -> Planner:
    """Return one vehicle's planner: cordon's, with the factory's plug-in planner in front of it if there is one."""
    return Planner(config, team) if factory is None else PluggedPlanner(config, team, factory)


def _named(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _numbers(given: object, name: str, place: str) -> Vector:
    """Return a pair of numbers of a plan, also from a tuple or a list; raises PlannerError."""
    try:
        vector = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (2,) or not np.isfinite(vector).all():
        hint = "not two finite numbers; a planner without a solution returns None"
        raise PlannerError(f"{place}: {name} of its planner is {given!r}, {hint}")
    return vector


def _pair(vector: Vector) -> Pair:
    x, y = vector.tolist()
    return x, y
