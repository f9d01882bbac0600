"""The place on the ring: the neighbours ahead and behind, and how far a vehicle is from its place."""

from collections.abc import Iterable, Sequence
from math import sin, tau
from typing import Final


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

    @property
    def error_rad(self) -> float:
        """The angle ahead `(phi_lead - phi_lag) / 3` by which the law corrects the rate - (22); 0 alone on the ring."""
        return 0.0 if self.lead_rad is None or self.lag_rad is None else (self.lead_rad - self.lag_rad) / 3.0


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


_Neighbour = tuple[float, float]
Neighbours = tuple[_Neighbour, _Neighbour]
"""The vehicles behind and in front: the angle to each, and its angular rate."""


def neighbours(bearing_rad: float, others: Sequence[tuple[float, float, float]]) -> Neighbours | None:
    """Find the neighbours of a vehicle about the target, None if it is alone.

    `others` are their bearings and rates, and by how much nearer each may be because it is farther out or in: the angle
    to it counts as so much larger.
    """
    if not others:
        return None
    ahead = [((other_rad - bearing_rad) % tau, rate_rad_s, spare_rad) for other_rad, rate_rad_s, spare_rad in others]
    # A vehicle at the same bearing counts as one turn ahead and one turn behind.
    behind = min((tau - angle_rad + spare_rad, rate_rad_s) for angle_rad, rate_rad_s, spare_rad in ahead)
    return behind, min(((angle_rad or tau) + spare_rad, rate_rad_s) for angle_rad, rate_rad_s, spare_rad in ahead)


_ABREAST_RAD = 2e-3
"""Of vehicles at one bearing, such as a column that comes to the ring, that with the lower id counts as behind: without
this, each could take itself for the first, and both would fly to one place.
"""


def place_errors_rad(bearings_rad: Sequence[float], ids: Sequence[int]) -> list[float]:
    """Return `mean_j psi_j - psi_i` of every vehicle on the ring from the bearings of all - (19), (21).

    `psi_i = phi_i - 2 pi k_i / n` for the k-th of n vehicles counter-clockwise. It is the angle from a vehicle ahead to
    its place among n even places that are turned to the vehicles' mean, and 0 in sum. On a ring of three it is
    `(phi_lead - phi_lag) / 3`.
    """
    even_rad, apart_rad = tau / len(ids), [0.0] * len(ids)
    for count, index in enumerate(sorted(range(len(ids)), key=ids.__getitem__)):
        apart_rad[index] = count * _ABREAST_RAD
    told_apart = [(bearing + apart) % tau for bearing, apart in zip(bearings_rad, apart_rad, strict=True)]
    turns = [0.0] * len(ids)
    for rank, index in enumerate(sorted(range(len(ids)), key=told_apart.__getitem__)):
        turns[index] = told_apart[index] - apart_rad[index] - rank * even_rad
    mean_rad = sum(turns) / len(turns)
    return [mean_rad - turn for turn in turns]


def chord_m(radius_m: float, members: int) -> float:
    """Return the distance between evenly spaced neighbours on the ring, `2 R sin(pi / n)`."""
    return float(2.0 * radius_m * sin(tau / 2.0 / members))
