"""A coordinate of a reference that moves within bounds on acceleration and jerk."""

from math import ceil, copysign, sqrt

import msgspec

from estimation.vectors import limited


class ShapedCoordinate(msgspec.Struct, frozen=True):
    """A value, its rate and its acceleration; the units are the value's, per second."""

    value: float
    rate: float
    acceleration: float = 0.0

    def follow(self, rate_wanted: float, acceleration_max: float, jerk_max: float, step_s: float) -> "ShapedCoordinate":
        """Return it a step later: the rate moves to the one wanted."""
        missing, change_max = rate_wanted - self.rate, jerk_max * step_s
        # The largest acceleration that the jerk can end in whole steps as the rate is reached: a + (a - c) + ... = due.
        due = abs(missing) / step_s
        steps = max(1, ceil((sqrt(1.0 + 8.0 * due / change_max) - 1.0) / 2.0))
        endable = due / steps + change_max * (steps - 1) / 2.0
        wanted = copysign(min(acceleration_max, endable), missing)
        # Braking from beyond the bounds ends at once: it would overshoot while the jerk takes it back.
        before = limited(self.acceleration, acceleration_max)
        acceleration = before + limited(wanted - before, change_max)
        rate = self.rate + acceleration * step_s
        return ShapedCoordinate(self.value + (self.rate + rate) / 2.0 * step_s, rate, acceleration)

    def near(self, value: float, rate: float, off_max: float, share: float) -> "ShapedCoordinate":
        """Return it at most `off_max` from a value, and of what is left off that and off its rate only a share."""
        off = limited(self.value - value, off_max)
        return ShapedCoordinate(value + share * off, rate + share * (self.rate - rate), self.acceleration)
