"""The true motion of a simulated vehicle, as its simulator sends it over MAVLink; real vehicles send none."""

import json
from array import array
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from estimation.frames import Geodetic, MissionFrame
from estimation.state import Telemetry
from gcs.autopilots.autopilot import TruthMessage
from sitl.server.record import TruthTrack

RATE_HZ = 10.0
STALE_S = 2.0
"""A true motion older than this is not extrapolated [s of the mission clock]."""


class GroundTruth:
    """Collects one vehicle's true motions in the mission frame, on the mission clock `now_s`.

    `newest` is the newest of them, None before the first; `on_sample` receives each, and none is collected before it is
    set, which has to wait for the clock's speed. Simulators send positions on Earth: the frame must not be local.
    """

    def __init__(self, system_id: int, frame: MissionFrame, now_s: Callable[[], float]) -> None:
        self.newest: Telemetry | None = None
        self.on_sample: Callable[[Telemetry], None] | None = None
        self._system_id = system_id
        self._frame = frame
        self._now_s = now_s
        self._numbers = array("d")  # packed: as objects they take eight times the memory, megabytes a minute of a team

    def subscribe(self, direct: Any, message: TruthMessage, posting: Callable[[Callable[[Any], None]], Any]) -> None:
        """Subscribe to a simulator's message; `posting` makes callbacks of MAVSDK's thread run on the event loop."""
        direct.subscribe_message(message.name, posting(lambda received: self._take(message, received)))

    def track(self) -> TruthTrack:
        """Return the true track so far, by the vehicle's system id."""
        return TruthTrack.of(self._system_id, self._numbers)

    def position_m(self, now_s: float) -> tuple[float, float] | None:
        """Return the vehicle's true horizontal position now; None without a recent one from a simulator."""
        return None if self.newest is None else extrapolated_m(self.newest, now_s)

    def _take(self, message: TruthMessage, received: Any) -> None:
        if self.on_sample is None or received.system_id != self._system_id:
            return
        with suppress(ValueError, KeyError, TypeError):  # malformed bytes are dropped here
            fields = json.loads(received.fields_json)
            velocity_m_s = self._frame.mission_from_ned(message.velocity_ned_m_s(fields))
            position_m = self._frame.mission_from_geodetic(Geodetic(*message.place(fields)))
            self.newest = Telemetry(self._now_s(), position_m, velocity_m_s)
            self._numbers.extend((self.newest.time_s, *position_m, *velocity_m_s))
            self.on_sample(self.newest)


def extrapolated_m(motion: Telemetry, now_s: float) -> tuple[float, float] | None:
    """Return the horizontal position that a motion leads to now; None if it is stale."""
    since_s = now_s - motion.time_s
    if since_s > STALE_S:
        return None
    (x, y, _), (x_rate, y_rate, _) = motion.position_m, motion.velocity_m_s
    return x + x_rate * since_s, y + y_rate * since_s
