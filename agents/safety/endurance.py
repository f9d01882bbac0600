"""Whether the battery suffices for the flight home: the time that it takes, and the flight time that is left."""

from collections import deque
from math import dist, hypot, inf

from agents.settings.config import AgentConfig

SINK_SLOWEST_M_S = 0.5
"""ArduCopter lands at this rate, PX4 at 0.7 m/s."""
WAY_SLOWEST = 0.2
"""The assumed share of its speed that a vehicle keeps against any wind, which bounds the duration."""
WINDOW_S, KNOWN_AFTER_S = 180.0, 60.0
"""The window over which the discharge is measured, and the shortest one that is used."""
CHANGES_MIN = 4
PAUSE = 4.0
"""After this many usual intervals without a change the measured discharge rate is invalid."""


def return_duration_s(
    config: AgentConfig,
    place_m: tuple[float, float],
    height_m: float,
    disturbance_m_s2: tuple[float, float],
) -> float:
    """Return the time that the vehicle takes to climb to its layer, fly home or to a rally point, and land [s].

    The setpoint leads by v a1/a0, where v is `formation.speed_max_m_s`. With a steady disturbance w along the route the
    plant's speed is v + w / a1. A head wind is counted without compensation, a tail wind is not counted. Without a home
    the vehicle lands where it is.
    """
    x, y = place_m
    home_x, home_y = min(config.landing_places_m, key=lambda spot_m: dist(spot_m, place_m), default=place_m)
    away_m = hypot(home_x - x, home_y - y)
    landing_s = max(height_m, config.return_altitude_m if away_m else height_m) / SINK_SLOWEST_M_S
    if away_m == 0.0:
        return landing_s
    along_m_s2 = (disturbance_m_s2[0] * (home_x - x) + disturbance_m_s2[1] * (home_y - y)) / away_m
    damping_per_s = min(config.plant.x.a1_per_s, config.plant.y.a1_per_s)
    speed_m_s = config.formation.speed_max_m_s
    slowed_m_s = max(speed_m_s + min(along_m_s2, 0.0) / damping_per_s, WAY_SLOWEST * speed_m_s)
    return config.rising_s + away_m / slowed_m_s + landing_s


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
