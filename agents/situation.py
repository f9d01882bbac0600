"""What a tick decides on, and what comes of it: the situation and the wish, and how both are carried and mixed."""

from math import hypot

import msgspec
import numpy as np

from agents.barriers import Pair
from agents.encirclement import Approach
from agents.formation import Predecessor
from agents.linearize import Polar
from agents.lmpc import QpStatus
from agents.messages import MemberState
from agents.ring import RingPlace
from estimation.state import OwnEstimate, TargetEstimate, Vector, position_sigma_m


class Situation(msgspec.Struct, frozen=True):
    """What a tick decides on: the estimates now, and all motions (4,) at the moment the next setpoint acts.

    The centre is that of the ring: where the target is believed to be, or what catches up with it. Polar is about it.
    `authority`, in (0, 1], is the share of feedback and compensation that the model of the vehicle deserves.
    """

    now_s: float
    acting_s: float
    own: OwnEstimate
    acting_motion: Vector
    disturbance: Vector
    target: TargetEstimate | None
    polar: Polar | None
    acting_target: Vector | None
    acting_centre: Vector | None = None
    authority: float = 1.0

    @property
    def compensation(self) -> Vector:
        """The part of the disturbance (2,) that setpoints are to make up for."""
        return self.disturbance if self.authority == 1.0 else self.disturbance * self.authority

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the own position, in the worse direction of the axes."""
        return position_sigma_m(self.own.covariance)


class Wish(msgspec.Struct, frozen=True):
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


def moved(motion: Vector, by_s: float) -> Vector:
    """Return a motion (4,) some time later at constant velocity."""
    x, y, x_rate, y_rate = motion.tolist()
    return np.array((x + x_rate * by_s, y + y_rate * by_s, x_rate, y_rate))


def shifted(wish: Wish, setpoint_m: Vector) -> Wish:
    """Return a wish that was changed into another setpoint: what peers are told of it changes as much."""
    if setpoint_m is wish.setpoint_m:
        return wish
    undisturbed = wish.undisturbed_m + (setpoint_m - wish.setpoint_m)
    return Wish(setpoint_m, undisturbed, wish.rate_m_s, wish.place, wish.approach, wish.qp, wish.velocity_m_s)


def towards(goal_m: Vector, position_m: Vector, at_most_m: float) -> Vector:
    """Return the goal (2,), or what lies on the way to it, `at_most_m` from a position."""
    way = goal_m - position_m
    distance_m = hypot(*way.tolist())
    return goal_m if distance_m <= at_most_m else position_m + way * (at_most_m / distance_m)


def extrapolated(member: MemberState, at_s: float) -> Predecessor:
    """Return a peer's motion and setpoint at a moment, each going on at its published rate."""
    ahead_s = at_s - member.time_s
    (x, y), (x_rate, y_rate) = member.position_m, member.velocity_m_s
    (wanted_x, wanted_y), (wanted_x_rate, wanted_y_rate) = member.setpoint_m, member.setpoint_rate_m_s
    return Predecessor(
        np.array((x + x_rate * ahead_s, y + y_rate * ahead_s, x_rate, y_rate)),
        np.array((wanted_x + wanted_x_rate * ahead_s, wanted_y + wanted_y_rate * ahead_s)),
    )


def mixed(formation: Wish, ring: Wish, share: float) -> Wish:
    """Mix both tactics' setpoints, u = (1 - s) u_formation + s u_encircle (paper, section 4)."""
    setpoint = (1.0 - share) * formation.setpoint_m + share * ring.setpoint_m
    return Wish(setpoint, setpoint, ring.rate_m_s, ring.place, ring.approach, ring.qp)
