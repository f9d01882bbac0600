"""The guard's demands on the vehicle's acceleration: one half-plane `normal . a >= least` for each constraint.

Each is derived from a barrier h that has to stay positive: `h'' + 2 k h' + k^2 h >= 0` keeps it positive for a
second-order plant. All values are at the moment when the setpoint acts.
"""

from collections.abc import Iterable, Iterator, Mapping
from enum import IntEnum
from math import hypot, sqrt
from typing import Final

from agents.notes import GuardCause
from agents.safety.fence import NearestPoint
from estimation.vectors import Pair, length

_NEAR_M: Final = 1e-6


class Cause(IntEnum):
    """The cause of a demand. If not all can be met, demands are relaxed in this order.

    Separation is relaxed only if the vehicle's reach does not suffice. At a boundary a vehicle cannot always do its
    half of an evasion. The other one sees that and does more, so there the distance beyond `separation_m`, the margin,
    is relaxed first.
    """

    SPEED = 0
    KEEP_OUT = 1
    TRAFFIC = 2
    MARGIN = 3
    FENCE = 4
    NO_FLY = 5
    SEPARATION = 6
    REACH = 7

    @property
    def words(self) -> GuardCause:
        """The cause as text."""
        return _WORDS[self]


_WORDS: Mapping[Cause, GuardCause] = {
    Cause.SPEED: "speed",
    Cause.KEEP_OUT: "keep out",
    Cause.TRAFFIC: "traffic",
    Cause.MARGIN: "separation",
    Cause.FENCE: "fence",
    Cause.NO_FLY: "no-fly zone",
    Cause.SEPARATION: "separation",
    Cause.REACH: "reach",
}


class Demand:
    """`normal . acceleration >= least_m_s2`, with a unit normal; with `evades` the vehicle passes on the right.

    `vehicle_id` is the vehicle that the demand keeps apart from, 0 without one.
    """

    def __init__(
        self, cause: Cause, normal: Pair, least_m_s2: float, evades: bool = False, vehicle_id: int = 0
    ) -> None:
        self.cause: Final = cause
        self.normal: Final = normal
        self.least_m_s2: Final = least_m_s2
        self.evades: Final = evades
        self.vehicle_id: Final = vehicle_id

    def met_by(self, acceleration_m_s2: Pair) -> bool:
        """Return whether an acceleration meets the demand."""
        return self.normal[0] * acceleration_m_s2[0] + self.normal[1] * acceleration_m_s2[1] >= self.least_m_s2


class Body:
    """A body to keep away from: its position, velocity and acceleration, and the distance to keep.

    A body that `shares` evades as well: each vehicle then takes half of the demand. `vehicle_id` is 0 if it is none.
    """

    def __init__(
        self,
        position_m: Pair,
        velocity_m_s: Pair,
        acceleration_m_s2: Pair,
        distance_m: float,
        shares: bool,
        vehicle_id: int = 0,
    ) -> None:
        self.position_m: Final = position_m
        self.velocity_m_s: Final = velocity_m_s
        self.acceleration_m_s2: Final = acceleration_m_s2
        self.distance_m: Final = distance_m
        self.shares: Final = shares
        self.vehicle_id: Final = vehicle_id

    def nearer(self, distance_m: float) -> "Body":
        """Return the body with this distance to keep, if that is less."""
        place, velocity, acceleration = self.position_m, self.velocity_m_s, self.acceleration_m_s2
        kept_m = min(self.distance_m, distance_m)
        return Body(place, velocity, acceleration, kept_m, self.shares, self.vehicle_id)


def apart(position_m: Pair, velocity_m_s: Pair, body: Body, rate_per_s: float, cause: Cause) -> Demand:
    """Demand the distance to a body: h = |dp|^2 - d^2, h' = 2 dp.dv, h'' = 2 |dv|^2 + 2 dp.(a - a_body)."""
    dx, dy = position_m[0] - body.position_m[0], position_m[1] - body.position_m[1]
    away_m = length(dx, dy)
    normal = (dx / away_m, dy / away_m) if away_m > _NEAR_M else (1.0, 0.0)
    away_m = max(away_m, _NEAR_M)
    rel_x, rel_y = velocity_m_s[0] - body.velocity_m_s[0], velocity_m_s[1] - body.velocity_m_s[1]
    opening_m_s = normal[0] * rel_x + normal[1] * rel_y
    gap_m2 = away_m**2 - body.distance_m**2
    # The condition without its acceleration terms, divided by 2 |dp|.
    rest = (rel_x**2 + rel_y**2) / away_m + 2.0 * rate_per_s * opening_m_s + rate_per_s**2 * gap_m2 / (2.0 * away_m)
    if body.shares:
        return Demand(cause, normal, -rest / 2.0, evades=True, vehicle_id=body.vehicle_id)
    its = normal[0] * body.acceleration_m_s2[0] + normal[1] * body.acceleration_m_s2[1]
    return Demand(cause, normal, its - rest, evades=True, vehicle_id=body.vehicle_id)


def demanded_from_m(speed_m_s: float, distance_m: float, rate_per_s: float) -> float:
    """Return how near a vehicle that flies straight towards a resting body is when `apart` first demands to brake."""
    return (2.0 * speed_m_s + sqrt(2.0 * speed_m_s**2 + (rate_per_s * distance_m) ** 2)) / rate_per_s


def within(
    points: Iterable[NearestPoint], velocity_m_s: Pair, margin_m: float, rate_per_s: float, cause: Cause
) -> Iterator[Demand]:
    """Demand to stay on the free side of a boundary: h = distance - margin for each edge, by its nearest point."""
    for point in points:
        closing_m_s = point.inward[0] * velocity_m_s[0] + point.inward[1] * velocity_m_s[1]
        rest = 2.0 * rate_per_s * closing_m_s + rate_per_s**2 * (point.distance_m - margin_m)
        yield Demand(cause, point.inward, -rest)


def slow(velocity_m_s: Pair, speed_max_m_s: float, rate_per_s: float) -> Iterator[Demand]:
    """Demand the speed limit: h = v_max^2 - |v|^2 is of first order, `h' + 2 k h >= 0`."""
    speed_m_s = hypot(*velocity_m_s)
    if speed_m_s > speed_max_m_s / 2.0:
        normal = -velocity_m_s[0] / speed_m_s, -velocity_m_s[1] / speed_m_s
        yield Demand(Cause.SPEED, normal, -rate_per_s * (speed_max_m_s**2 - speed_m_s**2) / speed_m_s)


def unsure_m(sigmas: float, own_sigma_m: float, other_sigma_m: float) -> float:
    """Return the distance margin for the uncertainty of two estimates."""
    return sigmas * sqrt(own_sigma_m**2 + other_sigma_m**2)
