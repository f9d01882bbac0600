"""The gimbal of one vehicle's camera, over MAVLink's gimbal protocol v2, as PX4, ArduPilot and gimbals speak it.

MAVSDK's plugin finds it, takes control and sends directions as GIMBAL_MANAGER_SET_ATTITUDE, which is not acknowledged:
commands, each with an acknowledgement, would go before setpoints on a slow link. Nothing is sent to a gimbal that
another station controls.
"""

from collections.abc import Callable
from contextlib import suppress
from math import acos, cos, degrees, inf, isfinite, radians, sin
from typing import Any, NamedTuple

from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.gimbal import ControlMode, GimbalMode, SendMode
from mavsdk.plugins.gimbal import Gimbal as GimbalPlugin

from agents.team.messages import CameraView
from estimation.frames import MissionFrame, Triple
from estimation.vectors import wrap_signed_rad
from gcs.link.relay.frames import STATION_COMPONENT, STATION_SYSTEM

FOUND_WITHIN_S = 8.0
"""MAVSDK asks for a gimbal's names, in vain of ArduPilot, for 5 s before it tells of the gimbal [wall s]."""
SILENT_S = 3.0
CONTROL_PERIOD_S = 5.0
"""How often control is asked for until the gimbal manager reports it [s of the link]."""
OFF_MAX_DEG, OFF_FOR_S = 15.0, 5.0
"""A camera that is farther off for so long does not follow: its gimbal is stuck, or at the end of its range."""
_OFF_STEP_DEG = 10.0
NO_GIMBAL = "no gimbal answers"


class GimbalFacts(NamedTuple):
    """What is known of a vehicle's gimbal on the ground: whether it answers, and the system that controls it, 0: none.

    Another station is meant: control by cordon itself does not count.
    """

    answers: bool = False
    controlled_by: int = 0


NO_GIMBAL_FACTS = GimbalFacts()


