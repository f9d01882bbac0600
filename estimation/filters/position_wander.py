"""The slow error of a vehicle's reported position, as far as it is observable from its own telemetry.

Along each axis: reported position = p + b + white noise, p' = reported velocity + white noise, and b a first-order
Gauss-Markov process. b is observable as far as the velocity does not contain the position's error: a GPS receiver's
velocity, from Doppler shifts, mostly does not. The better the velocity, the more slowly the remainder of b varies; it
is observable only from sightings of a common target (`frame_offsets.py`). Both axes have the same noise, hence one
covariance.
"""

from math import exp, hypot, sqrt

from estimation.settings import OwnFilterSettings
from estimation.state import Telemetry

_BOUND_SIGMAS = 3.0
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
