"""The interface of plug-in planners, which replace cordon's planner in formation and on the ring.

A plug-in planner receives the same estimates as cordon's; slew limit, guard and failsafes act after it. Tactics that a
failsafe or an operator demands - hold, step aside, return, land - are always planned by cordon.
"""

from collections.abc import Callable
from math import isfinite
from typing import Protocol

from agents.control.plan import Plan, RingReport
from agents.control.planner import Planner
from agents.ring.place import ring_place
from agents.ring.shaped_coordinate import ShapedCoordinate
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation, Task
from agents.tactics import Tactic
from agents.team.ring_scale import FULL_RING
from agents.team.team import Team
from estimation.polar import polar_from_motion
from estimation.state import Vector

_PLANNED = (Tactic.FORMATION, Tactic.ENCIRCLE)


class TaskPlanner(Protocol):
    """Plans one vehicle's flight in the tactics formation and encircle, tick by tick.

    A planner has this method but does not derive from this class, which installations compile (`native_build.py`).
    """

    def plan(self, task: Task) -> Plan | None:
        """Return the plan of this tick; with None cordon's planner plans it from the vehicle's present motion.

        `task.situation` holds the estimates in metres of the mission frame, `task.peers` the newest states of the
        others. For a plan on the ring without `ring`, the mission's ring is reported, and the vehicle as a member of
        it. An exception, or a plan with a number that is not finite, ends the flight: a simulation raises the
        exception, an agent lands the vehicle. A planner without a solution returns None.
        """
        ...


PlannerFactory = Callable[[AgentConfig], TaskPlanner]
"""Makes the planner of one vehicle from its configuration."""


class PluggedPlanner(Planner):
    """Cordon's planner with a plug-in planner in front of it."""

    def __init__(self, config: AgentConfig, team: Team, plugged: TaskPlanner) -> None:
        super().__init__(config, team)
        self._vehicle_id = config.vehicle_id
        self._plugged = plugged
        self._took_over = False

    def begin(self, tactic: Tactic, *, to_home: bool) -> None:
        """See Planner."""
        super().begin(tactic, to_home=to_home)
        self._took_over = False

    def plan(self, task: Task) -> Plan:
        """Return the plug-in planner's plan, else cordon's; raises ValueError if a number is not finite."""
        plan = self._plugged.plan(task) if task.tactic in _PLANNED else None
        if plan is None:
            if self._took_over:
                # The state of cordon's planner is outdated: restart it from the vehicle's motion.
                self.begin(task.tactic, to_home=self.returns_home)
            return super().plan(task)
        self._took_over = True
        self._refuse_unusable(plan, task.situation.now_s)
        centre = task.situation.acting_centre
        if task.tactic is Tactic.ENCIRCLE and plan.ring is None and centre is not None:
            report = self._report(task.situation, centre)
            return Plan(plan.aim_m, plan.undisturbed_aim_m, plan.aim_rate_m_s, plan.qp, plan.velocity_m_s, report)
        return plan

    def _refuse_unusable(self, plan: Plan, now_s: float) -> None:
        for name, vector in (
            ("aim_m", plan.aim_m.tolist()),
            ("undisturbed_aim_m", plan.undisturbed_aim_m.tolist()),
            ("aim_rate_m_s", plan.aim_rate_m_s.tolist()),
            ("velocity_m_s", [0.0, 0.0] if plan.velocity_m_s is None else list(plan.velocity_m_s)),
        ):
            if len(vector) != 2 or not all(map(isfinite, vector)):
                raise ValueError(
                    f"vehicle {self._vehicle_id}, {now_s:.1f} s: {name} of its planner is {vector}, "
                    "not two finite numbers; a planner without a solution returns None"
                )

    def _report(self, situation: Situation, centre: Vector) -> RingReport:
        """Return the report of a vehicle on the mission's ring, with its own position as its reference."""
        polar, rate_rad_s = polar_from_motion(situation.acting_motion, centre), self.ring_rate_rad_s
        return RingReport(
            mixing=1.0,
            rate_rad_s=rate_rad_s,
            slowed="",
            needed=FULL_RING,
            joined=True,
            place=ring_place(polar.bearing_rad, self._team.ring.bearings_rad(situation.acting_s, rate_rad_s)),
            reference=ShapedCoordinate(polar.bearing_rad, polar.angular_rate_rad_s),
        )


def planner_of(config: AgentConfig, team: Team, factory: PlannerFactory | None) -> Planner:
    """Return one vehicle's planner: cordon's, with the factory's plug-in planner in front of it if there is one."""
    return Planner(config, team) if factory is None else PluggedPlanner(config, team, factory(config))
