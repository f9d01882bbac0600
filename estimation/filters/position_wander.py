"""The slow error of a vehicle's reported position, as far as it is observable from its own telemetry.

Along each axis: reported position = p + b + white noise, p' = reported velocity + white noise, and b a first-order
Gauss-Markov process. b is observable as far as the velocity does not contain the position's error: a GPS receiver's
velocity, from Doppler shifts, mostly does not. The better the velocity, the more slowly the remainder of b varies; it
is observable only from sightings of a common target (`frame_offsets.py`). Both axes have the same noise, hence one
covariance.

The offsets between the frames of several vehicles, estimated from their sightings of a common target.

A sighting of sensor j is the target plus b_j plus noise, where b_j is the position error of its vehicle, a first-order
Gauss-Markov process. The predicted target has an error c, common to all sensors. A joint Kalman filter over [c, b_1 ...
b_n] processes the differences of sightings from the prediction. Only differences of the b_j are observable. Their
common shift is not: sightings must not change their sum, weighted by the inverse variances, which stays at its prior
mean, zero. Both axes have the same covariance; sightings are used with the mean of their variances.
"""

from math import exp, hypot, sqrt
from typing import Final

import numpy as np

from estimation.settings import OwnFilterSettings
from estimation.state import Sighting, Telemetry, Vector

_REFERENCE_S: Final = 1.0
"""Correlation time of the error of the predicted target, whose filter follows within about a second."""
_CLIP_SQUARED = 2.0 * 3.0**2
_GATE_SQUARED = 2.0 * 5.0**2
"""Thresholds of the squared innovation over both axes: above the first the weight is reduced, above the second 0."""
_FIXED_FOR_S: Final = 5.0
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

    @property
    def shift_variance_m2(self) -> float:
        """The variance per axis of the frames' common shift beyond what the variances of the offsets contain of it.

        It is that of the weighted mean of all position errors, which is estimated as zero whatever is sighted.
        """
        if self._time_s < self._fixed_until_s:
            return 0.0
        weight = 1.0 / self._prior_m2[1:]
        share = weight / weight.sum()
        return max(float(1.0 / weight.sum() - share @ self._covariance_m2[1:, 1:] @ share), 0.0)

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


_BOUND_SIGMAS: Final = 3.0
"""Bound of the estimate, which a velocity with a steady error would otherwise exceed."""


class PositionWander:
    """Estimates the position error (2,) of one vehicle's telemetry; `settings.wander_m` must be positive."""

    def __init__(self, settings: OwnFilterSettings) -> None:
        self._variance_m2 = settings.wander_m**2
        self._correlation_s = settings.wander_s
        self._walk_m2_s = settings.velocity_walk_m**2
        self._noise_m2 = settings.position_noise_m**2
        self._gate_squared = 2.0 * settings.gate_sigma**2
        self._bound_m = _BOUND_SIGMAS * settings.wander_m
        wander_m2_s = 2.0 * self._variance_m2 / settings.wander_s
        # The better the velocity, the more slowly the remainder of the error varies.
        self._slowed = (wander_m2_s + self._walk_m2_s) / self._walk_m2_s
        self._last: Telemetry | None = None
        self._position_m = self.error_m = (0.0, 0.0)
        """The estimated error (x, y)."""
        self._pp = self._pb = self._bb = 0.0
        self._forget()

    @property
    def sigma_m(self) -> float:
        """The standard deviation per axis of the remaining error."""
        return sqrt(self._bb)

    @property
    def correlation_s(self) -> float:
        """The correlation time of the remaining error."""
        return self._correlation_s * self._slowed * self._bb / self._variance_m2

    def measure(self, telemetry: Telemetry) -> None:
        """Process a telemetry sample; one from the past is ignored. A jump of the position restarts the estimate."""
        x, y, _ = telemetry.position_m
        last = self._last
        if last is None:
            self._position_m, self._last = (x, y), telemetry
            return
        step_s = telemetry.time_s - last.time_s
        if step_s <= 0.0:
            return
        self._last = telemetry
        self._predict(last, telemetry, step_s)
        (p_x, p_y), (b_x, b_y) = self._position_m, self.error_m
        off_x, off_y = x - p_x - b_x, y - p_y - b_y
        innovation_m2 = self._pp + 2.0 * self._pb + self._bb + self._noise_m2
        if off_x * off_x + off_y * off_y > self._gate_squared * innovation_m2:
            self._position_m = p_x + off_x, p_y + off_y
            self._forget()
            return
        gain_p, gain_b = (self._pp + self._pb) / innovation_m2, (self._pb + self._bb) / innovation_m2
        self._pp -= gain_p * gain_p * innovation_m2
        self._pb -= gain_p * gain_b * innovation_m2
        self._bb -= gain_b * gain_b * innovation_m2
        self._position_m = p_x + gain_p * off_x, p_y + gain_p * off_y
        self.error_m = b_x + gain_b * off_x, b_y + gain_b * off_y
        self._bound()

    def _predict(self, last: Telemetry, telemetry: Telemetry, step_s: float) -> None:
        (p_x, p_y), (b_x, b_y) = self._position_m, self.error_m
        (u_x, u_y, _), (v_x, v_y, _) = last.velocity_m_s, telemetry.velocity_m_s
        self._position_m = p_x + (u_x + v_x) / 2.0 * step_s, p_y + (u_y + v_y) / 2.0 * step_s
        kept = exp(-step_s / self._correlation_s)
        self.error_m = kept * b_x, kept * b_y
        self._pp += self._walk_m2_s * step_s
        self._pb *= kept
        self._bb = kept * kept * self._bb + (1.0 - kept * kept) * self._variance_m2

    def _forget(self) -> None:
        """Restart with an unknown error."""
        self._bb = self._variance_m2
        self._pb = -self._variance_m2
        self._pp = self._variance_m2 + self._noise_m2

    def _bound(self) -> None:
        (p_x, p_y), (b_x, b_y) = self._position_m, self.error_m
        size_m = hypot(b_x, b_y)
        if size_m > self._bound_m:
            share = self._bound_m / size_m
            self.error_m = share * b_x, share * b_y
            self._position_m = p_x + (1.0 - share) * b_x, p_y + (1.0 - share) * b_y
