"""Nonlinear model predictive control of the ring: no linearisation, the accelerations of the next seconds at once.

Each tick minimises the errors of radius, speed along the ring and radial speed, and the changes of the acceleration,
under a bound of the acceleration. The wanted rate is w + k e: e is the angle by which the vehicle lags the middle of
its neighbours. The formation is flown by cordon's planner.
"""

from math import atan2, pi, sqrt, tau

import numpy as np
from scipy.optimize import least_squares

import cordon

STEPS, STEP_S = 10, 0.3
RADIUS_WEIGHT, ALONG_WEIGHT, RADIAL_WEIGHT, CHANGE_WEIGHT = 1.0, 1.5, 0.5, 0.4
SPACING_GAIN_PER_S = 0.15
RATE_CHANGE_MAX = 0.5
"""The most by which the spacing changes the rate, as a share of the mission's."""
INWARD_MAX_M_S = 1.0
EVALUATIONS = 6

_LOWER = np.tril(np.ones((STEPS, STEPS)))
SPEEDS = STEP_S * _LOWER
"""Speeds after each step by the accelerations in the steps, and the places that follow."""
PLACES = STEP_S**2 * (np.subtract.outer(np.arange(STEPS), np.arange(STEPS)) + 0.5) * _LOWER
AHEAD_S = STEP_S * np.arange(1, STEPS + 1)
CHANGES = np.eye(STEPS) - np.eye(STEPS, k=-1)


class Nmpc:
    """Plans one vehicle's ring."""

    def __init__(self, config: cordon.AgentConfig) -> None:
        ring = config.encirclement
        self._radius_m, self._rate_rad_s = ring.radius_m, ring.angular_rate_rad_s
        self._most_m_s2 = ring.acceleration_max_m_s2 / sqrt(2.0)
        self._plant = config.plant
        self._planned_m_s2: np.ndarray | None = None

    def plan(self, task: cordon.Task) -> cordon.Plan | None:
        """Return the aim that gives the plant the first acceleration; None in formation and without a target."""
        situation = task.situation
        if task.tactic.value != "encircle" or situation.acting_centre is None:
            self._planned_m_s2 = None
            return None
        relative = situation.acting_motion - situation.acting_centre
        lag_rad = self._lag_rad(task, atan2(relative[1], relative[0]))
        begin_m_s2 = np.zeros((STEPS, 2)) if self._planned_m_s2 is None else self._planned_m_s2
        problem = Problem(relative, begin_m_s2[0], self._radii_m(relative), self._wanted_rad_s(lag_rad))
        start = np.clip(begin_m_s2, -0.99 * self._most_m_s2, 0.99 * self._most_m_s2).ravel()
        found = least_squares(
            problem.residuals,
            start,
            problem.jacobian,
            bounds=(-self._most_m_s2, self._most_m_s2),
            max_nfev=EVALUATIONS,
        )
        self._planned_m_s2 = found.x.reshape(STEPS, 2)
        own_m, own_m_s = situation.acting_motion[:2], situation.acting_motion[2:]
        undisturbed_m = own_m + (self._planned_m_s2[0] + self._plant.a1_per_s * own_m_s) / self._plant.a0_per_s2
        aim_m = undisturbed_m - situation.compensation / self._plant.a0_per_s2
        return cordon.Plan(aim_m, undisturbed_m, own_m_s, values={"cost": float(found.cost), "lag_rad": lag_rad})

    def _radii_m(self, relative: np.ndarray) -> np.ndarray:
        """Return the wanted distances: to the ring at a bounded speed."""
        off_m = np.hypot(*relative[:2]) - self._radius_m
        return self._radius_m + np.sign(off_m) * np.maximum(abs(off_m) - INWARD_MAX_M_S * AHEAD_S, 0.0)

    def _wanted_rad_s(self, lag_rad: float) -> float:
        most = RATE_CHANGE_MAX * abs(self._rate_rad_s)
        return self._rate_rad_s + float(np.clip(SPACING_GAIN_PER_S * lag_rad, -most, most))

    def _lag_rad(self, task: cordon.Task, bearing_rad: float) -> float:
        """Return the angle from the vehicle to the middle of its neighbours, counter-clockwise; 0 without any."""
        at_s = task.situation.acting_s
        angles = [peer.angle for peer in task.peers if peer.tactic == "encircle" and peer.angle is not None]
        ahead = [
            (each.bearing_rad + each.angular_rate_rad_s * (at_s - each.time_s) - bearing_rad) % tau for each in angles
        ]
        return (min(ahead) + max(ahead)) / 2.0 - pi if ahead else 0.0


class Problem:
    """One tick's least squares, in the accelerations (STEPS, 2) as one vector."""

    def __init__(self, relative: np.ndarray, before_m_s2: np.ndarray, radii_m: np.ndarray, rate_rad_s: float) -> None:
        self._free_m = relative[:2] + np.outer(AHEAD_S, relative[2:])
        self._free_m_s, self._before_m_s2 = relative[2:], before_m_s2
        self._radii_m, self._along_m_s = radii_m, rate_rad_s * radii_m

    def _motion(self, flat: np.ndarray) -> tuple[np.ndarray, ...]:
        accelerations = flat.reshape(STEPS, 2)
        place_m, velocity_m_s = self._free_m + PLACES @ accelerations, self._free_m_s + SPEEDS @ accelerations
        radius_m = np.maximum(np.hypot(*place_m.T), 0.1)[:, None]
        outwards = place_m / radius_m
        return velocity_m_s, radius_m, outwards, outwards @ np.array([[0.0, 1.0], [-1.0, 0.0]])

    def residuals(self, flat: np.ndarray) -> np.ndarray:
        """Return the weighted errors."""
        velocity_m_s, radius_m, outwards, along = self._motion(flat)
        changes = CHANGES @ flat.reshape(STEPS, 2)
        changes[0] -= self._before_m_s2
        radial_m_s, along_m_s = (np.sum(velocity_m_s * each, axis=1) for each in (outwards, along))
        errors = RADIUS_WEIGHT * (radius_m[:, 0] - self._radii_m), ALONG_WEIGHT * (along_m_s - self._along_m_s)
        return np.concatenate([*errors, RADIAL_WEIGHT * radial_m_s, CHANGE_WEIGHT * changes.ravel()])

    def jacobian(self, flat: np.ndarray) -> np.ndarray:
        """Return the derivatives of the errors; those of the unit vectors turn with the bearing."""
        velocity_m_s, radius_m, outwards, along = self._motion(flat)
        radial_m_s, along_m_s = (np.sum(velocity_m_s * each, axis=1)[:, None] for each in (outwards, along))
        turns = along / radius_m
        rows = [
            RADIUS_WEIGHT * _chained(PLACES, outwards),
            ALONG_WEIGHT * (_chained(SPEEDS, along) - _chained(PLACES, radial_m_s * turns)),
            RADIAL_WEIGHT * (_chained(SPEEDS, outwards) + _chained(PLACES, along_m_s * turns)),
            CHANGE_WEIGHT * np.kron(CHANGES, np.eye(2)),
        ]
        return np.concatenate(rows)


def _chained(effect: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return derivatives (STEPS, 2 STEPS) by the accelerations, from those (STEPS, 2) by places or velocities."""
    return (effect[:, :, None] * gradient[:, None, :]).reshape(STEPS, 2 * STEPS)
