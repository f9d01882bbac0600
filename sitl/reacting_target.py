"""Targets that react to the vehicles: each position follows from the true motions, tick by tick."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import hypot

from sitl.vehicle.plant_step import Motion, Pair

Reaction = Callable[[float, Mapping[int, Motion]], Pair]
"""From the time [s] and the vehicles' true motions by id to the target's position [m]; called once a tick, in order."""


@dataclass(frozen=True, slots=True)
class Evasion:
    """How a target evades vehicles: it flees those within `distance_m`, with bounded speed and acceleration.

    With the horizontal distances d of the vehicles, the least one d_min, and the unit vectors e from each vehicle to
    the target, the desired velocity is the speed times the sum of e (distance - d) / (distance - d_min) over the
    vehicles within the distance, at most the speed: straight away from one vehicle, none between vehicles that are
    equally near all around. The velocity follows by at most the acceleration.
    """

    speed_m_s: float
    acceleration_m_s2: float
    distance_m: float

    def velocity_wanted_m_s(self, place_m: Pair, team: Mapping[int, Motion]) -> Pair:
        """Return the desired velocity of a target at a position."""
        away = [(place_m[0] - x, place_m[1] - y) for x, y, _, _ in team.values()]
        near = [(hypot(*each), each) for each in away if 0.0 < hypot(*each) < self.distance_m]
        if not near:
            return 0.0, 0.0
        most_m = self.distance_m - min(distance_m for distance_m, _ in near)
        shares = [((self.distance_m - distance_m) / most_m / distance_m, each) for distance_m, each in near]
        x, y = (sum(share * each[axis] for share, each in shares) for axis in (0, 1))
        return _at_most((self.speed_m_s * x, self.speed_m_s * y), self.speed_m_s)

    def reaction(self, start_m: Pair, rate_hz: float) -> Reaction:
        """Return the reaction of one flight: a target at rest at its start, which decides at each tick for the next."""
        (x, y), (x_rate, y_rate) = start_m, (0.0, 0.0)
        change_max_m_s = self.acceleration_m_s2 / rate_hz
        wanted_x, wanted_y = 0.0, 0.0

        def position_m(_: float, team: Mapping[int, Motion]) -> Pair:
            nonlocal x, y, x_rate, y_rate, wanted_x, wanted_y
            change_x, change_y = _at_most((wanted_x - x_rate, wanted_y - y_rate), change_max_m_s)
            # The acceleration is constant between two ticks.
            x += (x_rate + change_x / 2.0) / rate_hz
            y += (y_rate + change_y / 2.0) / rate_hz
            x_rate, y_rate = x_rate + change_x, y_rate + change_y
            wanted_x, wanted_y = self.velocity_wanted_m_s((x, y), team)
            return x, y

        return position_m


def _at_most(vector: Pair, length: float) -> Pair:
    factor = min(length / hypot(*vector), 1.0) if vector != (0.0, 0.0) else 1.0
    return factor * vector[0], factor * vector[1]


class FlownTarget:
    """The path of a target that reacts, as far as it was flown: `path_m` has a position for each tick."""

    def __init__(self, reaction: Reaction, vehicle_ids: Sequence[int]) -> None:
        self.path_m: list[Pair] = []
        self._reaction = reaction
        self._vehicle_ids = tuple(vehicle_ids)

    def advance(self, now_s: float, motions: Sequence[Motion]) -> None:
        """Move the target to its position at the next tick; `motions` are those of the vehicles, in their order."""
        self.path_m.append(self._reaction(now_s, dict(zip(self._vehicle_ids, motions, strict=True))))

    def position_m(self, _: float) -> Pair:
        """Return the present position."""
        return self.path_m[-1]
