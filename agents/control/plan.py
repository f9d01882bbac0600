"""The plan of one tick: the aim of a tactic, and the state of its ring."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, Protocol

import msgspec

from agents.control.encirclement import Approach
from agents.control.lmpc import QpStatus
from agents.notes import RingChange
from agents.ring.place import RingPlace
from agents.ring.reference import RingPoint
from agents.settings.config import AgentConfig
from agents.situation.task import Task
from agents.team.ring_members import RingScale
from estimation.state import Vector
from estimation.vectors import Pair


class RingReport(msgspec.Struct, frozen=True):
    """The state of its ring that a vehicle in the tactic encircle puts into its status and sends to its peers.

    `mixing` is the share of the encirclement in the aim, `rate_rad_s` the angular rate at which the ring is flown.
    `slowed` states how the flown ring differs from the mission's and why, `news` any change of that, else None.
    `needed` is the ring that this vehicle can fly, `joined` whether it is a member of the ring; `place` and `approach`
    are None while it waits for room or has no target, and so is the `reference` that it follows.
    """

    mixing: float
    rate_rad_s: float
    slowed: str
    needed: RingScale
    joined: bool
    place: RingPlace | None = None
    approach: Approach | None = None
    news: RingChange | None = None
    reference: RingPoint | None = None


NO_VALUES: Final[Mapping[str, float]] = MappingProxyType({})


class Plan(msgspec.Struct, frozen=True):
    """The result of the planner: the aim (2,), the undisturbed aim (2,), its rate (2,), and how it was found.

    The aim is the input of the plant. The last stage makes it the setpoint: the same position, unless a velocity is fed
    forward with it. The undisturbed aim, which peers receive, is the one that would move a plant without disturbance in
    the same way. All are in metres and m/s along x and y of the mission frame. `velocity_m_s` is the velocity to feed
    forward; with None it follows from the aim. `qp` and `ring` are of cordon's own planner: `ring` is None except in
    the tactic encircle. `values` are finite numbers of a user's planner, by short names, for the
    log, the channels and the report; all plans of a vehicle that have values have those of the same names.
    """

    aim_m: Vector
    undisturbed_aim_m: Vector
    aim_rate_m_s: Vector
    qp: QpStatus | None = None
    velocity_m_s: Pair | None = None
    ring: RingReport | None = None
    values: Mapping[str, float] = NO_VALUES


class PlannerError(Exception):
    """A user's planner raised an exception, or returned what is no plan; the text names vehicle and time."""


class TaskPlanner(Protocol):
    """Plans one vehicle's flight in the tactics formation and encircle, tick by tick."""

    def plan(self, task: Task) -> Plan | None:
        """Return the plan of this tick; with None cordon's planner plans it from the vehicle's present motion.

        `task.situation` holds the estimates in metres of the mission frame, `task.peers` the newest states of the
        others. For a plan on the ring without `ring`, the mission's ring is reported, and the vehicle as a member of
        it. An exception, or a plan with a number that is not finite, ends the flight: a simulation raises an
        InputError, an agent lands the vehicle. A planner without a solution returns None.
        """


PlannerFactory = Callable[[AgentConfig], TaskPlanner]
"""Makes the planner of one vehicle from its configuration."""
