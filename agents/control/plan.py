"""The plan of one tick: the aim of a tactic, and how plans are shifted and mixed."""

import msgspec
import numpy as np

from agents.control.encirclement import Approach
from agents.control.formation import Predecessor
from agents.control.lmpc import QpStatus
from agents.ring.place import RingPlace
from agents.ring.shaped_coordinate import ShapedCoordinate
from agents.team.messages import MemberState
from agents.team.ring_scale import RingScale
from estimation.state import Vector
from estimation.vectors import Pair, clipped


class RingReport(msgspec.Struct, frozen=True):
    """The state of its ring that a vehicle in the tactic encircle puts into its status and sends to its peers.

    `mixing` is the share of the encirclement in the aim, `rate_rad_s` the angular rate at which the ring is flown.
    `slowed` states how the flown ring differs from the mission's and why, `news` any change of that, else None.
    `needed` is the ring that this vehicle can fly, `joined` whether it is a member of the ring; `place` and `approach`
    are None while it waits for a gap or has no target.
    """

    mixing: float
    rate_rad_s: float
    slowed: str
    needed: RingScale
    joined: bool
    place: RingPlace | None = None
    approach: Approach | None = None
    news: str | None = None
    reference: ShapedCoordinate | None = None


class Plan(msgspec.Struct, frozen=True):
    """The result of the planner: the aim (2,), the undisturbed aim (2,), its rate (2,), and how it was found.

    The aim is the input of the plant. The last stage makes it the setpoint: the same position, unless a velocity is fed
    forward with it. `velocity_m_s` is the velocity to feed forward; with None it follows from the aim. `ring` is None
    except in the tactic encircle.
    """

    aim_m: Vector
    undisturbed_aim_m: Vector
    aim_rate_m_s: Vector
    qp: QpStatus | None = None
    velocity_m_s: Pair | None = None
    ring: RingReport | None = None


def shifted(plan: Plan, aim_m: Vector) -> Plan:
    """Return a plan with another aim (2,); the undisturbed aim, which peers receive, shifts by the same amount."""
    if aim_m is plan.aim_m:
        return plan
    undisturbed = plan.undisturbed_aim_m + (aim_m - plan.aim_m)
    return Plan(aim_m, undisturbed, plan.aim_rate_m_s, plan.qp, plan.velocity_m_s, plan.ring)


def towards(goal_m: Vector, position_m: Vector, at_most_m: float) -> Vector:
    """Return the goal (2,), or the point towards it that is `at_most_m` from a position (2,)."""
    way = goal_m - position_m
    reached = clipped(way, at_most_m)
    return goal_m if reached is way else position_m + reached


def resting(place_m: Vector, ring: RingReport | None = None) -> Plan:
    """Return the plan to stay at a place (2,)."""
    return Plan(place_m, place_m, np.zeros(2), velocity_m_s=(0.0, 0.0), ring=ring)


def extrapolated(member: MemberState, at_s: float) -> Predecessor:
    """Return a peer's motion and aim at a time, extrapolated at their published rates."""
    ahead_s = at_s - member.time_s
    (x, y), (x_rate, y_rate) = member.position_m, member.velocity_m_s
    (aim_x, aim_y), (aim_x_rate, aim_y_rate) = member.setpoint_m, member.setpoint_rate_m_s
    return Predecessor(
        np.array((x + x_rate * ahead_s, y + y_rate * ahead_s, x_rate, y_rate)),
        np.array((aim_x + aim_x_rate * ahead_s, aim_y + aim_y_rate * ahead_s)),
    )


def mixed(formation: Plan, ring: Plan, share: float) -> Plan:
    """Mix the aims of both tactics, u = (1 - s) u_formation + s u_encircle (paper, section 4)."""
    aim = (1.0 - share) * formation.aim_m + share * ring.aim_m
    return Plan(aim, aim, ring.aim_rate_m_s, ring.qp, ring=ring.ring)
