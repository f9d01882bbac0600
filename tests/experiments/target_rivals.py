"""Alternatives to the target filter, for target_tracks.py, with the same input.

Both take sightings in order of time only, with the same gate and the same restart.
"""

from math import exp

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from estimation.state import POSITION, VELOCITY, Sighting, Vector

GATE_SIGMA, GATE_TIMEOUT_S, VELOCITY_PRIOR_M_S = 4.0, 2.0, 1.0
TURN_RAD_S = 1.0
STAYS_S, MANOEUVRE_S = 20.0, 1.0
ACCELERATION_M_S2, JERK_M_S3, TURNING_M_S2 = 0.02, 2.0, 0.3


class _Rival:
    """The common parts: the gate, and the restart."""

    def __init__(self) -> None:
        self._time_s: float | None = None
        self._accepted_s = 0.0
        self._doubted_s: float | None = None

    def sight(self, sighting: Sighting) -> None:
        """Take the next sighting."""
        position = np.array(sighting.position_m)
        xx, xy, yy = sighting.covariance_m2
        noise = np.array([[xx, xy], [xy, yy]])
        if self._time_s is None:
            self._begin(position, noise)
            self._time_s = self._accepted_s = sighting.time_s
            return
        self._predict(sighting.time_s - self._time_s)
        self._time_s = sighting.time_s
        mean, covariance = self.belief(sighting.time_s)
        reach_m = VELOCITY_PRIOR_M_S * min(sighting.time_s - self._accepted_s, 1.0)
        off, spread = position - mean[:2], covariance[:2, :2] + noise + np.eye(2) * reach_m**2
        if off @ np.linalg.solve(spread, off) <= 2.0 * GATE_SIGMA**2:
            self._correct(position, noise)
            self._accepted_s, self._doubted_s = sighting.time_s, None
            return
        self._doubted_s = sighting.time_s if self._doubted_s is None else self._doubted_s
        if sighting.time_s - self._doubted_s > GATE_TIMEOUT_S:
            self._time_s, self._doubted_s = None, None

    def belief(self, now_s: float) -> tuple[Vector, Vector]:
        """Return mean (4,) and covariance (4, 4), predicted to a time after the last sighting."""
        raise NotImplementedError

    def _begin(self, position: Vector, noise: Vector) -> None:
        raise NotImplementedError

    def _predict(self, step_s: float) -> None:
        raise NotImplementedError

    def _correct(self, position: Vector, noise: Vector) -> None:
        raise NotImplementedError


class FixedNoise(_Rival):
    """Constant velocity under white acceleration of one density [m/s² per root Hz]."""

    def __init__(self, density: float) -> None:
        super().__init__()
        self._density = density
        self._mean, self._covariance = np.zeros(4), np.eye(4)

    def belief(self, now_s: float) -> tuple[Vector, Vector]:
        """See _Rival."""
        step_s = now_s - (self._time_s or 0.0)
        transition = _straight(step_s, 4)
        noise = _white(step_s, 4, self._density)
        return transition @ self._mean, transition @ self._covariance @ transition.T + noise

    def _begin(self, position: Vector, noise: Vector) -> None:
        self._mean = np.concatenate([position, np.zeros(2)])
        self._covariance = _prior(noise, 4)

    def _predict(self, step_s: float) -> None:
        self._mean, self._covariance = self.belief((self._time_s or 0.0) + step_s)

    def _correct(self, position: Vector, noise: Vector) -> None:
        gain = self._covariance[:, :2] @ np.linalg.inv(self._covariance[:2, :2] + noise)
        self._mean = self._mean + gain @ (position - self._mean[:2])
        self._covariance = self._covariance - gain @ self._covariance[:2]


