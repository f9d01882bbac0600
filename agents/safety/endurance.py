"""Whether the battery suffices for the flight home: the time that it takes, and the flight time that is left."""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from math import dist, inf
from typing import Final

from agents.safety.routes import Way, way_of
from agents.settings.config import AgentConfig
from estimation.vectors import Pair

SINK_SLOWEST_M_S: Final = 0.5
"""ArduCopter lands at this rate, PX4 at 0.7 m/s."""
WAY_SLOWEST: Final = 0.2
"""The assumed share of its speed that a vehicle keeps against any wind, which bounds the duration."""
FOUND_EVERY_M: Final = 5.0
"""How far a vehicle flies until its way home is found anew, which takes milliseconds."""
WINDOW_S: Final = 180.0
KNOWN_AFTER_S: Final = 60.0
"""The window over which the discharge is measured, and the shortest one that is used."""
CHANGES_MIN: Final = 4
PAUSE: Final = 4.0
"""After this many usual intervals without a change the measured discharge rate is invalid."""


def return_duration_s(
    config: AgentConfig,
    way_m: Sequence[Pair],
    place_m: Pair,
    height_m: float,
    disturbance_m_s2: Pair,
) -> float:
    """Return the time that the vehicle takes to climb to its layer, fly home or to a rally point, and land [s].

    It flies over the places of `way_m`, as from `WayHome`; none: straight. The setpoint leads by v a1/a0, where v is
    `formation.speed_max_m_s`. With a steady disturbance w along a leg of the way the plant's speed is v + w / a1. A
    head wind is counted without compensation, a tail wind is not counted. Without a home the vehicle lands where it is.
    """
    spots_m = config.landing_places_m
    places_m = way_m or (min(spots_m, key=lambda spot_m: dist(spot_m, place_m), default=place_m),)
    landing_s = max(height_m, config.return_altitude_m if places_m[-1] != place_m else height_m) / SINK_SLOWEST_M_S
    if places_m[-1] == place_m:
        return landing_s
    legs_s = [_leg_s(config, *leg, disturbance_m_s2) for leg in pairwise((place_m, *places_m))]
    return config.rising_s + sum(legs_s) + landing_s


def _leg_s(config: AgentConfig, from_m: Pair, to_m: Pair, disturbance_m_s2: Pair) -> float:
    """Return how long a straight leg of the way home takes [s]."""
    leg_m = dist(from_m, to_m)
    if leg_m == 0.0:
        return 0.0
    along = disturbance_m_s2[0] * (to_m[0] - from_m[0]) + disturbance_m_s2[1] * (to_m[1] - from_m[1])
    damping_per_s = min(config.plant.x.a1_per_s, config.plant.y.a1_per_s)
    speed_m_s = config.formation.speed_max_m_s
    return leg_m / max(speed_m_s + min(along / leg_m, 0.0) / damping_per_s, WAY_SLOWEST * speed_m_s)


class WayHome:
    """The way of one vehicle around no-fly zones to its nearest landing place; it is found anew every few metres."""

    def __init__(self, config: AgentConfig) -> None:
        self._way: Way | None = None
        self.change(config)

    def change(self, config: AgentConfig) -> None:
        """Come home from the heights of another ring from now on."""
        self._spots_m = config.landing_places_m
        self._way = way_of(config, config.formation.speed_max_m_s, before=self._way) if self._spots_m else None
        self._from_m: Pair | None = None
        self._places_m: tuple[Pair, ...] = ()

    def places_m(self, place_m: Pair) -> tuple[Pair, ...]:
        """Return the places of the way from about a place, the last one the landing place; empty if it is straight."""
        if self._way is not None and (self._from_m is None or dist(self._from_m, place_m) > FOUND_EVERY_M):
            self._from_m, self._places_m = place_m, self._way.places_m(place_m, *self._spots_m)
        return self._places_m


class Endurance:
    """The remaining flight time of a battery until its charge is critical, when the vehicle lands in place.

    It is the autopilot's estimate, if reported, scaled to the charge above the critical one; otherwise that charge
    divided by the discharge rate of the last three minutes.
    """

    def __init__(self, critical: float) -> None:
        self._critical = critical
        self._changes: deque[tuple[float, float]] = deque()
        self._endurance_s: float | None = None

    def see(self, now_s: float, battery: float | None, endurance_s: float | None) -> None:
        """Take the charge (a fraction) and the flight time until empty [s] that the autopilot reports."""
        self._endurance_s = endurance_s
        changes = self._changes
        if battery is None or (changes and battery > changes[-1][1]):
            changes.clear()  # unknown, or the voltage recovers at a lower load
        if battery is None or (changes and battery == changes[-1][1]):
            return
        changes.append((now_s, battery))
        while now_s - changes[0][0] > WINDOW_S:
            changes.popleft()

    def left_s(self, now_s: float) -> float:
        """Return the remaining flight time [s]; infinite while it is unknown."""
        if not self._changes:
            return inf
        (first_s, full), (last_s, left) = self._changes[0], self._changes[-1]
        usable = max(left - self._critical, 0.0)
        if self._endurance_s is not None:
            return self._endurance_s * usable / left if left else 0.0
        spent_s, intervals = last_s - first_s, len(self._changes) - 1
        if spent_s < KNOWN_AFTER_S or intervals < CHANGES_MIN or now_s - last_s > PAUSE * spent_s / intervals:
            return inf
        return usable * spent_s / (full - left) - (now_s - last_s)
