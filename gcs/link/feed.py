"""Telemetry of a vehicle: MAVSDK's subscriptions, converted to the mission frame on the event loop."""

import asyncio
from collections import deque
from collections.abc import Callable
from math import isfinite
from typing import Any

from mavsdk.plugins.telemetry import FlightMode as MavsdkMode
from mavsdk.plugins.telemetry import Telemetry as TelemetryPlugin
from msgspec.structs import replace

from agents.ports import FlightMode, VehicleStatus
from agents.shell.clock import LinkTransit, MissionClock
from agents.shell.handover import Handover
from agents.situation.estimator import LINK_DELAY_MAX_S
from estimation.frames import Geodetic, MissionFrame, Triple
from estimation.state import Telemetry
from gcs.link.ground_truth import GroundTruth
from gcs.link.self_reports import SelfReports, tilt_deg
from gcs.link.status_texts import HealthItem, StatusTexts


class PostedCalls:
    """Calls functions with posted values on the running event loop, in the order of posting."""

    def __init__(self, *, gathers: bool) -> None:
        """Take whether values are gathered for a moment, which costs less than a call for each."""
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[tuple[Callable[..., object], tuple[Any, ...]]] = deque()
        self._handover = Handover(self._loop, self._take_all, gathers=gathers)

    def post(self, take: Callable[..., object], *values: Any) -> None:
        """Call `take` with values on the event loop, from any thread; do nothing once the loop is closed.

        An exception goes to the loop's handler, and does not affect other calls.
        """
        self._waiting.append((take, values))
        self._handover.request()

    def _take_all(self) -> None:
        for _ in range(len(self._waiting)):
            take, values = self._waiting.popleft()
            try:
                take(*values)
            except Exception as error:
                self._loop.call_exception_handler({"message": "a value of MAVSDK was not taken", "exception": error})


MODES = {
    MavsdkMode.UNKNOWN: FlightMode.UNKNOWN,
    MavsdkMode.READY: FlightMode.READY,
    MavsdkMode.TAKEOFF: FlightMode.TAKE_OFF,
    MavsdkMode.HOLD: FlightMode.HOLD,
    MavsdkMode.OFFBOARD: FlightMode.OFFBOARD,
    MavsdkMode.LAND: FlightMode.LAND,
    MavsdkMode.RETURN_TO_LAUNCH: FlightMode.RETURN,
}
HEALTH_FIELDS = {
    HealthItem.GYROMETER: "is_gyrometer_calibration_ok",
    HealthItem.ACCELEROMETER: "is_accelerometer_calibration_ok",
    HealthItem.MAGNETOMETER: "is_magnetometer_calibration_ok",
    HealthItem.LOCAL_POSITION: "is_local_position_ok",
    HealthItem.GLOBAL_POSITION: "is_global_position_ok",
    HealthItem.HOME_POSITION: "is_home_position_ok",
    HealthItem.ARMING: "is_armable",
}
"""Their fields in MAVSDK."""
NEEDS_GPS = (HealthItem.GLOBAL_POSITION, HealthItem.HOME_POSITION, HealthItem.ARMING)
"""Without GPS PX4's arming checks fail until take-off is selected: they apply to its present mode, hold."""
CLOCK_BACK_S = 0.5
"""A backward step of the autopilot's clock by more than this is a restart: no datagram is that late."""

LATE_UNTIL = 0.8
"""Share of the limit of the round trip below which it is no longer reported as late."""
ROUND_TRIP_STEP_S = 0.01
"""Smaller changes of the round trip are not reported: they do not change a prediction noticeably."""


