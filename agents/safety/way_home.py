"""Whether a vehicle can still return and land: its remaining flight time, and how long the way home takes."""

from collections import deque
from math import hypot, inf

from agents.settings.config import AgentConfig

SINK_SLOWEST_M_S = 0.5
"""ArduCopter lands at this rate, PX4 at 0.7 m/s."""
WAY_SLOWEST = 0.2
"""Share of its speed that a vehicle is taken to keep against any wind: the way home has an end."""
WINDOW_S, KNOWN_AFTER_S = 180.0, 60.0
"""The discharge is measured over so long, and not before it has been watched for a minute."""
CHANGES_MIN = 4
PAUSE = 4.0
"""A battery that has not changed for so many of its usual intervals is not discharging at the measured rate."""


def way_home_s(
    config: AgentConfig,
    place_m: tuple[float, float],
    height_m: float,
    disturbance_m_s2: tuple[float, float],
) -> float:
    """Return how long the vehicle takes to rise to its layer, fly home and land [s].

    On the way the setpoint leads by v a1/a0, v being `formation.speed_max_m_s`. The plant's speed under it and a steady
    disturbance w along the way is v + w / a1: that of a head wind without any compensation is assumed, and no gain from
    a tail wind. Without a home it lands where it is.
    """
    x, y = place_m
    home_x, home_y = config.home_m or place_m
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
    """The remaining flight time of a battery, until its charge is critical: by then the vehicle lands anywhere.

    It is the autopilot's own where that reports one, scaled to the charge above the critical one, otherwise that charge
    by the rate of discharge within the last three minutes.
    """

    def __init__(self, critical: float) -> None:
        """Take the critical charge, a fraction."""
        self._critical = critical
        self._changes: deque[tuple[float, float]] = deque()
        self._endurance_s: float | None = None

    def see(self, now_s: float, battery: float | None, endurance_s: float | None) -> None:
        """Take the charge (a fraction) and the flight time until empty [s] that the autopilot reports."""
        self._endurance_s = endurance_s
        changes = self._changes
        if battery is None or (changes and battery > changes[-1][1]):
            changes.clear()  # unknown, or a voltage that recovers under less load
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
