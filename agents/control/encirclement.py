"""Encirclement: LMPC on the linearised polar model, and the aim by feedback linearisation.

Polar coordinates about the target, and the feedback linearisation that makes them double integrators.

They describe the motion relative to the target, and so include the target's velocity (docs/notes/paper.md).
"""

from collections.abc import Sequence
from enum import Enum
from math import cos, sin
from typing import Final

import numpy as np

from agents.control.lmpc import Bounds, Lmpc, QpStatus, StateBound
from agents.control.lmpc_cost import ring_programme
from agents.ring.bent_ring import RingBend
from agents.ring.commanded_ring import Orbit
from agents.ring.detour import Obstacle, bend_m, bent_ring_m
from agents.ring.place import Neighbours
from agents.ring.reference import RingPoint, across_m_s
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from estimation.plant.model import Plant
from estimation.polar import Polar, motion_from_polar, polar_from_motion
from estimation.state import VELOCITY, Vector
from estimation.vectors import Pair, wrap_signed_rad


def aim_for(motion: Vector, polar: Polar, acceleration: Pair, disturbance_m_s2: Vector, plant: Plant) -> Vector:
    """Return the aim (2,) that gives the plant the polar acceleration (r'', phi'') - (3), (5), (11)."""
    radial, angular = acceleration
    cosine, sine = cos(polar.bearing_rad), sin(polar.bearing_rad)
    outward = radial - polar.radius_m * polar.angular_rate_rad_s**2
    sideways = polar.radius_m * angular + 2.0 * polar.radial_speed_m_s * polar.angular_rate_rad_s
    wanted = outward * cosine - sideways * sine, outward * sine + sideways * cosine
    return aim_for_acceleration(motion, wanted, disturbance_m_s2, plant)


def aim_for_acceleration(motion: Vector, acceleration_m_s2: Pair, disturbance_m_s2: Vector, plant: Plant) -> Vector:
    """Solve the plant for its input: return the aim (2,) under which it has the given acceleration."""
    x, y, x_rate, y_rate = motion.tolist()
    w_x, w_y = disturbance_m_s2.tolist()
    x_wanted, y_wanted = acceleration_m_s2
    effort_x = x_wanted + plant.x.a1_per_s * x_rate - w_x
    effort_y = y_wanted + plant.y.a1_per_s * y_rate - w_y
    return np.array((x + effort_x / plant.x.a0_per_s2, y + effort_y / plant.y.a0_per_s2))


def undisturbed_m(aim_m: Vector, disturbance_m_s2: Vector, plant: Plant) -> Vector:
    """Return the aim (2,) that gives the plant without a disturbance (2,) the acceleration that `aim_m` gives it with
    one. Peers, which do not know the disturbance, predict the vehicle by it.
    """
    x, y = aim_m.tolist()
    w_x, w_y = disturbance_m_s2.tolist()
    return np.array((x + w_x / plant.x.a0_per_s2, y + w_y / plant.y.a0_per_s2))


_APPROACH_GAIN_PER_S: Final = 0.5
_FREE: Final = 1e20
_FULL_AFTER_S: Final = 0.5
"""How long the acceleration takes from zero to its bound at least. The own filter takes what a vehicle's own bound on
jerk withholds for a disturbance, and its compensation then keeps up a swing about the ring (docs/notes/control.md).
"""
_SLACK_WEIGHT: Final = 100.0
"""Exceeding a bound by 1 m or 1 m/s costs as much as a radius error of 10 m."""


class Approach(Enum):
    """The region that the vehicle is in: near the ring, or where the polar model is singular or does not hold."""

    ORBIT = "orbit"
    OUTWARD = "outward"
    INWARD = "inward"


_ORBIT: Final = Approach.ORBIT
"""Looked up once: in Python 3.11 a member of an enumeration takes 0.2 us."""


class RingTask:
    """One vehicle's task about the target; all values are at the moment when the setpoint acts.

    `motion` and `target` are motions (4,), `polar` is the polar state of the vehicle about the target,
    `compensation_m_s2` (2,) the disturbance to compensate. The vehicle keeps clear of its `neighbours`. `orbit` is the
    ring, `radius_m` the radius to fly at: the ring's, or that of the waiting circle. Both bend around the `obstacles`,
    and the ring with its reference by `bend` around no-fly zones.
    """

    def __init__(
        self,
        motion: Vector,
        target: Vector,
        polar: Polar,
        compensation_m_s2: Vector,
        neighbours: Neighbours | None,
        orbit: Orbit,
        radius_m: float,
        reference: RingPoint,
        authority: float = 1.0,
        obstacles: Sequence[Obstacle] = (),
        bend: RingBend | None = None,
    ) -> None:
        self.motion: Final = motion
        self.target: Final = target
        self.polar: Final = polar
        self.compensation_m_s2: Final = compensation_m_s2
        self.neighbours: Final = neighbours
        self.orbit: Final = orbit
        self.radius_m: Final = radius_m
        self.reference: Final = reference
        self.authority: Final = authority
        self.obstacles: Final = obstacles
        self.bend: Final = bend


