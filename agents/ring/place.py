"""The place on the ring: the neighbours ahead and behind, the spacing errors, and the gain that corrects them."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import cos, sin, tau
from typing import Final

_FASTEST_MODE_PER_S = 3.0
"""With references that are received late and extrapolated, the spacing is stable only while half of this times their
age is less than 1. This leaves 0.6 s for late or lost messages.
"""


class RingPlace:
    """A vehicle's place among the `members` on the ring, itself included.

    `lead_rad` and `lag_rad` in (0, 2 pi] are the angles to the vehicle in front and from the one behind; alone on the
    ring both are None.
    """

    def __init__(self, members: int, lead_rad: float | None, lag_rad: float | None) -> None:
        self.members: Final = members
        self.lead_rad: Final = lead_rad
        self.lag_rad: Final = lag_rad

    @property
    def desired_rad(self) -> float:
        """The even spacing of the members - (15)."""
        return tau / self.members


def ring_place(bearing_rad: float, other_bearings_rad: Iterable[float]) -> RingPlace:
    """Find the neighbours of a vehicle on the ring from the bearings of all about the target - (16)."""
    ahead = [(other - bearing_rad) % tau or tau for other in other_bearings_rad]
    if not ahead:
        return RingPlace(1, None, None)
    # A member at the vehicle's own bearing counts as one turn ahead and one turn behind.
    farthest_rad = max(ahead)
    if farthest_rad == tau:
        farthest_rad = max((angle for angle in ahead if angle < tau), default=0.0)
    return RingPlace(len(ahead) + 1, min(ahead), tau - farthest_rad)


def spacing_errors_rad(bearings_rad: Sequence[float]) -> list[float]:
    """Return `(phi_lead - phi_lag) / 2` of every vehicle on the ring from the bearings of all, in their order.

    It is the angle from a vehicle ahead to the middle between its neighbours; 0 alone on the ring.
    """
    members = len(bearings_rad)
    turned = [bearing % tau or tau for bearing in bearings_rad]
    order = sorted(range(members), key=turned.__getitem__)
    placed = [turned[each] for each in order]
    ahead = [after - here for here, after in pairwise(placed)]
    ahead.append(placed[0] - placed[-1] + tau)
    errors, behind = [0.0] * members, ahead[-1]
    for each, gap in zip(order, ahead, strict=True):
        errors[each] = (gap - behind) / 2.0
        behind = gap
    return errors


def spacing_decay_per_s(members: int, gain_per_s: float) -> float:
    """Return the decay rate of the slowest spacing error on a ring of at least two [1/s] - (20).

    It equals the gain, except on a ring so large that the bound on the fastest mode reduces it.
    """
    return 2.0 / 3.0 * scaled_gain_per_s(members, gain_per_s) * (1.0 - cos(tau / members))


def scaled_gain_per_s(members: int, gain_per_s: float) -> float:
    """Return gamma such that the slowest ring mode, of `(2 gamma / 3) (1 - cos(2 pi k / n))`, decays at the gain.

    It is bounded: the fastest mode of a large ring, up to `4 gamma / 3`, would otherwise be faster than the messages.
    """
    return min(gain_per_s * 1.5 / (1.0 - cos(tau / members)), max(gain_per_s, 0.75 * _FASTEST_MODE_PER_S))


def chord_m(radius_m: float, members: int) -> float:
    """Return the distance between evenly spaced neighbours on the ring, `2 R sin(pi / n)`."""
    return float(2.0 * radius_m * sin(tau / 2.0 / members))
