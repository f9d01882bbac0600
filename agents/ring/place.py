"""The place on the ring: the neighbours ahead and behind, and how far a vehicle is from its place.

Ahead is counter-clockwise, whichever way the ring turns.
"""

from collections.abc import Iterable, Mapping, Sequence
from math import sin, tau
from typing import Final, NamedTuple

Gaps = Mapping[int, float]
"""The weights of the gaps ahead of vehicles, by id, 1 for others. The wanted gaps are in proportion to the weights of
the vehicles on the ring.
"""
EVEN: Final[Gaps] = {}


def weights_of(ids: Iterable[int], gaps: Gaps) -> list[float]:
    """Return the weights of the gaps ahead of vehicles."""
    return [gaps.get(each, 1.0) for each in ids] if gaps else [1.0 for _ in ids]


def even_places(weights: Sequence[float]) -> float:
    """Return how many vehicles, evenly spaced, are as near to each other as the nearest with gaps of these weights."""
    return sum(weights) / min(weights)


class RingPlace:
    """A vehicle's place among the `members` on the ring, itself included.

    `lead_rad` and `lag_rad` in (0, 2 pi] are the angles to the vehicle in front and from the one behind; alone on the
    ring both are None. `desired_rad` and `desired_lag_rad` are what they should be, None for even gaps.
    """

    def __init__(
        self,
        members: int,
        lead_rad: float | None,
        lag_rad: float | None,
        desired_rad: float | None = None,
        desired_lag_rad: float | None = None,
    ) -> None:
        self.members: Final = members
        self.lead_rad: Final = lead_rad
        self.lag_rad: Final = lag_rad
        self.desired_rad: Final = tau / members if desired_rad is None else desired_rad
        self.desired_lag_rad: Final = tau / members if desired_lag_rad is None else desired_lag_rad

    @property
    def error_rad(self) -> float:
        """The angle ahead by which the law corrects the rate between neighbours - (22); 0 alone on the ring.

        With even gaps it is `(phi_lead - phi_lag) / 3`.
        """
        if self.lead_rad is None or self.lag_rad is None:
            return 0.0
        of_lead = 2.0 * self.desired_lag_rad / (self.desired_rad + self.desired_lag_rad)
        of_lag = 2.0 * self.desired_rad / (self.desired_rad + self.desired_lag_rad)
        return (of_lead * self.lead_rad - of_lag * self.lag_rad) / 3.0


class RingSize(NamedTuple):
    """How many vehicles are on a ring, and the sum of the weights of their gaps."""

    members: int
    weights: float


def ring_place(
    bearing_rad: float,
    other_bearings_rad: Sequence[float],
    weights: Sequence[float] = (),
    size: RingSize | None = None,
) -> RingPlace:
    """Find the neighbours of a vehicle from the bearings of all about the target, and the wanted gaps - (15), (16).

    `weights` are those of the gaps, the vehicle's own first; all are 1 if it is empty. `size` is that of the ring where
    the others are only those that may be next to the vehicle.
    """
    if not other_bearings_rad:
        return RingPlace(1, None, None)
    own, *others = weights or [1.0] * (1 + len(other_bearings_rad))
    members, whole = size or (1 + len(others), own + sum(others))
    unit_rad, ahead = tau / whole, [(other - bearing_rad) % tau for other in other_bearings_rad]
    # A member at the vehicle's own bearing counts as one turn ahead and one turn behind.
    farthest_rad, behind = max(zip([angle % tau for angle in ahead], others, strict=True))
    lead_rad = min([angle or tau for angle in ahead])
    return RingPlace(members, lead_rad, tau - farthest_rad, own * unit_rad, behind * unit_rad)


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


_ABREAST_RAD: Final = 2e-3
"""Of vehicles at one bearing, such as a column that comes to the ring, that with the lower id counts as behind: without
this, each could take itself for the first, and both would fly to one place.
"""


def place_errors_rad(bearings_rad: Sequence[float], ids: Sequence[int], gaps: Gaps = EVEN) -> list[float]:
    """Return `mean_j psi_j - psi_i` of every vehicle on the ring from the bearings of all - (19), (21).

    `psi_i = phi_i - offset_i`, where the offset is the sum of the wanted gaps from the first vehicle counter-clockwise,
    `2 pi k_i / n` for the k-th of n with even gaps. It is the angle from a vehicle ahead to its place among places that
    are turned to the vehicles' mean, and 0 in sum. With even gaps on a ring of three it is `(phi_lead - phi_lag) / 3`.
    """
    count, weights = len(ids), weights_of(ids, gaps)
    unit_rad, before = tau / sum(weights), 0.0
    apart_rad, told_apart, turns = [0.0] * count, [0.0] * count, [0.0] * count
    for rank, index in enumerate(sorted(range(count), key=ids.__getitem__)):
        apart_rad[index] = rank * _ABREAST_RAD
        told_apart[index] = (bearings_rad[index] + apart_rad[index]) % tau
    for index in sorted(range(count), key=told_apart.__getitem__):
        turns[index] = told_apart[index] - apart_rad[index] - before * unit_rad
        before += weights[index]
    mean_rad = sum(turns) / count
    return [mean_rad - turn for turn in turns]


def chord_m(radius_m: float, members: float) -> float:
    """Return the distance between evenly spaced neighbours on the ring, `2 R sin(pi / n)`; see `even_places`."""
    return float(2.0 * radius_m * sin(tau / 2.0 / members))