class EncirclementPlan:
    """The aim (2,), the vehicle's region, and the solver's status."""

    def __init__(self, aim_m: Vector, approach: Approach, status: QpStatus) -> None:
        self.aim_m: Final = aim_m
        self.approach: Final = approach
        self.status: Final = status


class EncirclementPlanner:
    """Plans one vehicle's flight around the target; its only state is the last polar acceleration."""

    def __init__(self, config: AgentConfig) -> None:
        ring = config.encirclement
        self._plant = config.plant
        self._settings = ring
        self._clearance_m = config.clearance_rad * ring.radius_m
        self._lmpc = Lmpc(ring_programme(ring), ring.prediction_step_s, _SLACK_WEIGHT)
        samples = np.arange(1, ring.horizon + 1, dtype=np.float64)
        self._times_s: Vector = ring.prediction_step_s * samples
        self._reference_gain = _reference_gain(ring, self._times_s)
        self._take(Orbit(ring.radius_m, ring.angular_rate_rad_s))
        # Read in every tick: as a machine number each costs a tenth of a setting.
        self._radius_min_m, self._far_m = ring.radius_min_m, ring.far_m
        self._acceleration_max_m_s2, self._speed_max_m_s = ring.acceleration_max_m_s2, ring.speed_max_m_s
        moves_s = 1.0 / config.rate_hz + ring.prediction_step_s * np.arange(ring.control_horizon)
        self._changes_m_s2: list[float] = (ring.acceleration_max_m_s2 / _FULL_AFTER_S * moves_s).tolist()
        self._acceleration = np.zeros(2)

    def reset(self) -> None:
        """Clear the last polar acceleration, when the vehicle comes from another tactic."""
        self._acceleration = np.zeros(2)

    def plan(self, task: RingTask) -> EncirclementPlan:
        """Return the aim (2,) of the polar acceleration of least cost, found by feedback linearisation - (11), (23)."""
        if task.orbit is not self._orbit:
            self._take(task.orbit)
        motion, polar = task.motion, task.polar
        if task.authority < 1.0 and self._approach(polar.radius_m) is _ORBIT:
            motion = damped_motion(task)
            polar = polar_from_motion(motion, task.target)  # the damped motion has another polar state
        approach = self._approach(polar.radius_m)
        if approach is not _ORBIT:
            self.reset()
            aim = self._radial_aim(motion, polar, task)
            return EncirclementPlan(aim, approach, QpStatus.INTERIOR)
        # Along the ring the optimiser counts in metres at the vehicle's radius: it acts as fast far outside as there.
        radius_m = polar.radius_m
        state = np.array([radius_m, 0.0, polar.radial_speed_m_s, radius_m * polar.angular_rate_rad_s])
        reference, bounds = self._reference(task, polar), self._bounds(polar, task.neighbours)
        plan = self._lmpc.solve(state, reference, self._acceleration, bounds)
        self._acceleration = plan.first_input
        radial, along = self._acceleration.tolist()
        aim = aim_for(motion, polar, (radial, along / radius_m), task.compensation_m_s2, self._plant)
        return EncirclementPlan(aim, approach, plan.status)

    def _take(self, orbit: Orbit) -> None:
        self._orbit = orbit
        self._drift_rad: Vector = np.asarray(orbit.angular_rate_rad_s * self._times_s, dtype=np.float64)

    def _approach(self, radius_m: float) -> Approach:
        if radius_m < self._radius_min_m:
            return Approach.OUTWARD
        return Approach.INWARD if radius_m > self._far_m else _ORBIT

    def _radial_aim(self, motion: Vector, polar: Polar, task: RingTask) -> Vector:
        """Fly straight towards the ring, at a speed that the distance and the speed limit allow."""
        settings = self._settings
        speed = _APPROACH_GAIN_PER_S * (task.orbit.radius_m - polar.radius_m)
        speed = max(-settings.speed_max_m_s, min(settings.speed_max_m_s, speed))
        outward = np.array([np.cos(polar.bearing_rad), np.sin(polar.bearing_rad)])
        error = task.target[VELOCITY] + speed * outward - motion[VELOCITY]
        x, y = (self._plant.a1_per_s * error).tolist()
        return aim_for_acceleration(motion, (x, y), task.compensation_m_s2, self._plant)

    def _reference(self, task: RingTask, polar: Polar) -> Vector:
        """Return the reference (horizon, 4) in [r, r phi, r', r phi'] with the vehicle's present radius r.

        Bearings are relative to the vehicle's present one, so the optimiser sees no wrap.
        """
        radius, bearing, size_m = task.reference.radius, task.reference.bearing, polar.radius_m
        ahead_rad = wrap_signed_rad(bearing.value - polar.bearing_rad)
        across = (radius.value, radius.rate, radius.acceleration)
        along = (size_m * ahead_rad, size_m * bearing.rate, size_m * bearing.acceleration)
        reference: Vector = self._reference_gain.dot(np.array(across + along)).reshape(-1, 4)
        if task.obstacles:
            bearings_rad = polar.bearing_rad + self._drift_rad
            level_m = polar.radius_m if task.bend is None else polar.radius_m - task.bend.at_one(polar.bearing_rad)[0]
            bent_m = bent_ring_m(task.radius_m, bearings_rad, task.obstacles, level_m)
            reference[:, 0] += bent_m - task.radius_m
        if task.bend is not None:
            # Where the reference will be: r = R + b(phi), r' = b'(phi) phi'.
            off_m, slope_m_rad = task.bend.at(polar.bearing_rad + reference[:, 1] / size_m)
            reference[:, 0] += off_m
            reference[:, 2] += slope_m_rad * (reference[:, 3] / size_m)
        return reference

    def _bounds(self, polar: Polar, neighbours: Neighbours | None) -> Bounds:
        """Bound the inputs by acceleration and jerk, the states by the speed and the clearance to both neighbours."""
        radial_m_s2, along_m_s2 = self._acceleration.tolist()
        most_radial_m_s2 = across_m_s(self._acceleration_max_m_s2, along_m_s2)
        most_along_m_s2 = across_m_s(self._acceleration_max_m_s2, radial_m_s2)
        pushes: list[Pair] = []
        for change_m_s2 in self._changes_m_s2:
            pushes.append(_moved(radial_m_s2, change_m_s2, most_radial_m_s2))
            pushes.append(_moved(along_m_s2, change_m_s2, most_along_m_s2))
        size_m = polar.radius_m
        radial_m_s = across_m_s(self._speed_max_m_s, size_m * polar.angular_rate_rad_s)
        along_m_s = across_m_s(self._speed_max_m_s, polar.radial_speed_m_s)
        bearing = StateBound(-_FREE, _FREE)
        if neighbours is not None:
            (lag_rad, lag_rad_s), (lead_rad, lead_rad_s) = neighbours
            least_m, most_m = self._clearance_m - size_m * lag_rad, size_m * lead_rad - self._clearance_m
            bearing = StateBound(least_m, most_m, size_m * lag_rad_s, size_m * lead_rad_s)
        return Bounds(pushes, (bearing, StateBound(-radial_m_s, radial_m_s), StateBound(-along_m_s, along_m_s)))


