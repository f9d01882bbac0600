"""Where the camera of a vehicle looks: at the estimated target or a given place, whatever the vehicle's own yaw.

The direction is that from the vehicle to the target at the time in the middle of the interval in which it is in force:
it is sent `POINTINGS_HZ` times a second, arrives after the delay of the link, and the gimbal keeps it until the next.
With r = (x, y) the horizontal position of what is looked at from the vehicle and h its height above the vehicle, both
at that time,

    bearing = atan2(y, x), counter-clockwise from the mission's x axis,  elevation = atan2(h, |r|), negative downwards.

Own motion and the target's are extrapolated at constant velocity. On a ring of 10 m that is flown at 0.15 rad/s the
bearing turns by 1.7 degrees in an interval of 0.2 s: half of it is the largest error that remains of a mount without a
lag of its own.
"""

from math import atan2, hypot
from typing import Final

from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from estimation.vectors import Pair

POINTINGS_HZ: Final = 5.0
"""How often a direction is sent: a tenth of what a telemetry radio carries goes to the gimbals of three vehicles."""
EARLY_SHARE: Final = 0.25
"""Share of a tick by which a direction may be early: tick times vary."""
OVERHEAD_M: Final = 0.5
"""Nearer than this to the point above the target the bearing stays as it was: it would turn by half a circle."""


class CameraAim:
    """Computes the direction of one vehicle's camera; its state is the time of the next one, and the last bearing."""

    def __init__(self, config: AgentConfig) -> None:
        self._target_height_m = None if config.gimbal is None else config.gimbal.target_height_m
        self._period_s = max(1.0 / POINTINGS_HZ, 1.0 / config.rate_hz)
        self._early_s = EARLY_SHARE / config.rate_hz
        self._next_s: float | None = None
        self._bearing_rad = 0.0
        self.place_m: Pair | None = None
        """The place to look at, None for the target."""

    def next(self, situation: Situation, link_delay_s: float, target_altitude_m: float | None) -> tuple[float, ...]:
        """Return the elevation and the bearing [rad] that are due, to be called once a tick; empty if none is due.

        None is due without a gimbal, and without a place or an estimate of the target: the camera then stays as it is.
        `link_delay_s` is the delay of the link, `target_altitude_m` the estimate of the target's altitude, None for
        the height in the gimbal's settings, which is that of a place as well.
        """
        now_s, target, place_m = situation.now_s, situation.target, self.place_m
        if self._target_height_m is None or (target is None and place_m is None) or not self._is_due(now_s):
            return ()
        self._next_s = now_s + self._period_s
        ahead_s = link_delay_s + self._period_s / 2.0
        x, y, x_rate, y_rate, _, _ = situation.own.mean.tolist()
        looks_x, looks_y, height_m = 0.0, 0.0, self._target_height_m
        if place_m is not None:
            looks_x, looks_y = place_m
        elif target is not None:
            target_x, target_y, target_x_rate, target_y_rate = target.mean.tolist()
            target_s = now_s + ahead_s - target.time_s
            looks_x, looks_y = target_x + target_x_rate * target_s, target_y + target_y_rate * target_s
            height_m = height_m if target_altitude_m is None else target_altitude_m
        away_x = looks_x - x - x_rate * ahead_s
        away_y = looks_y - y - y_rate * ahead_s
        away_m = hypot(away_x, away_y)
        if away_m > OVERHEAD_M:
            self._bearing_rad = atan2(away_y, away_x)
        return atan2(height_m - situation.height_m, away_m), self._bearing_rad

    def _is_due(self, now_s: float) -> bool:
        """Return whether the period is over; a clock that was set back does not stop the camera."""
        left_s = 0.0 if self._next_s is None else self._next_s - now_s
        return not self._early_s < left_s <= self._period_s
