"""Innovation consistency of a filter (normalised innovation squared, NIS), and the control authority derived from it.

If the model is right, the squared innovation, normalised by its covariance, averages 1 per degree of freedom.
"""

from math import exp

RISE_S, FALL_S = 1.0, 6.0
"""Time constants of the average: it rises fast and falls slowly."""
FULL_UP_TO, LEAST_FROM = 4.0, 16.0
"""Averages up to which a filter has full authority, and from which it has the least. Because the average rises faster
than it falls, it is 1.7 for a consistent filter: the bounds are errors 1.5 times and 3 times as large as expected.
"""
AUTHORITY_LEAST = 0.1


class Consistency:
    """A running average of normalised squared innovations, and the authority derived from it.

    A model that does not match its vehicle lowers the authority, in (0, 1]: the share of feedback and compensation in
    the setpoint. The rest is the model's feed-forward, which a wrong model cannot destabilise.
    """

    def __init__(self) -> None:
        """Start with full authority."""
        self._mean = 1.0

    @property
    def innovation(self) -> float:
        """The averaged normalised squared innovation per degree of freedom; 1 is expected."""
        return self._mean

    @property
    def authority(self) -> float:
        """The share of feedback and disturbance compensation in the setpoint."""
        share = (LEAST_FROM - self._mean) / (LEAST_FROM - FULL_UP_TO)
        return min(max(share, AUTHORITY_LEAST), 1.0)

    def see(self, squared: float, step_s: float, most: float) -> None:
        """Add one normalised squared innovation, per degree of freedom, `step_s` after the previous one.

        Outliers are clipped to `most`.
        """
        squared = squared if squared < most else most  # also NaN
        over_s = RISE_S if squared > self._mean else FALL_S
        self._mean += (1.0 - exp(-step_s / over_s)) * (squared - self._mean)
