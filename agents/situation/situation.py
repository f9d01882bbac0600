"""What a tick decides on, and what comes of it: the situation and the wish, and how both are carried and mixed."""

import msgspec
import numpy as np

from estimation.polar import Polar
from estimation.state import (
    OwnEstimate,
    TargetEstimate,
    Vector,
    position_sigma_m,
)


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


def moved(motion: Vector, by_s: float) -> Vector:
    """Return a motion (4,) some time later at constant velocity."""
    x, y, x_rate, y_rate = motion.tolist()
    return np.array((x + x_rate * by_s, y + y_rate * by_s, x_rate, y_rate))
