"""The motion of a stub vehicle: the identified plant horizontally, a bounded response vertically, and the ground.

The horizontal plant is exact, or shaped: with bounded speed, acceleration and jerk.

Mission frame (z up), metres, seconds; heading clockwise from north. Flight modes are in modes.py.
"""

from dataclasses import dataclass
from math import pi

import numpy as np

from estimation.frames import Triple
from estimation.plant.model import Plant, exact_step
from estimation.state import POSITION, VELOCITY, Vector
from estimation.vectors import wrap_signed_rad
from sitl.vehicle.shaping import ShapedStep, ShapeLimits

STEP_S = 0.02
"""The physics step, which is also the shortest telemetry interval."""

GRAVITY_M_S2 = 9.81
CLIMB_GAIN_PER_S = 0.62
"""Climb rate per metre of altitude error: a take-off to 4 m takes 8.6 s, as measured on PX4."""
CLIMB_RATE_GAIN_PER_S = 4.0
CLIMB_ACCELERATION_MAX_M_S2 = 3.0
YAW_RATE_MAX_RAD_S = pi / 4


@dataclass(frozen=True, slots=True)
class Target:
    """The target of the motion: mission position (x, y), altitude, heading (None keeps it), and the speed limits.

    `velocity_m_s` is the feed-forward velocity (x, y, ...), empty if none was sent.
    """

    position_m: tuple[float, float]
    altitude_m: float
    heading_rad: float | None
    climb_max_m_s: float
    sink_max_m_s: float
    velocity_m_s: tuple[float, ...] = ()


class Airframe:
    """The moving body. It stands on the ground until it has a target above."""

    def __init__(self, plant: Plant, start_m: Triple, shape: ShapeLimits | None = None) -> None:
        """Stand at `start_m`, which is on the ground; without a `shape` the motion is the linear plant's."""
        self._plant = plant
        self._step = exact_step(plant, STEP_S)
        self._shaped = None if shape is None else ShapedStep(plant, STEP_S, shape)
        self._motion: Vector = np.array([start_m[0], start_m[1], 0.0, 0.0])
        self._ground_m = start_m[2]
        self._altitude_m = start_m[2]
        self._climb_m_s = 0.0
        self._acceleration_m_s2 = (0.0, 0.0)
        self.heading_rad = 0.0
        self.heading_rate_rad_s = 0.0

    @property
    def position_m(self) -> Triple:
        """True position."""
        x, y = self._motion[POSITION].tolist()
        return x, y, self._altitude_m

    @property
    def velocity_m_s(self) -> Triple:
        """True velocity."""
        x, y = self._motion[VELOCITY].tolist()
        return x, y, self._climb_m_s

    @property
    def acceleration_m_s2(self) -> tuple[float, float]:
        """Horizontal acceleration over the last step, which determines the tilt."""
        return self._acceleration_m_s2

    @property
    def height_m(self) -> float:
        """Height above the ground."""
        return self._altitude_m - self._ground_m

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle stands on the ground."""
        return self._altitude_m <= self._ground_m

    def fly(self, target: Target, disturbance_m_s2: Vector) -> None:
        """Move one step under power towards `target`; `disturbance_m_s2` (2,) acts once airborne."""
        self._climb(target)
        self._turn(target.heading_rad)
        if self.on_ground:
            self._stand()
            return
        before = self._motion
        aim_m = self._plant.aim_m(target.position_m, target.velocity_m_s)
        if self._shaped is None:
            self._motion = self._step.advance(before, aim_m, disturbance_m_s2)
        else:
            x, y, x_rate, y_rate = before.tolist()
            (aim_x, aim_y), (push_x, push_y) = aim_m.tolist(), disturbance_m_s2.tolist()
            last = self._acceleration_m_s2
            motion = self._shaped.advance((x, y, x_rate, y_rate), last, (aim_x, aim_y), (push_x, push_y))
            self._motion = np.array(motion)
        x, y = ((self._motion[VELOCITY] - before[VELOCITY]) / STEP_S).tolist()
        self._acceleration_m_s2 = (x, y)

    def fall(self) -> None:
        """Move one step without power: stand on the ground, or drop to it."""
        self.heading_rate_rad_s = 0.0
        self._climb_m_s -= GRAVITY_M_S2 * STEP_S
        self._settle()
        if self.on_ground:
            self._stand()
        else:
            self._motion[POSITION] += self._motion[VELOCITY] * STEP_S

    def _climb(self, target: Target) -> None:
        fed = target.velocity_m_s[2] if target.velocity_m_s else 0.0
        wanted = fed + CLIMB_GAIN_PER_S * (target.altitude_m - self._altitude_m)
        bounded = min(max(wanted, -target.sink_max_m_s), target.climb_max_m_s)
        acceleration = CLIMB_RATE_GAIN_PER_S * (bounded - self._climb_m_s)
        limit = CLIMB_ACCELERATION_MAX_M_S2
        self._climb_m_s += min(max(acceleration, -limit), limit) * STEP_S
        self._settle()

    def _settle(self) -> None:
        """Integrate the climb, stopped by the ground."""
        self._altitude_m += self._climb_m_s * STEP_S
        if self._altitude_m <= self._ground_m:
            self._altitude_m = self._ground_m
            self._climb_m_s = 0.0

    def _stand(self) -> None:
        self._motion[VELOCITY] = 0.0
        self._acceleration_m_s2 = (0.0, 0.0)

    def _turn(self, heading_rad: float | None) -> None:
        error = 0.0 if heading_rad is None or self.on_ground else wrap_signed_rad(heading_rad - self.heading_rad)
        limit = YAW_RATE_MAX_RAD_S * STEP_S
        turn = min(max(error, -limit), limit)
        self.heading_rad = wrap_signed_rad(self.heading_rad + turn)
        self.heading_rate_rad_s = turn / STEP_S
