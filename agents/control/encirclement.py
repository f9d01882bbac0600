"""Encirclement: LMPC on the linearised polar model - (23) to (26) - and its setpoint through feedback linearisation."""

from collections.abc import Sequence
from enum import Enum
from math import tau

import msgspec
import numpy as np

from agents.control.detour import Obstacle, bent_ring_m
from agents.control.linearization import setpoint_for, setpoint_for_acceleration
from agents.control.lmpc import Bounds, Lmpc, QpStatus
from agents.control.ring import RingPlace, spaced_rate_rad_s
from agents.control.ring_feasibility import Orbit
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from estimation.polar import Polar, motion_from_polar, polar_from_motion
from estimation.state import VELOCITY, Vector

_CONSTRAINED = (1, 2, 3)  # bearing, radial speed, angular rate
_APPROACH_GAIN_PER_S = 0.5
_FREE = 1e20


class Approach(Enum):
    """How the vehicle stands to the ring: on its way along it, or where polar control is singular or useless."""

    ORBIT = "orbit"
    OUTWARD = "outward"
    INWARD = "inward"


class EncirclementPlan(msgspec.Struct, frozen=True):
    """The setpoint (2,), how the vehicle stands to the ring, the rate wanted of it, and where the plan came from."""

    setpoint_m: Vector
    approach: Approach
    rate_wanted_rad_s: float
    status: QpStatus


