"""Plans made from aims, and how plans are shifted and mixed."""

from math import hypot

import numpy as np

from agents.control.formation import Predecessor
from agents.control.plan import Plan, RingReport
from agents.situation.situation import Situation
from agents.team.messages import MemberState
from estimation.plant.model import Plant
from estimation.state import POSITION, Vector
from estimation.vectors import Pair


def shifted(plan: Plan, aim_m: Vector) -> Plan:
    """Return a plan with another aim (2,); the undisturbed aim, which peers receive, shifts by the same amount."""
    if aim_m is plan.aim_m:
        return plan
    undisturbed = plan.undisturbed_aim_m + (aim_m - plan.aim_m)
    return Plan(aim_m, undisturbed, plan.aim_rate_m_s, plan.qp, plan.velocity_m_s, plan.ring, plan.values)


def towards(goal_m: Vector, position_m: Vector, at_most_m: float) -> Vector:
    """Return the goal (2,), or the point towards it that is `at_most_m` from a position (2,)."""
    x, y = goal_m.tolist()
    from_x, from_y = position_m.tolist()
    away_m = hypot(x - from_x, y - from_y)
    return goal_m if away_m <= at_most_m else position_m + (goal_m - position_m) * (at_most_m / away_m)


def along(situation: Situation, place_m: Pair, plant: Plant, speed_m_s: float, ring: RingReport | None = None) -> Plan:
    """Return the plan to fly straight to a place, where it comes to rest.

    The aim leads by as much as makes the plant fly at the speed: a1/a0 times it.
    """
    lead_m = speed_m_s * min(axis.a1_per_s / axis.a0_per_s2 for axis in (plant.x, plant.y))
    aim = towards(np.array(place_m), situation.acting_motion[POSITION], lead_m)
    return Plan(aim - situation.compensation / plant.a0_per_s2, aim, np.zeros(2), ring=ring)


def resting(place_m: Vector, ring: RingReport | None = None) -> Plan:
    """Return the plan to stay at a place (2,)."""
    return Plan(place_m, place_m, np.zeros(2), velocity_m_s=(0.0, 0.0), ring=ring)


def extrapolated(member: MemberState, at_s: float) -> Predecessor:
    """Return a peer's motion and aim at a time, extrapolated at their published rates."""
    ahead_s = at_s - member.time_s
    (x, y), (x_rate, y_rate) = member.position_m, member.velocity_m_s
    (aim_x, aim_y), (aim_x_rate, aim_y_rate) = member.aim_m, member.aim_rate_m_s
    return Predecessor(
        np.array((x + x_rate * ahead_s, y + y_rate * ahead_s, x_rate, y_rate)),
        np.array((aim_x + aim_x_rate * ahead_s, aim_y + aim_y_rate * ahead_s)),
    )


def mixed(formation: Plan, ring: Plan, share: float) -> Plan:
    """Mix the aims of both tactics, u = (1 - s) u_formation + s u_encircle (paper, section 4)."""
    aim = (1.0 - share) * formation.aim_m + share * ring.aim_m
    undisturbed = (1.0 - share) * formation.undisturbed_aim_m + share * ring.undisturbed_aim_m
    return Plan(aim, undisturbed, ring.aim_rate_m_s, ring.qp, ring=ring.ring)
