"""What the stages of a tick hand on: the situation that is estimated, and the task that is decided on it."""

from math import sqrt

import msgspec
import numpy as np

from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.polar import Polar
from estimation.state import OwnEstimate, TargetEstimate, Vector


class Situation(msgspec.Struct, frozen=True):
    """What is estimated in a tick: the estimates now, and all motions (4,) at the moment the next setpoint acts.

    The centre is that of the ring: the target's estimate, or what catches up with it (`TargetBlend`). `polar` is the
    polar state of the vehicle about the centre now: what is reported. The planner's own is at the acting moment.
    `authority`, in (0, 1], is the share of feedback and compensation that the consistency of the own filter allows;
    `height_m` is the vehicle's altitude as its telemetry gave it last; `offset_variance_m2` is the variance per axis of
    the autopilot's offset against the team's frame, in which all positions are (`TeamFrame`).
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
    height_m: float = 0.0
    offset_variance_m2: float = 0.0

    @property
    def compensation(self) -> Vector:
        """The part of the disturbance (2,) that setpoints are to make up for."""
        return self.disturbance if self.authority == 1.0 else self.disturbance * self.authority

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the own position, in the worse direction of the axes."""
        return sqrt(self.own.position_sigma_m**2 + self.offset_variance_m2)


class Task(msgspec.Struct, frozen=True):
    """What is decided in a tick: the tactic to fly in a situation, and the altitude layer to fly it at.

    `peers` are the newest states of the others, each from the moment in it: those far away are up to a second old.
    """

    tactic: Tactic
    situation: Situation
    layer_m: float
    peers: tuple[MemberState, ...]


def moved(motion: Vector, by_s: float) -> Vector:
    """Return a motion (4,) some time later at constant velocity."""
    x, y, x_rate, y_rate = motion.tolist()
    return np.array((x + x_rate * by_s, y + y_rate * by_s, x_rate, y_rate))
