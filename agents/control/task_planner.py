"""The seam for plug-in planners: in formation and on the ring they plan in place of cordon's own planner.

Estimates come before a planner as they do before cordon's own, and slew limit, guard and failsafes after it. What a
failsafe or an operator demands - hold, step aside, return, land - is always planned by cordon.
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

    A planner has the method of this class, and does not derive from it: installations compile it (`native_build.py`).
    """

    def plan(self, task: Task) -> Plan | None:
        """Return the plan of this tick; None lets cordon's own planner plan it, from where the vehicle is.

        `task.situation` holds the estimates, in metres of the mission frame, `task.peers` the newest states of the
        others. A plan on the ring without a `ring` reports the mission's ring, and the vehicle as one on it.

        An exception, or a plan with a number that is not finite, ends the flight: a simulation with that exception, an
        agent by landing the vehicle. A planner that has no solution in a tick returns None instead.
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
        """Return the plan of the planner in front, else cordon's; raises ValueError where a number is not finite."""
        plan = self._plugged.plan(task) if task.tactic in _PLANNED else None
        if plan is None:
            if self._took_over:
                # Cordon's own planner remembers a flight that did not go on: it begins where the vehicle is.
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
        """Return what peers are to know of a vehicle on the mission's ring: its reference is where it is."""
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
    """Return one vehicle's planner: cordon's own, with that of the factory in front if there is one."""
    return Planner(config, team) if factory is None else PluggedPlanner(config, team, factory(config))
