"""One Kalman step on immutable beliefs, behind a gate that lets neither NaN nor outliers in.

Prediction is filterpy's. Its correction spends most of its time around the arithmetic, and so would the control loop:
here the same equations stand in square-root form, and tests hold them against filterpy's.
"""

import msgspec
import numpy as np
from filterpy import kalman as equations
from scipy.linalg import blas, lapack

from estimation.state import Vector

STEP_DIGITS = 3
"""Beliefs are carried by whole milliseconds: telemetry comes at any time, but few steps differ, so that the matrices
of each are computed once. At 3 m/s that is 1.5 mm at most, and measurements keep it from adding up."""


class Belief(msgspec.Struct, frozen=True):
    """A Gaussian at one time: mean (n,) and covariance (n, n)."""

    time_s: float
    mean: Vector
    covariance: Vector


class Correction(msgspec.Struct, frozen=True):
    """The belief after a measurement, whether it passed the gate, and the square of its normalised innovation."""

    belief: Belief
    accepted: bool
    innovation_squared: float


def predict(
    belief: Belief, to_s: float, transition: Vector, noise: Vector, input_gain: Vector, acting_input: Vector
) -> Belief:
    """Carry a belief to `to_s` by transition (n, n), an input (k,) through its gain (n, k) and process noise (n, n)."""
    mean, covariance = equations.predict(
        belief.mean, belief.covariance, F=transition, Q=noise, u=acting_input, B=input_gain
    )
    return Belief(to_s, mean, covariance)


def correct(belief: Belief, measurement: Vector, noise: Vector, gate_sigma: float) -> Correction:
    """Correct a belief by a measurement (m,) of its first m states, with noise of covariance (m, m).

    A measurement that is not finite, or farther out than `gate_sigma` in Mahalanobis distance scaled to one degree of
    freedom, leaves the belief as it was.
    """
    size, states = len(measurement), len(belief.mean)
    seen = belief.covariance[:size]
    # With the innovation's covariance S = L L' and everything divided by L, gain and innovation need no inverse:
    # the correction is G' e, the covariance loses G' G - symmetric to the last bit - and e' e is the squared distance.
    root, _ = lapack.dpotrf(seen[:, :size] + noise, lower=1, clean=0)
    sides = np.empty((size, states + 1), order="F")
    sides[:, :states] = seen
    np.subtract(measurement, belief.mean[:size], out=sides[:, states])
    # Not LAPACK's dtrtrs: that wakes a thread for the smallest system, which then burns a processor waiting for more.
    whitened = blas.dtrsm(1.0, root, sides, lower=1, overwrite_b=1)
    gain, innovation = whitened[:, :states], whitened[:, states]
    squared = float(innovation.dot(innovation))
    if not squared <= gate_sigma**2 * size:  # NaN is no innovation either
        return Correction(belief, False, squared)
    covariance = belief.covariance - gain.T.dot(gain)
    mean = belief.mean + innovation.dot(gain)
    return Correction(Belief(belief.time_s, mean, covariance), True, squared)