class CameraGimbal:
    """Points the camera of one vehicle, whose angle of view is `view_rad`, and collects where it looks as `views`.

    `now_s` is the mission's clock, `link_s` that of the link; `place_m` returns the vehicle's newest position. `take`
    receives each view on the event loop.
    """

    def __init__(
        self,
        system: Any,
        frame: MissionFrame,
        view_rad: float,
        now_s: Callable[[], float],
        link_s: Callable[[], float],
        place_m: Callable[[], Triple | None],
        take: Callable[[CameraView], None],
    ) -> None:
        self.views: list[CameraView] = []
        self._plugin: Any = GimbalPlugin(system)
        self._frame, self._view_rad = frame, view_rad
        self._now_s, self._link_s, self._place_m, self._take = now_s, link_s, place_m, take
        self._gimbal_id: int | None = None
        self._controller: tuple[int, int] | None = None
        self._asked_s = self._reported_s = -inf
        self._wanted_rad: tuple[float, ...] = ()
        self._follows_s = -inf
        self._off_deg = 0.0

    def subscribe(self, posting: Callable[[Callable[[Any], None]], Any]) -> None:
        """Begin to find it; `posting` makes callbacks of MAVSDK's thread run on the event loop."""
        self._plugin.subscribe_gimbal_list(posting(self._take_list))
        self._plugin.subscribe_control_status(posting(self._take_control))
        take = posting(self._take_attitude)
        self._plugin.subscribe_attitude(lambda attitude, _user_data: take((self._now_s(), attitude)))

    @property
    def facts(self) -> GimbalFacts:
        """What is known of it so far."""
        return GimbalFacts(self._gimbal_id is not None, self._other)

    @property
    def fault(self) -> str:
        """Why it does not do what the mission needs, empty if it does."""
        if self._gimbal_id is None:
            return NO_GIMBAL
        if self._other:
            return f"system {self._other} controls it"
        if self.is_silent:
            return f"it has not reported its attitude for {SILENT_S:g} s"
        if self._wanted_rad and self._link_s() - self._follows_s > OFF_FOR_S:
            return f"its camera is about {_OFF_STEP_DEG * round(self._off_deg / _OFF_STEP_DEG):.0f} degrees off"
        return ""

    @property
    def is_silent(self) -> bool:
        """Whether it has not reported where the camera looks for some time."""
        return self._link_s() - self._reported_s > SILENT_S

    def point(self, camera_rad: tuple[float, ...]) -> None:
        """Send elevation and bearing [rad, mission frame], if cordon is in control; never blocks, never raises.

        Ask for control while no system has it.
        """
        if not camera_rad or self._gimbal_id is None or self._other:
            return
        with suppress(MavsdkError, RuntimeError):  # the link is lost
            if not self._is_ours:
                self._ask_for_control(self._gimbal_id)
                return
            elevation_rad, bearing_rad = camera_rad
            if not self._wanted_rad:
                self._follows_s = self._link_s()
            self._wanted_rad = camera_rad
            heading_deg = degrees(wrap_signed_rad(self._frame.x_bearing_rad - bearing_rad))
            angles_deg = 0.0, degrees(elevation_rad), heading_deg
            self._plugin.set_angles(self._gimbal_id, *angles_deg, GimbalMode.YAW_LOCK, SendMode.STREAM)

    def close(self) -> None:
        """Destroy MAVSDK's plugin; blocks until running callbacks have returned."""
        self._plugin.destroy()

    @property
    def _other(self) -> int:
        """The system that controls it, 0 for none and for cordon."""
        return 0 if self._controller is None or self._is_ours else self._controller[0]

    @property
    def _is_ours(self) -> bool:
        return self._controller == (STATION_SYSTEM, STATION_COMPONENT)

    def _ask_for_control(self, gimbal_id: int) -> None:
        now_s = self._link_s()
        if now_s - self._asked_s > CONTROL_PERIOD_S:
            self._asked_s = now_s
            self._plugin.take_control_async(gimbal_id, ControlMode.PRIMARY, _nothing)

    def _take_list(self, found: Any) -> None:
        if found.gimbals and self._gimbal_id is None:
            self._gimbal_id = found.gimbals[0].gimbal_id

    def _take_control(self, status: Any) -> None:
        if self._gimbal_id in (None, status.gimbal_id):
            self._controller = status.sysid_primary_control, status.compid_primary_control

    def _take_attitude(self, timed: tuple[float, Any]) -> None:
        time_s, attitude = timed
        angles, place_m = attitude.euler_angle_north, self._place_m()
        known = isfinite(angles.pitch_deg) and isfinite(angles.yaw_deg)
        if not known or place_m is None or self._gimbal_id not in (None, attitude.gimbal_id):
            return
        self._reported_s = self._link_s()
        elevation_rad = radians(angles.pitch_deg)
        bearing_rad = wrap_signed_rad(self._frame.x_bearing_rad - radians(angles.yaw_deg))
        if self._wanted_rad:
            self._off_deg = degrees(between_rad((elevation_rad, bearing_rad), self._wanted_rad))
            if self._off_deg <= OFF_MAX_DEG:
                self._follows_s = self._reported_s
        view = CameraView(time_s, place_m, elevation_rad, bearing_rad, self._view_rad)
        self.views.append(view)
        self._take(view)


def between_rad(one_rad: tuple[float, ...], other_rad: tuple[float, ...]) -> float:
    """Return the angle between two directions, each by its elevation and bearing."""
    (up, bearing), (other_up, other_bearing) = one_rad, other_rad
    cosine = sin(up) * sin(other_up) + cos(up) * cos(other_up) * cos(bearing - other_bearing)
    return acos(min(max(cosine, -1.0), 1.0))


def _nothing(_result: object, _user_data: object) -> None:
    """Take the answer: the gimbal manager's status shows whether it was obeyed."""