class Imm(_Rival):
    """filterpy's interacting multiple models: constant velocity, acceleration, a turn to the left, one to the right."""

    def __init__(self) -> None:
        super().__init__()
        self._filters = [KalmanFilter(6, 2) for _ in range(4)]
        self._imm: IMMEstimator | None = None

    def belief(self, now_s: float) -> tuple[Vector, Vector]:
        """See _Rival."""
        assert self._imm is not None
        step_s = now_s - (self._time_s or 0.0)
        transition = _accelerated(step_s)
        covariance = transition @ self._imm.P @ transition.T
        return (transition @ self._imm.x)[:4], covariance[:4, :4] + _white(step_s, 4, ACCELERATION_M_S2)

    def _begin(self, position: Vector, noise: Vector) -> None:
        for each in self._filters:
            each.x = np.concatenate([position, np.zeros(4)])
            each.P = _prior(noise, 6)
            each.H = np.eye(2, 6)
        self._imm = IMMEstimator(self._filters, np.array([0.7, 0.1, 0.1, 0.1]), np.eye(4))

    def _predict(self, step_s: float) -> None:
        assert self._imm is not None
        leaves, ends = 1.0 - exp(-step_s / STAYS_S), 1.0 - exp(-step_s / MANOEUVRE_S)
        back = [[ends if k == 0 else (1.0 - ends) * (k == row) for k in range(4)] for row in (1, 2, 3)]
        self._imm.M = np.array([[1.0 - leaves, leaves / 2.0, leaves / 4.0, leaves / 4.0], *back])
        self._imm._compute_mixing_probabilities()
        straight, jerk = np.zeros((6, 6)), np.zeros((6, 6))
        straight[:4, :4] = _straight(step_s, 4)
        spread = [
            [step_s**5 / 20.0, step_s**4 / 8.0, step_s**3 / 6.0],
            [step_s**4 / 8.0, step_s**3 / 3.0, step_s**2 / 2.0],
            [step_s**3 / 6.0, step_s**2 / 2.0, step_s],
        ]
        jerk = np.kron(np.array(spread), np.eye(2)) * JERK_M_S3**2
        calm, turning = _white(step_s, 6, ACCELERATION_M_S2), _white(step_s, 6, TURNING_M_S2)
        models = (
            (straight, calm),
            (_accelerated(step_s), jerk),
            (_ring_frequency(step_s, TURN_RAD_S), turning),
            (_ring_frequency(step_s, -TURN_RAD_S), turning),
        )
        for each, (transition, noise) in zip(self._filters, models, strict=True):
            each.F, each.Q = transition, noise
        self._imm.predict()

    def _correct(self, position: Vector, noise: Vector) -> None:
        assert self._imm is not None
        for each in self._filters:
            each.R = noise
        self._imm.update(position)


def _prior(noise: Vector, states: int) -> Vector:
    covariance = np.eye(states) * 1e-2
    covariance[POSITION, POSITION] = noise
    covariance[VELOCITY, VELOCITY] = np.eye(2) * VELOCITY_PRIOR_M_S**2
    return covariance


def _straight(step_s: float, states: int) -> Vector:
    transition = np.eye(states)
    transition[POSITION, VELOCITY] = np.eye(2) * step_s
    return transition


def _white(step_s: float, states: int, density: float) -> Vector:
    spread = np.array([[step_s**3 / 3.0, step_s**2 / 2.0], [step_s**2 / 2.0, step_s]])
    noise = np.eye(states) * 1e-6
    noise[:4, :4] = np.kron(spread, np.eye(2)) * density**2
    return noise


def _accelerated(step_s: float) -> Vector:
    transition = _straight(step_s, 6)
    transition[POSITION, 4:] = np.eye(2) * step_s**2 / 2.0
    transition[VELOCITY, 4:] = np.eye(2) * step_s
    return transition


def _ring_frequency(step_s: float, rate_rad_s: float) -> Vector:
    sine, cosine = np.sin(rate_rad_s * step_s), np.cos(rate_rad_s * step_s)
    transition = np.zeros((6, 6))
    transition[POSITION, POSITION] = np.eye(2)
    transition[POSITION, VELOCITY] = np.array([[sine, cosine - 1.0], [1.0 - cosine, sine]]) / rate_rad_s
    transition[VELOCITY, VELOCITY] = [[cosine, -sine], [sine, cosine]]
    return transition
