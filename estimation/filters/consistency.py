"""Whether a filter's innovations are as large as it says they should be, and how much control may lean on it.

The squared innovation, normalised by its own covariance, is 1 per degree of freedom on average if the model is right.
"""

from math import exp

RISE_S, FALL_S = 1.0, 6.0
"""Over how long the average is taken: doubt comes fast and goes slowly."""
TRUSTED, DOUBTED = 4.0, 16.0
"""Averages up to which a filter has full authority, and from which it has the least. As doubt comes faster than it
goes, errors as expected average to 1.7: these are errors of one and a half times and of three times as much."""
AUTHORITY_LEAST = 0.1


class Consistency:
    """A running average of normalised squared innovations, and the authority that follows from it.

    A model that does not explain its vehicle lowers the authority, in (0, 1]: the share of feedback and compensation in
    the setpoint. What is left then is the model's feed-forward, which no wrong model can make unstable.
    """

    def __init__(self) -> None:
        """Begin in full trust."""
        self._mean = 1.0

    @property
    def innovation(self) -> float:
        """The normalised squared innovation per degree of freedom, averaged; 1 is what the filter expects."""
        return self._mean

    @property
    def authority(self) -> float:
        """The share of feedback and compensation that the model deserves."""
        share = (DOUBTED - self._mean) / (DOUBTED - TRUSTED)
        return min(max(share, AUTHORITY_LEAST), 1.0)

    def see(self, squared: float, step_s: float, most: float) -> None:
        """Take in one normalised squared innovation, per degree of freedom, `step_s` after the one before.

        One outlier says little however far out it is: more than `most` counts as `most`.
        """
        squared = squared if squared < most else most  # nor does NaN
        over_s = RISE_S if squared > self._mean else FALL_S
        self._mean += (1.0 - exp(-step_s / over_s)) * (squared - self._mean)
