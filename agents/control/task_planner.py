"""The interface of plug-in planners, which replace cordon's planner in formation and on the ring.

A plug-in planner receives the same estimates as cordon's; slew limit, guard and failsafes act after it. Tactics that a
failsafe or an operator demands - hold, step aside, return, land - are always planned by cordon.
"""

from collections.abc import Callable
from typing import Protocol

from agents.control.plan import Plan
from agents.settings.config import AgentConfig
from agents.situation.task import Task


class TaskPlanner(Protocol):
    """Plans one vehicle's flight in the tactics formation and encircle, tick by tick."""

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