class EncirclementPlanner:
    """Plans one vehicle's flight around the target; remembers the last polar acceleration only."""

    def __init__(self, config: AgentConfig) -> None:
        self._plant = config.plant
        self._settings = config.encirclement
        self._clearance_rad = config.clearance_rad
        spacing_weight = self._settings.lag_weight + self._settings.lead_weight
        self._alone = ring_lmpc(self._settings, 0.0)
        self._spaced = ring_lmpc(self._settings, spacing_weight) if spacing_weight > 0.0 else self._alone
        self._times_s = self._settings.prediction_step_s * np.arange(1, self._settings.horizon + 1)
        self._on_ring = np.zeros((self._settings.horizon, 4))
        self._take(Orbit(self._settings.radius_m, self._settings.angular_rate_rad_s))
        # The bounds of a plan, filled anew for each: what does not change stands in them from the beginning.
        self._pushes = self._settings.acceleration_max_m_s2 * np.array([[-1.0, -1.0], [1.0, 1.0]])
        self._limits = np.empty((2, self._settings.horizon, len(_CONSTRAINED)))
        self._limits[0], self._limits[1] = -self._settings.speed_max_m_s, self._settings.speed_max_m_s
        self._bearings_min, self._bearings_max = self._limits[..., 0]
        self._rates_min, self._rates_max = self._limits[..., 2]
        self._acceleration = np.zeros(2)

    def reset(self) -> None:
        """Forget the last polar acceleration: the vehicle comes from another tactic."""
        self._acceleration = np.zeros(2)

    def plan(
        self,
        motion: Vector,
        target: Vector,
        disturbance_m_s2: Vector,
        place: RingPlace,
        orbit: Orbit | None = None,
        *,
        authority: float = 1.0,
        radius_m: float | None = None,
        obstacles: Sequence[Obstacle] = (),
    ) -> EncirclementPlan:
        """Plan from the vehicle's and the target's motion (4,) at the moment the setpoint acts.

        It goes on around the last orbit unless there is another one; the first is the mission's. With less than full
        `authority` only that share of the vehicle's deviation from where it is to fly is acted on. `radius_m` is where
        to fly if not on the orbit itself; either bends around `obstacles`.
        """
        if orbit is not None and orbit is not self._orbit:
            self._take(orbit)
        polar = polar_from_motion(motion, target)
        wanted = spaced_rate_rad_s(place, self._orbit.angular_rate_rad_s, self._settings.spacing_gain_per_s)
        level_m = self._orbit.radius_m if radius_m is None else radius_m
        if authority < 1.0 and self._approach(polar.radius_m) is Approach.ORBIT:
            bearing_rad = np.array([polar.bearing_rad])
            here_m = bent_ring_m(level_m, bearing_rad, obstacles, polar.radius_m).item() if obstacles else level_m
            on_ring = motion_from_polar(Polar(here_m, polar.bearing_rad, 0.0, wanted), target)
            motion = on_ring + authority * (motion - on_ring)
            polar = polar_from_motion(motion, target)
        approach = self._approach(polar.radius_m)
        if approach is not Approach.ORBIT:
            self.reset()
            setpoint = self._radial_setpoint(motion, target, polar, disturbance_m_s2)
            return EncirclementPlan(setpoint, approach, wanted, QpStatus.INTERIOR)
        lmpc = self._alone if place.members == 1 else self._spaced
        state = np.array([polar.radius_m, 0.0, polar.radial_speed_m_s, polar.angular_rate_rad_s])
        reference = self._reference(place, wanted)
        if obstacles:
            reference[:, 0] = bent_ring_m(level_m, polar.bearing_rad + self._drift_rad, obstacles, polar.radius_m)
        elif radius_m is not None:
            reference[:, 0] = radius_m
        plan = lmpc.solve(state, reference, self._acceleration, self._bounds(polar, place))
        self._acceleration = plan.first_input
        setpoint = setpoint_for(motion, polar, plan.first_input, disturbance_m_s2, self._plant)
        return EncirclementPlan(setpoint, approach, wanted, plan.status)

    def _take(self, orbit: Orbit) -> None:
        self._orbit = orbit
        self._drift_rad: Vector = np.asarray(orbit.angular_rate_rad_s * self._times_s, dtype=np.float64)
        self._on_ring[:, 0] = orbit.radius_m

    def _approach(self, radius_m: float) -> Approach:
        if radius_m < self._settings.radius_min_m:
            return Approach.OUTWARD
        return Approach.INWARD if radius_m > self._settings.radius_far_m else Approach.ORBIT

    def _radial_setpoint(self, motion: Vector, target: Vector, polar: Polar, disturbance_m_s2: Vector) -> Vector:
        """Fly straight towards the ring, at a speed that the distance and the speed limit allow."""
        settings = self._settings
        speed = _APPROACH_GAIN_PER_S * (self._orbit.radius_m - polar.radius_m)
        speed = max(-settings.speed_max_m_s, min(settings.speed_max_m_s, speed))
        outward = np.array([np.cos(polar.bearing_rad), np.sin(polar.bearing_rad)])
        error = target[VELOCITY] + speed * outward - motion[VELOCITY]
        x, y = (self._plant.a1_per_s * error).tolist()
        return setpoint_for_acceleration(motion, (x, y), disturbance_m_s2, self._plant)

    def _reference(self, place: RingPlace, rate_wanted_rad_s: float) -> Vector:
        """Return the reference (horizon, 4); both spacing terms of (24) together pull towards one weighted bearing.

        Bearings count from the vehicle's own present one, so that no wrap ever reaches the optimiser; the neighbours go
        on at the ring's rate - (25), (26).
        """
        settings = self._settings
        reference = self._on_ring.copy()
        reference[:, 3] = rate_wanted_rad_s
        if place.lead_rad is not None and place.lag_rad is not None:
            behind = place.desired_rad - place.lag_rad
            ahead = place.lead_rad - place.desired_rad
            weights = settings.lag_weight + settings.lead_weight
            middle = (settings.lag_weight * behind + settings.lead_weight * ahead) / weights if weights else 0.0
            reference[:, 1] = middle + self._drift_rad
        return reference

    def _bounds(self, polar: Polar, place: RingPlace) -> Bounds:
        """Bound the inputs by the acceleration, the states by the speed limit and the clearance to both neighbours."""
        settings = self._settings
        radius = polar.radius_m
        angular_rad_s2, fastest_rad_s = settings.acceleration_max_m_s2 / radius, settings.speed_max_m_s / radius
        self._pushes[0, 1], self._pushes[1, 1] = -angular_rad_s2, angular_rad_s2
        self._rates_min.fill(-fastest_rad_s)
        self._rates_max.fill(fastest_rad_s)
        if place.lead_rad is None or place.lag_rad is None:
            self._bearings_min[:], self._bearings_max[:] = -_FREE, _FREE
        else:
            np.add(self._drift_rad, self._clearance_rad - place.lag_rad, out=self._bearings_min)
            np.add(self._drift_rad, place.lead_rad - self._clearance_rad, out=self._bearings_max)
        return Bounds(self._pushes, self._limits)


def ring_lmpc(settings: EncirclementSettings, spacing_weight: float) -> Lmpc:
    """Build the LMPC of two double integrators in [r phi r' phi'] with inputs [r'' phi''] - (12)."""
    step_s = settings.prediction_step_s
    transition = np.eye(4)
    transition[:2, 2:] = np.eye(2) * step_s
    input_gain = np.vstack([np.eye(2) * step_s**2 / 2.0, np.eye(2) * step_s])
    return Lmpc(
        transition,
        input_gain,
        horizon=settings.horizon,
        control_horizon=settings.control_horizon,
        state_weight=np.diag([settings.radius_weight, spacing_weight, 0.0, settings.rate_weight]),
        increment_weight=np.array([settings.radial_increment_weight, settings.angular_increment_weight]),
        constrained_states=_CONSTRAINED,
    )


def chord_m(radius_m: float, members: int) -> float:
    """Return the distance between neighbours evenly spaced on the ring, `2 R sin(pi / n)`."""
    return float(2.0 * radius_m * np.sin(tau / 2.0 / members))
