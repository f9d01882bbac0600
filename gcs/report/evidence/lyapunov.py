"""The Lyapunov function of the ring's spacings as flown, and the decay expected from the spacing law.

`V = 1/2 sum e_i^2` over the errors `e_i` of the angles from each vehicle on the ring to the next. Where each error
decays at the gain gamma, V decays at twice that: `V(t) = V(t0) exp(-2 gamma (t - t0))`.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import log

import numpy as np

from estimation.state import Vector
from gcs.metrics.ring import RingMotion

# V counts as decayed below this share of its initial value: every error to a tenth.
DECAYED_SHARE = 0.01


@dataclass(frozen=True, slots=True)
class Decay:
    """The decay of V while the members of the ring are the same: from `start_s`, when V was `start_rad2`, to `end_s`.

    `decay_per_s` is the expected rate of decay of V, None without a gain. `decayed_after_s` is the time after which V
    stayed below `DECAYED_SHARE` of its initial value until `end_s`; None if it did not.
    """

    members: int
    start_s: float
    end_s: float
    start_rad2: float
    decay_per_s: float | None
    decayed_after_s: float | None

    @property
    def expected_after_s(self) -> float | None:
        """The expected time until V is below `DECAYED_SHARE` of its initial value; None without a gain."""
        return -log(DECAYED_SHARE) / self.decay_per_s if self.decay_per_s else None

    def expected_rad2(self, time_s: Vector) -> Vector:
        """Return the expected V at each time; NaN outside of `start_s` to `end_s` and without a gain."""
        if self.decay_per_s is None:
            return np.full(time_s.shape, np.nan)
        inside = (time_s >= self.start_s) & (time_s <= self.end_s)
        since_s = np.where(inside, time_s - self.start_s, 0.0)
        return np.where(inside, self.start_rad2 * np.exp(-self.decay_per_s * since_s), np.nan)


def lyapunov_rad2(motion: RingMotion) -> Vector:
    """Return V (T,) of the ring, from the errors of all its spacings - (17), (18).

    NaN with fewer than two members, or where one of them was not received.
    """
    error_rad = motion.lead_rad - motion.desired_spacing_rad
    known = np.isfinite(error_rad)
    whole = (known == motion.member).all(axis=0) & (motion.member.sum(axis=0) > 1)
    squares = np.where(known, error_rad, 0.0) ** 2
    return np.where(whole, 0.5 * squares.sum(axis=0), np.nan)


def decays(time_s: Vector, motion: RingMotion, gain_per_s: float | None) -> tuple[Decay, ...]:
    """Return the decay of V for each period with the same members on the ring - (20).

    V restarts with every change.
    """
    value_rad2 = lyapunov_rad2(motion)
    if not time_s.size:
        return ()
    changed = np.flatnonzero((np.diff(motion.member.astype(int), axis=1) != 0).any(axis=0)) + 1
    bounds = [0, *changed.tolist(), time_s.size]
    periods = (
        _decay(time_s[first:last], value_rad2[first:last], int(motion.member[:, first].sum()), gain_per_s)
        for first, last in pairwise(bounds)
    )
    return tuple(period for period in periods if period is not None)


def _decay(time_s: Vector, value_rad2: Vector, members: int, gain_per_s: float | None) -> Decay | None:
    known = np.flatnonzero(np.isfinite(value_rad2))
    if not known.size:
        return None
    start = int(known[0])
    above = known[value_rad2[known] > DECAYED_SHARE * value_rad2[start]]
    after = known[known > above[-1]] if above.size else known
    return Decay(
        members,
        float(time_s[start]),
        float(time_s[-1]),
        float(value_rad2[start]),
        None if gain_per_s is None else 2.0 * gain_per_s,
        float(time_s[after[0]] - time_s[start]) if after.size else None,
    )
