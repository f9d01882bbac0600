"""External positions (motion capture, UWB), sent to an autopilot without GPS as VISION_POSITION_ESTIMATE."""

import time
from contextlib import suppress
from math import inf, nan
from typing import Any

from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.mocap import AngleBody, Covariance, Mocap, PositionBody, VisionPositionEstimate

from agents.team.external_positions import OLD_S, ExternalPosition
from estimation.frames import MissionFrame, Triple
from estimation.vectors import wrap_signed_rad
from gcs.link.rates import EXTERNAL_HZ

NO_EXTERNAL_POSITION = "no position from outside"
EARLY_SHARE = 0.1
"""Share of its period by which a position may be early: sources of positions are not exact."""


class ExternalPositionSender:
    """Sends one vehicle its positions in its own NED, whose origin is at `origin_m` of the mission frame."""

    def __init__(self, system: Any, frame: MissionFrame, origin_m: Triple) -> None:
        self._plugin: Any = Mocap(system)
        self._frame, self._origin_m = frame, origin_m
        self._measured_s = -inf
        self._next_s = -inf

    @property
    def is_stale(self) -> bool:
        """Whether the newest position was measured too long ago."""
        return time.time() - self._measured_s > OLD_S

    def send(self, position: ExternalPosition) -> None:
        """Send a position, unless it is older than the one before, or exceeds the rate planned for the link."""
        if position.time_s <= self._measured_s:
            return
        self._measured_s = position.time_s
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = max(self._next_s, now_s - EARLY_SHARE / EXTERNAL_HZ) + 1.0 / EXTERNAL_HZ
        with suppress(MavsdkError, RuntimeError):  # the link is lost
            self._plugin.set_vision_position_estimate(self._estimate(position))

    def close(self) -> None:
        """Destroy MAVSDK's plugin."""
        self._plugin.destroy()

    def _estimate(self, position: ExternalPosition) -> VisionPositionEstimate:
        (x, y, z), (x0, y0, z0) = position.position_m, self._origin_m
        place = PositionBody(*self._frame.ned_from_mission((x - x0, y - y0, z - z0)))
        angle = AngleBody(nan, nan, nan)  # unknown: the autopilot then uses none of them
        if position.yaw_rad is not None:
            angle = AngleBody(0.0, 0.0, wrap_signed_rad(self._frame.x_bearing_rad - position.yaw_rad))
        return VisionPositionEstimate(round(position.time_s * 1e6), place, angle, Covariance([nan]))
