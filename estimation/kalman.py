"""One Kalman step on immutable beliefs: filterpy's equations behind a gate that lets neither NaN nor outliers in."""

from dataclasses import dataclass

import numpy as np
from filterpy import kalman as equations

from estimation.state import Vector

STEP_DIGITS = 3
"""Beliefs are carried by whole milliseconds: telemetry comes at any time, but few steps differ, so that the matrices
of each are computed once. At 3 m/s that is 1.5 mm at most, and measurements keep it from adding up."""


@dataclass(frozen=True, slots=True)
class Belief:
    """A Gaussian at one time: mean (n,) and covariance (n, n)."""

    time_s: float
    mean: Vector
    covariance: Vector


@dataclass(frozen=True, slots=True)
class MeasurementNoise:
    """The covariance of a measurement (m, m), and its inverse."""

    covariance: Vector
    precision: Vector


@dataclass(frozen=True, slots=True)
class Correction:
    """The belief after a measurement, whether it passed the gate, and its squared normalised innovation."""

    belief: Belief
    accepted: bool
    innovation_squared: float


def predict(belief: Belief, to_s: float, transition: Vector, noise: Vector, forced: Vector) -> Belief:
    """Carry a belief to `to_s` by `transition` (n, n), the known forcing (n,) and process noise (n, n)."""
    mean, covariance = equations.predict(belief.mean, belief.covariance, F=transition, Q=noise)
    return Belief(to_s, mean + forced, covariance)


def correct(
    belief: Belief, measurement: Vector, noise: MeasurementNoise, observation: Vector, gate_sigma: float
) -> Correction:
    """Correct a belief by a measurement (m,) with its noise, seen through `observation` (m, n).

    A measurement that is not finite, or farther out than `gate_sigma` in Mahalanobis distance scaled to one degree of
    freedom, leaves the belief as it was: filterpy would turn a NaN into a belief that is NaN for ever.
    """
    if not np.isfinite(measurement).all():
        return Correction(belief, False, np.inf)
    mean, covariance = equations.update(belief.mean, belief.covariance, measurement, noise.covariance, observation)
    # With innovation y of covariance S, a correction leaves R inv(S) y over: S need not be inverted twice.
    innovation = measurement - observation @ belief.mean
    squared = float(innovation @ noise.precision @ (measurement - observation @ mean))
    if not squared <= gate_sigma**2 * len(measurement):  # NaN is no innovation either
        return Correction(belief, False, squared)
    return Correction(Belief(belief.time_s, mean, (covariance + covariance.T) / 2.0), True, squared)
