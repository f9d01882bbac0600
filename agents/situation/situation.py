"""The values passed between the stages of a tick: the estimated situation, and the task decided from it."""

from math import sqrt

import msgspec
import numpy as np

from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.polar import Polar
from estimation.state import OwnEstimate, TargetEstimate, Vector


class Situation(msgspec.Struct, frozen=True):
    """The estimates of a tick: those for now, and all motions (4,) at the moment when the next setpoint acts.

    The centre of the ring is the target's estimate, or a point that catches up with it (`TargetBlend`). `polar` is the
    vehicle's polar state about the centre now, for reports; the planner computes its own at the acting time.
    `authority`, in (0, 1], is the share of feedback and compensation that the consistency of the own filter allows;
    `height_m` is the altitude from the latest telemetry; `offset_variance_m2` is the variance per axis of the
    autopilot's offset from the team's frame, in which all positions are given (`TeamFrame`).
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
        """The part of the disturbance (2,) that setpoints compensate."""
        return self.disturbance if self.authority == 1.0 else self.disturbance * self.authority

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the own position, the larger one of the two axes."""
        return sqrt(self.own.position_sigma_m**2 + self.offset_variance_m2)


class Task(msgspec.Struct, frozen=True):
    """The decision of a tick: the tactic to fly in a situation, and the altitude layer.

    `peers` are the newest states of the others, each at its own time: those of distant peers are up to a second old.
    """

    tactic: Tactic
    situation: Situation
    layer_m: float
    peers: tuple[MemberState, ...]


def moved(motion: Vector, by_s: float) -> Vector:
    """Return a motion (4,) extrapolated at constant velocity."""
    x, y, x_rate, y_rate = motion.tolist()
    return np.array((x + x_rate * by_s, y + y_rate * by_s, x_rate, y_rate))
