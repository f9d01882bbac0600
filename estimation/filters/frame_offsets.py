"""The offsets between the frames of several vehicles, estimated from their sightings of a common target.

A sighting of sensor j is the target plus b_j plus noise, where b_j is the position error of its vehicle, a first-order
Gauss-Markov process. The predicted target has an error c, common to all sensors. A joint Kalman filter over [c, b_1 ...
b_n] processes the differences of sightings from the prediction. Only differences of the b_j are observable. Their
common shift is not: sightings must not change their sum, weighted by the inverse variances, which stays at its prior
mean, zero. Both axes have the same covariance; sightings are used with the mean of their variances.
"""

import numpy as np

from estimation.state import Sighting, Vector

_REFERENCE_S = 1.0
"""Correlation time of the error of the predicted target, whose filter follows within about a second."""
_CLIP_SQUARED = 2.0 * 3.0**2
_GATE_SQUARED = 2.0 * 5.0**2
"""Thresholds of the squared innovation over both axes: above the first the weight is reduced, above the second 0."""
_FIXED_FOR_S = 5.0
"""A sensor without frame error fixes the sum for this long after its last sighting."""


class FrameOffsets:
    """Estimates the offset (2,) of each sensor's frame from the team's."""

    def __init__(self) -> None:
        self._rows: dict[int, int] = {}
        self._mean_m: Vector = np.zeros((1, 2))
        self._covariance_m2: Vector = np.zeros((1, 1))
        self._prior_m2: Vector = np.zeros(1)
        self._rate_per_s: Vector = np.array([1.0 / _REFERENCE_S])
        self._time_s = 0.0
        self._fixed_until_s = 0.0

    def __contains__(self, sensor_id: int) -> bool:
        """Return whether the frame error of a sensor is modelled."""
        return sensor_id in self._rows

    def __bool__(self) -> bool:
        """Return whether any sensor's frame error is modelled."""
        return bool(self._rows)

    def set_error_model(self, sensor_id: int, sigma_m: float, correlation_s: float) -> None:
        """Take the model of a sensor's frame error: standard deviation per axis, and correlation time."""
        row = self._rows.get(sensor_id)
        if row is None:
            row = self._rows[sensor_id] = len(self._prior_m2)
            self._mean_m = np.vstack((self._mean_m, np.zeros((1, 2))))
            self._covariance_m2 = np.pad(self._covariance_m2, (0, 1))
            self._covariance_m2[row, row] = sigma_m**2
            self._prior_m2, self._rate_per_s = np.append(self._prior_m2, 0.0), np.append(self._rate_per_s, 0.0)
        self._prior_m2[row], self._rate_per_s[row] = sigma_m**2, 1.0 / correlation_s

    def offset_m(self, sensor_id: int) -> tuple[float, float]:
        """Return the offset of a sensor's frame, zero without a model."""
        row = self._rows.get(sensor_id)
        return (0.0, 0.0) if row is None else (self._mean_m.item(row, 0), self._mean_m.item(row, 1))

    def variance_m2(self, sensor_id: int) -> float:
        """Return the variance per axis of a sensor's offset; raises KeyError without a model."""
        row = self._rows[sensor_id]
        return self._covariance_m2.item(row, row)

    def predict(self, to_s: float, reference_m2: float) -> None:
        """Predict to a time at which the predicted target has this variance per axis; a sensor must have a model.

        The predicted target contains a common shift of all frames, so its variance is never small compared with theirs.
        """
        step_s = max(to_s - self._time_s, 0.0)
        self._time_s = to_s
        self._prior_m2[0] = reference_m2 + float(self._prior_m2[1:].max())
        kept: Vector = np.exp(-self._rate_per_s * step_s)
        self._mean_m *= kept[:, None]
        self._covariance_m2 *= np.multiply.outer(kept, kept)
        self._covariance_m2.flat[:: len(kept) + 1] += self._prior_m2 * (1.0 - kept * kept)

    def see(self, sighting: Sighting, target_m: tuple[float, float]) -> None:
        """Process a sighting, given the predicted target at its time."""
        covariance, row = self._covariance_m2, self._rows.get(sighting.sensor_id)
        if row is None:
            self._fixed_until_s = self._time_s + _FIXED_FOR_S
        across = covariance[0] if row is None else covariance[0] + covariance[row]
        off = sighting.position_m - self._mean_m[0] - target_m
        if row is not None:
            off -= self._mean_m[row]
        expected_m2 = across.item(0) + (0.0 if row is None else across.item(row))
        noise_m2 = (sighting.covariance_m2[0] + sighting.covariance_m2[2]) / 2.0
        squared = float(off @ off) / (expected_m2 + noise_m2)
        if not squared <= _GATE_SQUARED:  # also NaN
            return
        innovation_m2 = expected_m2 + noise_m2 * max(1.0, (squared / _CLIP_SQUARED) ** 0.5)
        change = np.multiply.outer(across / innovation_m2, off)
        if self._time_s >= self._fixed_until_s:
            weight = 1.0 / self._prior_m2[1:]
            change[1:] -= weight @ change[1:] / weight.sum()
        self._mean_m += change
        covariance -= np.multiply.outer(across, across) / innovation_m2
