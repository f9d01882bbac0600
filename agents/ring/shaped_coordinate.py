"""A coordinate of a reference that moves within bounds on acceleration and jerk."""

from math import ceil, copysign, sqrt
from typing import Final

from estimation.vectors import limited


class ShapedCoordinate:
    """A value, its rate and its acceleration, in the value's unit, per second and per second squared."""

    def __init__(self, value: float, rate: float, acceleration: float = 0.0) -> None:
        self.value: Final = value
        self.rate: Final = rate
        self.acceleration: Final = acceleration

    def follow(self, rate_wanted: float, acceleration_max: float, jerk_max: float, step_s: float) -> "ShapedCoordinate":
        """Return the coordinate a step later, its rate moved towards the one wanted."""
        missing, change_max = rate_wanted - self.rate, jerk_max * step_s
        # The largest acceleration that the jerk can end in whole steps as the rate is reached: a + (a - c) + ... = due.
        due = abs(missing) / step_s
        steps = max(1, ceil((sqrt(1.0 + 8.0 * due / change_max) - 1.0) / 2.0))
        endable = due / steps + change_max * (steps - 1) / 2.0
        wanted = copysign(min(acceleration_max, endable), missing)
        # Braking beyond the bounds ends at once: reducing it by the jerk would overshoot.
        before = limited(self.acceleration, acceleration_max)
        acceleration = before + limited(wanted - before, change_max)
        rate = self.rate + acceleration * step_s
        return ShapedCoordinate(self.value + (self.rate + rate) / 2.0 * step_s, rate, acceleration)

    def near(self, value: float, rate: float, off_max: float, share: float) -> "ShapedCoordinate":
        """Return the coordinate within `off_max` of a value, with its offsets from value and rate scaled by `share`."""
        off = limited(self.value - value, off_max)
        return ShapedCoordinate(value + share * off, rate + share * (self.rate - rate), self.acceleration)
