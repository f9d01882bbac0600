"""The values passed between the stages of a tick: the estimated situation, and the task decided from it."""

from collections.abc import Mapping
from math import sqrt
from typing import Final

import numpy as np

from estimation.polar import Polar
from estimation.state import OwnEstimate, TargetEstimate, Vector

_NO_OTHERS: Final[Mapping[str, Vector]] = {}
"""The other targets of a mission of one."""


class Situation:
    """The estimates of a tick: those for now, and all motions (4,) at the moment when the next setpoint acts.

    The centre of the ring is the target's estimate, or a point that catches up with it (`TargetBlend`). `polar` is the
    vehicle's polar state about the centre now, for reports; the planner computes its own at the acting time.
    `authority`, in (0, 1], is the share of feedback and compensation that the consistency of the own filter allows;
    `height_m` is the altitude from the latest telemetry. Positions are in the team's frame (`TeamFrame`), which the
    autopilot's differs from by an offset of variance `offset_variance_m2` per axis; `position_sigma_m` is the standard
    deviation of the own position there, the larger one of the two axes. In a mission of several targets `target` is
    that of the vehicle's ring, and `acting_others` are the motions of the others, by name.
    """

    def __init__(
        self,
        now_s: float,
        acting_s: float,
        own: OwnEstimate,
        acting_motion: Vector,
        disturbance: Vector,
        target: TargetEstimate | None,
        polar: Polar | None,
        acting_target: Vector | None,
        acting_centre: Vector | None = None,
        authority: float = 1.0,
        height_m: float = 0.0,
        offset_variance_m2: float = 0.0,
        acting_others: Mapping[str, Vector] = _NO_OTHERS,
    ) -> None:
        self.now_s: Final = now_s
        self.acting_s: Final = acting_s
        self.own: Final = own
        self.acting_motion: Final = acting_motion
        self.disturbance: Final = disturbance
        self.target: Final = target
        self.polar: Final = polar
        self.acting_target: Final = acting_target
        self.acting_centre: Final = acting_centre
        self.authority: Final = authority
        self.height_m: Final = height_m
        self.position_sigma_m: Final = sqrt(own.position_sigma_m**2 + offset_variance_m2)
        self.acting_others: Final = acting_others

    @property
    def compensation(self) -> Vector:
        """The part of the disturbance (2,) that setpoints compensate."""
        return self.disturbance if self.authority == 1.0 else self.disturbance * self.authority


def moved(motion: Vector, by_s: float) -> Vector:
    """Return a motion (4,) extrapolated at constant velocity."""
    x, y, x_rate, y_rate = motion.tolist()
    return np.array((x + x_rate * by_s, y + y_rate * by_s, x_rate, y_rate))
