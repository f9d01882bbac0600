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

    A motion (4,) is [x y x' y'] in metres and m/s, in the mission frame, right-handed with z up. Times are seconds on
    the team's clock.

    - `now_s`, `acting_s`: now, and when the next setpoint acts: after the delays of link and plant, on average.
    - `own`, `target`: the estimates of the own motion and of the target's for now; None while there is no target. In a
      mission of several targets it is that of the vehicle's ring.
    - `acting_motion` (4,), `acting_target` (4,): both at `acting_s`.
    - `acting_centre` (4,): the motion of the ring's centre at `acting_s`, None without a target: the target's, or that
      of a point that catches up with it after it was out of sight.
    - `acting_others`: the motions (4,) of the mission's other targets at `acting_s`, by name.
    - `polar`: the polar state about the centre for now; a planner computes its own, for `acting_s`.
    - `disturbance` (2,): the acceleration [m/s²] that adds to the plant's along x and y, at `acting_s`. `authority`, in
      (0, 1], is the share of feedback and compensation that the consistency of the own filter allows, and
      `compensation` (2,) the part of the disturbance to act against.
    - `height_m`: the own altitude above the mission's origin, from the newest telemetry.
    - `position_sigma_m`: the standard deviation of the own position, of the worse axis. It includes the offset between
      the team's frame and the autopilot's, of variance `offset_variance_m2` per axis.
    - `boundary_sigma_m`: that of the own position to what is fixed in the mission frame. It includes the shift of the
      team's frame, of variance `shift_variance_m2` per axis, which vehicles have in common.
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
        shift_variance_m2: float = 0.0,
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
        self.position_sigma_m: Final[float] = sqrt(own.position_sigma_m**2 + offset_variance_m2)
        self.boundary_sigma_m: Final[float] = sqrt(self.position_sigma_m**2 + shift_variance_m2)
        self.acting_others: Final = acting_others

    @property
    def compensation(self) -> Vector:
        """The part of the disturbance (2,) that setpoints compensate [m/s²]."""
        return self.disturbance if self.authority == 1.0 else self.disturbance * self.authority


def moved(motion: Vector, by_s: float) -> Vector:
    """Return a motion (4,) extrapolated at constant velocity."""
    x, y, x_rate, y_rate = motion.tolist()
    return np.array((x + x_rate * by_s, y + y_rate * by_s, x_rate, y_rate))