def _moved(before: float, change: float, most: float) -> Pair:
    """Return the range within `change` of a number, and within `most` of 0."""
    return min(max(before - change, -most), most), min(max(before + change, -most), most)


def _reference_gain(settings: EncirclementSettings, times_s: Vector) -> Vector:
    """Return the matrix from two coordinates, each with rate and acceleration (6,), to the reference at all samples.

    Shape (horizon * 4, 6), a sample in [r, r phi, r', r phi']. The acceleration of a transition decays as under the
    spacing law.
    """
    decay_per_s = max(settings.spacing_gain_per_s, 1e-3)
    eased_s = -np.expm1(-decay_per_s * times_s) / decay_per_s
    gain = np.zeros((len(times_s), 4, 6))
    for row, column in ((0, 0), (1, 3)):
        gain[:, row, column], gain[:, row, column + 1] = 1.0, times_s
        gain[:, row, column + 2] = (times_s - eased_s) / decay_per_s
        gain[:, row + 2, column + 1], gain[:, row + 2, column + 2] = 1.0, eased_s
    return gain.reshape(-1, 6)


def damped_motion(task: RingTask) -> Vector:
    """Return the motion (4,) to plan from when the control authority is below 1.

    Only the share `authority` of the vehicle's deviation from its reference is fed back.
    """
    polar, (radius, bearing) = task.polar, (task.reference.radius, task.reference.bearing)
    radius_m, radial_m_s = radius.value + bend_m(task.radius_m, polar, task.obstacles), radius.rate
    if task.bend is not None:
        off_m, slope_m_rad = task.bend.at_one(bearing.value)
        radius_m, radial_m_s = radius_m + off_m, radial_m_s + slope_m_rad * bearing.rate
    on_ring = motion_from_polar(Polar(radius_m, bearing.value, radial_m_s, bearing.rate), task.target)
    return np.asarray(on_ring + task.authority * (task.motion - on_ring), dtype=np.float64)
