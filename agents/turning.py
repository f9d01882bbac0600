"""At which rate a vehicle goes around: what of its plant is unexplained swings at that rate.

On the ring that is the ring's rate in the end. But a vehicle whose plant file is wrong goes around more slowly until it
has learned by how much, and learns that late if it looks for something that swings faster than it flies.
"""

_FOLLOWS_S = 5.0
_OFF_MOST = 0.2
"""Of the ring's rate: who is on the way to the ring does not go around yet."""


class Turning:
    """Follows the angular rate at which one vehicle goes around."""

    def __init__(self, rate_hz: float) -> None:
        self._share = 1.0 / (_FOLLOWS_S * rate_hz)
        self.rate_rad_s = 0.0

    def follow(self, ring_rad_s: float, flown_rad_s: float | None = None) -> None:
        """Take the ring's angular rate, 0 off the ring, and once a tick the one that is flown."""
        rate_rad_s = self.rate_rad_s or ring_rad_s
        if flown_rad_s is not None:
            rate_rad_s += self._share * (flown_rad_s - rate_rad_s)
        slow, fast = sorted(((1.0 - _OFF_MOST) * ring_rad_s, (1.0 + _OFF_MOST) * ring_rad_s))
        self.rate_rad_s = min(max(rate_rad_s, slow), fast)
