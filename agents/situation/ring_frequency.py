"""The rate at which a vehicle goes around the target: the disturbance of a wrong plant swings at that rate.

On the ring that is the ring's rate in steady state. But a vehicle whose plant is wrong goes around more slowly
until its disturbance is estimated, and an oscillator faster than it flies estimates that late.
"""

_FOLLOWS_S = 20.0
"""Longer than the noise in estimates of the rate lasts, no longer than a ring takes: half a minute to two."""
_OFF_MOST = 0.2
"""Of the ring's rate: a vehicle on its way to the ring does not go around yet."""


class RingFrequency:
    """Follows the share of the ring's angular rate at which one vehicle goes around."""

    def __init__(self, rate_hz: float) -> None:
        self._gain = 1.0 / (_FOLLOWS_S * rate_hz)
        self._share = 1.0
        self.rate_rad_s = 0.0

    def follow(self, ring_rad_s: float, flown_rad_s: float | None = None) -> None:
        """Take the ring's angular rate, 0 off the ring, and once a tick the one that is flown."""
        if not ring_rad_s:
            self._share = 1.0
        elif flown_rad_s is not None:
            share = self._share + self._gain * (flown_rad_s / ring_rad_s - self._share)
            self._share = min(max(share, 1.0 - _OFF_MOST), 1.0 + _OFF_MOST)
        self.rate_rad_s = self._share * ring_rad_s
