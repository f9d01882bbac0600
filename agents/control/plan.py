"""The plan of one tick: where a tactic sends the vehicle, and how plans are shifted and mixed."""

import msgspec
import numpy as np

from agents.control.encirclement import Approach
from agents.control.formation import Predecessor
from agents.control.lmpc import QpStatus
from agents.control.ring import RingPlace
from agents.team.messages import MemberState
from estimation.state import Vector
from estimation.vectors import Pair, clipped


class Plan(msgspec.Struct, frozen=True):
    """The aim (2,) a tactic wishes for, the same without disturbance, its rate (2,), and how it came about.

    The aim is the setpoint itself unless the plant takes a velocity beside it; `velocity_m_s` is the one to send then,
    None: the one that the plan leads to.
    """

    setpoint_m: Vector
    undisturbed_m: Vector
    rate_m_s: Vector
    place: RingPlace | None = None
    approach: Approach | None = None
    qp: QpStatus | None = None
    velocity_m_s: Pair | None = None


def shifted(plan: Plan, setpoint_m: Vector) -> Plan:
    """Return a wish that was changed into another setpoint: what peers are told of it changes as much."""
    if setpoint_m is plan.setpoint_m:
        return plan
    undisturbed = plan.undisturbed_m + (setpoint_m - plan.setpoint_m)
    return Plan(setpoint_m, undisturbed, plan.rate_m_s, plan.place, plan.approach, plan.qp, plan.velocity_m_s)


def towards(goal_m: Vector, position_m: Vector, at_most_m: float) -> Vector:
    """Return the goal (2,), or what lies on the way to it, `at_most_m` from a position."""
    way = goal_m - position_m
    reached = clipped(way, at_most_m)
    return goal_m if reached is way else position_m + reached


def extrapolated(member: MemberState, at_s: float) -> Predecessor:
    """Return a peer's motion and setpoint at a moment, each going on at its published rate."""
    ahead_s = at_s - member.time_s
    (x, y), (x_rate, y_rate) = member.position_m, member.velocity_m_s
    (wanted_x, wanted_y), (wanted_x_rate, wanted_y_rate) = member.setpoint_m, member.setpoint_rate_m_s
    return Predecessor(
        np.array((x + x_rate * ahead_s, y + y_rate * ahead_s, x_rate, y_rate)),
        np.array((wanted_x + wanted_x_rate * ahead_s, wanted_y + wanted_y_rate * ahead_s)),
    )


def mixed(formation: Plan, ring: Plan, share: float) -> Plan:
    """Mix both tactics' setpoints, u = (1 - s) u_formation + s u_encircle (paper, section 4)."""
    setpoint = (1.0 - share) * formation.setpoint_m + share * ring.setpoint_m
    return Plan(setpoint, setpoint, ring.rate_m_s, ring.place, ring.approach, ring.qp)
