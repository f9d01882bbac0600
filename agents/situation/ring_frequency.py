"""The ring frequency: a vehicle's angular rate about the target, at which a wrong plant's disturbance oscillates.

In steady state it is the ring's rate. A vehicle with a wrong plant flies more slowly until its disturbance is
estimated, and an oscillator at a higher frequency estimates the disturbance late.
"""

_FOLLOWS_S = 20.0
"""Time constant: longer than the noise in rate estimates lasts, at most one turn of a ring, 30 s to 2 min."""
_OFF_MOST = 0.2
"""The largest deviation, as a share of the ring's rate: a vehicle on its way to the ring does not circle yet."""


class RingFrequency:
    """Estimates one vehicle's angular rate as a share of the ring's."""

    def __init__(self, rate_hz: float) -> None:
        self._gain = 1.0 / (_FOLLOWS_S * rate_hz)
        self._share = 1.0
        self.rate_rad_s = 0.0

    def follow(self, ring_rad_s: float, flown_rad_s: float | None = None) -> None:
        """Take the ring's angular rate, 0 off the ring, and once a tick the flown one."""
        if not ring_rad_s:
            self._share = 1.0
        elif flown_rad_s is not None:
            share = self._share + self._gain * (flown_rad_s / ring_rad_s - self._share)
            self._share = min(max(share, 1.0 - _OFF_MOST), 1.0 + _OFF_MOST)
        self.rate_rad_s = self._share * ring_rad_s