class VehicleFeed:
    """The newest telemetry of one system. MAVSDK's thread posts it to the event loop; callbacks never raise.

    `origin_m` is the mission position of the vehicle's NED origin: no telemetry is delivered before it is set. It is
    reset when the link is lost or the autopilot restarts, which `on_loss` and `on_return` report. A restart is detected
    by a backward step of the autopilot's clock. `truth` collects a simulator's true motions, if requested.
    """

    def __init__(
        self,
        system: Any,
        frame: MissionFrame,
        clock: MissionClock,
        posted_calls: PostedCalls,
        *,
        truth: GroundTruth | None = None,
        transit: LinkTransit | None = None,
    ) -> None:
        self.status = VehicleStatus()
        self.motion: Telemetry | None = None
        self.origin_m: Triple | None = None
        self.dropped = 0
        self.on_telemetry: Callable[[Telemetry], None] | None = None
        self.on_loss: Callable[[], None] | None = None
        self.on_return: Callable[[], None] | None = None
        self.on_offboard_left: Callable[[], None] | None = None
        self._clock = clock
        self._transit = transit
        self._motion_received_s = self.link_s()
        self.clock_received = False
        self.plugin: Any = TelemetryPlugin(system)
        self.reports = SelfReports(system, self._update)
        self.texts = StatusTexts()
        self.autopilot = self.reports.autopilot
        self.truth = truth
        self._system = system
        self._frame = frame
        self._health: Any = None
        self._mode: Any = None
        self._home_z_m: float | None = None
        self._clock_s: float | None = None
        self._clock_notes: list[tuple[float, float]] | None = None
        self._posted_calls = posted_calls
        self._is_late = False

    def subscribe(self) -> None:
        """Subscribe only to what the control loop uses: MAVSDK drops callbacks near 1500 per second."""
        telemetry = self.plugin
        telemetry.subscribe_position_velocity_ned(self._posting(self._take_motion))
        telemetry.subscribe_flight_mode(self._posting(self._take_mode))
        telemetry.subscribe_armed(self._posting(lambda armed: self._update(armed=bool(armed))))
        telemetry.subscribe_in_air(self._posting(lambda in_air: self._update(in_air=bool(in_air))))
        telemetry.subscribe_health(self._posting(self._take_health))
        telemetry.subscribe_battery(self._posting(self._take_battery))
        if not self._frame.is_local:
            telemetry.subscribe_home(self._posting(self._take_home))
        telemetry.subscribe_status_text(self._posting(self._take_text))
        telemetry.subscribe_attitude_euler(self._note_attitude)
        self.reports.subscribe(telemetry, self._posting, gps=not self._frame.is_local)
        if self.truth is not None:
            self.truth.subscribe(self.reports.direct, self.autopilot.truth, self._posting)
        self._update(connected=self._system.is_connected())
        self._system.subscribe_is_connected(self._posting(self._take_connected))

    @property
    def position_m(self) -> Triple | None:
        """The newest position in the mission frame, None before the first."""
        return None if self.motion is None else self.motion.position_m

    @property
    def motion_age_s(self) -> float:
        """The time since the newest motion was received [s of the link]."""
        return self.link_s() - self._motion_received_s

    @property
    def ground_z_m(self) -> float:
        """The altitude of the vehicle's home in the mission frame, to which take-off altitudes are relative.

        Before home is received: the altitude of the vehicle, or else of its origin.
        """
        if self._home_z_m is not None:
            return self._home_z_m
        return (self.position_m or self.origin_m or (0.0, 0.0, 0.0))[2]

    async def attitude_clock(self, duration_s: float) -> list[tuple[float, float]]:
        """Return (time of the link, autopilot's time) of the attitudes received within `duration_s` of the link [s]."""
        notes = self._clock_notes = []
        try:
            await self._clock.sleep(duration_s * self._clock.time_scale)
        finally:
            self._clock_notes = None
        return notes

    @property
    def is_local(self) -> bool:
        """Whether the mission frame is local, without a position on Earth."""
        return self._frame.is_local

    @property
    def mode_received(self) -> bool:
        """Whether a flight mode has been received."""
        return self._mode is not None

    def missing(self) -> str:
        """Return the names of the telemetry that has not been received yet; empty when it is complete."""
        parts = {"local position": self.position_m, "flight mode": self._mode, "health": self._health}
        return ", ".join(name for name, part in parts.items() if part is None)

    def health(self) -> dict[HealthItem, bool]:
        """Return the state of each health item; empty before the first report.

        In a local frame the global position is not required, and any received local position is healthy.
        """
        if self._health is None:
            return {}
        items = {item: bool(getattr(self._health, name)) for item, name in HEALTH_FIELDS.items()}
        if self.is_local:
            items = {item: healthy for item, healthy in items.items() if item not in NEEDS_GPS}
            items[HealthItem.LOCAL_POSITION] = self.status.local_position_ok
        return items

    def failing(self) -> str:
        """Return the names of the health items that fail; empty when all are healthy."""
        if self._health is None:
            return "no health report"
        return ", ".join(item for item, healthy in self.health().items() if not healthy)

    def close(self) -> None:
        """Unsubscribe from everything; blocks until running callbacks have returned."""
        self.plugin.destroy()
        self.reports.close()
        self._system.destroy()

    def link_s(self) -> float:
        """Return the time of what carries messages: the wall's, unless the clock is governed."""
        return self._clock.now_s() / self._clock.time_scale

    def _posting(self, take: Callable[[Any], None]) -> Callable[[Any, object], None]:
        """Return a callback for MAVSDK's thread that runs `take` on the event loop."""

        def post(value: Any, _user_data: object = None) -> None:
            self._posted_calls.post(take, value)

        return post

    def _update(self, **changes: Any) -> None:
        self.status = replace(self.status, **changes)

    def _note_attitude(self, attitude: Any, _user_data: object) -> None:
        # On MAVSDK's thread: the time of reception is now, not the time when the event loop runs.
        times_s = (self.link_s(), attitude.timestamp_us * 1e-6)
        self._posted_calls.post(self._take_attitude, times_s, attitude.roll_deg, attitude.pitch_deg)

    def _take_attitude(self, times_s: tuple[float, float], roll_deg: float, pitch_deg: float) -> None:
        self._take_clock(times_s)
        if isfinite(roll_deg) and isfinite(pitch_deg):
            self._update(tilt_deg=tilt_deg(roll_deg, pitch_deg))

    def _take_clock(self, times_s: tuple[float, float]) -> None:
        last_s, self._clock_s = self._clock_s, times_s[1]
        if self._clock_notes is not None:
            self._clock_notes.append(times_s)
        if last_s is not None and last_s - times_s[1] > CLOCK_BACK_S:
            self._update(restarts=self.status.restarts + 1)
            self.lose()
            self._return()
        self.clock_received = True

    def lose(self) -> None:
        """Reset the vehicle's origin: positions from now on may refer to another one."""
        self.origin_m = None
        self.clock_received = False
        if self.on_loss is not None:
            self.on_loss()

    def forget_mode(self) -> None:
        """Count no flight mode as received until the next; the status keeps the newest."""
        self._mode = None

    def _return(self) -> None:
        if self.on_return is not None:
            self.on_return()

    def _take_motion(self, motion: Any) -> None:
        self._motion_received_s = self.link_s()
        position, velocity = motion.position, motion.velocity
        time_s = self._clock.now_s()
        if self._transit is not None:
            rates_m_s = (velocity.north_m_s, velocity.east_m_s, velocity.down_m_s)
            time_s = self._transit.sent_s(position.north_m, position.east_m, position.down_m, rates_m_s)
        if self.origin_m is None:
            return
        x, y, z = self._frame.mission_from_ned((position.north_m, position.east_m, position.down_m))
        x0, y0, z0 = self.origin_m
        try:
            sample = Telemetry(
                time_s,
                (x + x0, y + y0, z + z0),
                self._frame.mission_from_ned((velocity.north_m_s, velocity.east_m_s, velocity.down_m_s)),
            )
        except ValueError:
            self.dropped += 1
            return
        self.motion = sample
        if self.on_telemetry is not None:
            self.on_telemetry(sample)

    def _take_mode(self, mode: Any) -> None:
        self._mode, before = mode, self.status.mode
        self._update(mode=MODES.get(mode, FlightMode.OTHER))
        if before is FlightMode.OFFBOARD is not self.status.mode and self.on_offboard_left is not None:
            self.on_offboard_left()

    def _take_health(self, health: Any) -> None:
        self._health = health
        # MAVSDK derives it from the health of GPS, optical flow and vision only.
        local_position_ok = health.is_local_position_ok or (self.is_local and self.position_m is not None)
        self._update(local_position_ok=bool(local_position_ok), armable=bool(health.is_armable))
        if health.is_armable:
            self.texts.note_pass()

    def _take_battery(self, battery: Any) -> None:
        percent = battery.remaining_percent
        left_s = battery.time_remaining_s
        self._update(
            battery=min(max(percent / 100.0, 0.0), 1.0) if isfinite(percent) else None,
            endurance_s=float(left_s) if isfinite(left_s) and left_s > 0.0 else None,
        )

    def _take_home(self, home: Any) -> None:
        try:
            place = Geodetic(home.latitude_deg, home.longitude_deg, home.absolute_altitude_m)
        except ValueError:
            self.dropped += 1
            return
        self._home_z_m = self._frame.mission_from_geodetic(place)[2]

    def _take_text(self, text: Any) -> None:
        self.texts.take(text.text, text.type)
        self.reports.take_text(text.text)

    def note_link(self, round_trip_s: float | None, fault: str, speed: float) -> None:
        """Take the round trip of the link [wall s], None if it is unknown, and the connection's fault.

        The status holds the round trip in whole steps of the mission clock, which runs `speed` times as fast.
        """
        self._is_late = (
            round_trip_s is not None and round_trip_s > (LATE_UNTIL if self._is_late else 1.0) * LINK_DELAY_MAX_S
        )
        if self._is_late:
            fault = fault or f"its round trip is {round_trip_s:.1f} s"
        in_steps_s = self.status.round_trip_s
        if round_trip_s is not None:
            in_steps_s = ROUND_TRIP_STEP_S * round(round_trip_s * speed / ROUND_TRIP_STEP_S)
        if (in_steps_s, fault) != (self.status.round_trip_s, self.status.link_fault):
            self._update(round_trip_s=in_steps_s, link_fault=fault)

    def _take_connected(self, connected: bool) -> None:
        before = self.status.connected
        self._update(connected=bool(connected))
        if before and not connected:
            self.lose()
        if connected and not before:
            self._return()
