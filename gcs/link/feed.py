"""Telemetry of a vehicle: MAVSDK's subscriptions, converted to the mission frame on the event loop.

Motion and attitude come from the relay: their callbacks from MAVSDK, 23 a second of each vehicle, took as long as all
else that is received, and MAVSDK drops callbacks near 1500 a second (docs/notes/performance.md).
"""

import asyncio
import json
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from math import degrees, dist, hypot, nan
from typing import Any

from mavsdk.plugins.telemetry import FlightMode as MavsdkMode
from mavsdk.plugins.telemetry import Telemetry as TelemetryPlugin
from msgspec.structs import replace

from agents.ports import FlightMode, ModeSource, VehicleStatus
from agents.safety.failsafe import FIX_DIMENSIONS
from agents.shell.clock import LinkTransit, MissionClock, link_s
from agents.shell.handover import Handover
from agents.situation.estimator import LINK_DELAY_MAX_S
from estimation.filters.own import JUMP_M, jump_m
from estimation.frames import Geodetic, MissionFrame, Triple
from estimation.state import Telemetry
from gcs.link.batteries import Batteries, BatteryReport
from gcs.link.gimbal import CameraGimbal
from gcs.link.ground_truth import GroundTruth
from gcs.link.heights import BAROMETER, GPS, GPS_SIGMA_M, RANGEFINDER, HeightComparison
from gcs.link.rates import ATTITUDE, LOCAL_POSITION_NED
from gcs.link.received_fields import (
    BAROMETER_HEIGHT,
    CHARGE,
    CLEARANCE,
    FLIGHT_TIME,
    GPS_HEIGHT_SIGMA,
    PITCH,
    ROLL,
)
from gcs.link.relay.frames import timed_numbers
from gcs.link.self_reports import BATTERY, NOT_FOR_FLIGHT, SelfReports, tilt_deg
from gcs.link.status_texts import HealthItem, StatusTexts
from gcs.link.traffic import BASIC_ID, LOCATION, TrafficReceiver


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
SILENT_S, BAROMETER_LAG_S = 1.0, 1.0
"""After a break of the motion by the first time, the height is compared with the barometer's change during it. A climb
explains a difference by what it is in the second: the two are not measured at the same time.
"""
LOST_AFTER_S = 3.0
"""MAVSDK takes a link as lost after this time of the wall without a heartbeat. A governed clock, which waits for a busy
computer, may stand still meanwhile: then the link is lost once as much of its time has passed without a motion.
"""
SPEED_MAX_M_S = 20.0
"""The largest speed that can be set in PX4 (MPC_XY_VEL_MAX) and in ArduCopter (WPNAV_SPEED)."""
ORIGIN_STEP_M = 0.1
"""An origin that moves by less is taken over without an event: autopilots correct its height in flight."""
ROUND_TRIP_STEP_S = 0.01
"""Smaller changes of the round trip are not reported: they do not change a prediction noticeably."""


_STILL_M = (0.0, 0.0, 0.0)


def _sum(one: Triple, other: Triple) -> Triple:
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]


def _difference(there: Triple, here: Triple) -> Triple:
    return there[0] - here[0], there[1] - here[1], there[2] - here[2]


class VehicleFeed:
    """The newest telemetry of one system. Other threads post it to the event loop; callbacks never raise.

    `listen` takes what receives the autopilot's frames, by message (`MavsdkHub.listen`).
    `origin_m` is the mission position of the vehicle's NED origin: no telemetry is delivered before it is set. It is
    reset when the link is lost or the autopilot restarts, which `on_loss` and `on_return` report. A restart is detected
    by a backward step of the autopilot's clock. It is also reset when it is in doubt (`doubt`): until it has been read
    again no telemetry is delivered, and the sample after that shows what has changed. `by_failsafe` returns whether a
    failsafe of the autopilot made the newest change of mode. `truth` collects a simulator's true motions, if requested.
    With `view_rad`, the angle of view of its camera, it has the `gimbal` of that. Aircraft that the vehicle hears are
    in the status; if it `asks_traffic`, their reports are requested.
    """

    def __init__(
        self,
        system: Any,
        frame: MissionFrame,
        clock: MissionClock,
        posted_calls: PostedCalls,
        listen: Callable[[Mapping[int, Callable[[bytes], object]]], None],
        *,
        by_failsafe: Callable[[], bool] = lambda: False,
        truth: GroundTruth | None = None,
        transit: LinkTransit | None = None,
        view_rad: float | None = None,
        asks_traffic: bool = False,
    ) -> None:
        self.asks_traffic = asks_traffic
        self.status = VehicleStatus()
        self.motion: Telemetry | None = None
        self.dropped = 0
        self.motions = 0
        """How many messages of its motion have arrived."""
        self.on_telemetry: Callable[[Telemetry], None] | None = None
        self.on_loss: Callable[[], None] | None = None
        self.on_return: Callable[[], None] | None = None
        self.on_offboard_left: Callable[[], None] | None = None
        self._by_failsafe = by_failsafe
        self._clock = clock
        self._transit = transit
        self._began_s = self._motion_received_s = self.link_s()
        self.clock_received = False
        self.plugin: Any = TelemetryPlugin(system)
        self.reports = SelfReports(system, self._update, self.link_s)
        self.texts = StatusTexts()
        self.batteries = Batteries()
        self.autopilot = self.reports.autopilot
        self.truth = truth
        self.gimbal: CameraGimbal | None = None
        if view_rad is not None:
            self.gimbal = CameraGimbal(
                system,
                frame,
                view_rad,
                clock.now_s,
                self.link_s,
                lambda: self.position_m,
                lambda view: self._update(camera=view),
            )
        self._traffic = TrafficReceiver(self.reports.system_id, frame, clock.now_s)
        self._system = system
        self._frame = frame
        self._health: Any = None
        self._mode: Any = None
        self._origin_m: Triple | None = None
        self._located_m: Triple | None = None
        self._home_m: Triple | None = None
        self._height_off_m = 0.0
        self._origin_before_m: Triple | None = None
        self._received: Telemetry | None = None
        self._jumped_m = _STILL_M
        self._is_jumping = False
        self._before_loss: Telemetry | None = None
        self._barometer_off_m = nan
        self._compares_height = False
        self._heights = HeightComparison()
        self._clock_s: float | None = None
        self._clock_notes: list[tuple[float, float]] | None = None
        self._posted_calls = posted_calls
        self._listen = listen
        self._is_late = False
        self._is_connected = False

    def subscribe(self) -> None:
        """Subscribe only to what the control loop uses: MAVSDK drops callbacks near 1500 per second."""
        telemetry = self.plugin
        self._listen({LOCAL_POSITION_NED: self._posting(self._take_motion), ATTITUDE: self._note_attitude})
        telemetry.subscribe_flight_mode(self._posting(self._take_mode))
        telemetry.subscribe_armed(self._posting(lambda armed: self._update(armed=bool(armed))))
        telemetry.subscribe_in_air(self._posting(lambda in_air: self._update(in_air=bool(in_air))))
        telemetry.subscribe_health(self._posting(self._take_health))
        telemetry.subscribe_altitude(self._posting(self._take_altitude))
        telemetry.subscribe_battery(self._posting(self._take_battery))
        if not self._frame.is_local:
            self.reports.direct.subscribe_message("GPS_GLOBAL_ORIGIN", self._posting(self._take_origin))
            self.reports.direct.subscribe_message("HOME_POSITION", self._posting(self._take_home))
            telemetry.subscribe_raw_gps(self._posting(self._take_gps))
            for name in ("ADSB_VEHICLE", LOCATION, BASIC_ID):
                self.reports.direct.subscribe_message(name, self._posting(self._take_traffic))
        telemetry.subscribe_status_text(self._posting(self._take_text))
        self.reports.subscribe(telemetry, self._posting, gps=not self._frame.is_local)
        if self.truth is not None:
            self.truth.subscribe(self.reports.direct, self.autopilot.truth, self._posting)
        if self.gimbal is not None:
            self.gimbal.subscribe(self._posting)
        self._is_connected = bool(self._system.is_connected())
        self._update(connected=self._is_connected)
        self._system.subscribe_is_connected(self._posting(self._take_connected))

    @property
    def position_m(self) -> Triple | None:
        """The newest position in the mission frame, None before the first."""
        return None if self.motion is None else self.motion.position_m

    @property
    def age_s(self) -> float:
        """The time since it began [s of the link]."""
        return self.link_s() - self._began_s

    @property
    def motion_age_s(self) -> float:
        """The time since the newest motion was received [s of the link]."""
        return self.link_s() - self._motion_received_s

    @property
    def origin_m(self) -> Triple | None:
        """The origin of the vehicle's NED in the mission frame, None while it is unknown."""
        return self._origin_m

    @property
    def is_doubted(self) -> bool:
        """Whether the origin is in doubt on a live link."""
        return not self.status.reference.is_known

    @property
    def setpoint_origin_m(self) -> Triple | None:
        """The origin that setpoints refer to, None while it is unknown or in doubt."""
        return None if self.is_doubted else self.origin_m

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
        if self.gimbal is not None:
            self.gimbal.close()
        self._system.destroy()

    def link_s(self) -> float:
        """Return the time of what carries messages: the wall's, unless the clock is governed."""
        return link_s(self._clock)

    def _posting(self, take: Callable[[Any], None]) -> Callable[..., None]:
        """Return a callback for another thread that runs `take` on the event loop."""

        def post(value: Any, _user_data: object = None) -> None:
            self._posted_calls.post(take, value)

        return post

    def _update(self, **changes: Any) -> None:
        self.status = replace(self.status, **changes)

    def _note_attitude(self, frame: bytes) -> None:
        # On the relay's thread: the time of reception is now, not the time when the event loop runs.
        self._posted_calls.post(self._take_attitude, self.link_s(), frame)

    def _take_attitude(self, received_s: float, frame: bytes) -> None:
        if (attitude := timed_numbers(frame)) is None:
            return
        self._take_clock((received_s, attitude.time_ms * 1e-3))
        roll_rad, pitch_rad = ROLL.known(attitude.x), PITCH.known(attitude.y)
        if roll_rad is not None and pitch_rad is not None:
            self._update(tilt_deg=tilt_deg(degrees(roll_rad), degrees(pitch_rad)))

    def _take_clock(self, times_s: tuple[float, float]) -> None:
        last_s, self._clock_s = self._clock_s, times_s[1]
        if self._clock_notes is not None:
            self._clock_notes.append(times_s)
        if last_s is not None and last_s - times_s[1] > CLOCK_BACK_S:
            self._update(restarts=self.status.restarts + 1)
            self._located_m, self._height_off_m, self._barometer_off_m = None, 0.0, nan
            self.lose()
            self._return()
        self.clock_received = True

    def lose(self) -> None:
        """Reset the vehicle's origin: positions from now on may refer to another one."""
        self._origin_m = self._origin_before_m = self._received = None
        self._is_jumping, self._jumped_m = False, _STILL_M
        self._before_loss, self._compares_height = self.motion, True
        self._refer(is_known=True)
        self.clock_received = False
        if self.on_loss is not None:
            self.on_loss()

    def doubt(self) -> bool:
        """Take the origin as unknown until it has been read again: the positions may refer to another one.

        Return whether it is: only where `on_return` has it read.
        """
        if self.origin_m is None or self.on_return is None:
            return False
        self._origin_m = None
        self._refer(is_known=False)
        self._return()
        return True

    def locate(self, origin_m: Triple | None) -> None:
        """Take the origin in the mission frame as it was read [m], None if it cannot be; a move of it is counted."""
        if origin_m is not None:
            x, y, z = origin_m
            origin_m, before_m = (x, y, z - self._height_off_m), self._located_m
            self._located_m = origin_m
            if before_m is not None and dist(origin_m, before_m) > ORIGIN_STEP_M:
                self._refer(
                    moves=self.status.reference.moves + 1, moved_m=self._north_east_up(_difference(origin_m, before_m))
                )
        self._origin_m = origin_m

    def _north_east_up(self, mission_m: Triple) -> Triple:
        north, east, down = self._frame.ned_from_mission(mission_m)
        return round(north, 3) + 0.0, round(east, 3) + 0.0, round(-down, 3) + 0.0  # no -0.0

    def _refer(self, **changes: Any) -> None:
        self._update(reference=replace(self.status.reference, **changes))

    def forget_mode(self) -> None:
        """Count no flight mode as received until the next; the status keeps the newest."""
        self._mode = None

    def _return(self) -> None:
        if self.on_return is not None:
            self.on_return()

    def _take_motion(self, frame: bytes) -> None:
        if (motion := timed_numbers(frame)) is None:
            return
        self.motions += 1
        self._motion_received_s = self.link_s()
        north_m, east_m, down_m, rates_m_s = motion.x, motion.y, motion.z, (motion.x_rate, motion.y_rate, motion.z_rate)
        time_s = self._clock.now_s()
        if self._transit is not None:
            time_s = self._transit.sent_s(north_m, east_m, down_m, rates_m_s)
        try:
            received = Telemetry(
                time_s,
                self._frame.mission_from_ned((north_m, east_m, down_m)),
                self._frame.mission_from_ned(rates_m_s),
            )
        except ValueError:
            self.dropped += 1
            return
        sample = self._checked(received)
        if sample is None:
            return
        self.motion = sample
        if self.on_telemetry is not None:
            self.on_telemetry(sample)

    def _checked(self, received: Telemetry) -> Telemetry | None:
        """Return a sample, received relative to the origin, in the mission frame; None while the origin is unknown.

        Its jumps since the last one that was returned, and the move of the origin, cancel if only the origin has moved.
        If not, the origin is read again. What is left then is a jump of the position: it is counted. Its vertical part
        moves the origin instead, since no vehicle climbs or sinks that fast: the height is that before the jump.
        """
        before, self._received = self._received, received
        if before is not None:
            self._compares_height = self._compares_height or received.time_s - before.time_s > SILENT_S
            self._jumped_m = _sum(self._jumped_m, jump_m(before, received) or _STILL_M)
        if (origin_m := self.origin_m) is None:
            return None
        x, y, z = (
            self._jumped_m
            if self._origin_before_m is None
            else _sum(self._jumped_m, _difference(origin_m, self._origin_before_m))
        )
        if hypot(x, y, z) > JUMP_M:
            if not self._is_jumping and self.doubt():
                self._is_jumping = True
                return None
            origin_m = self._count_jump((x, y, z), origin_m)
        self._is_jumping, self._jumped_m, self._origin_before_m = False, _STILL_M, origin_m
        if self.is_doubted:
            self._refer(is_known=True)
        sample = replace(received, position_m=_sum(received.position_m, origin_m))
        if self._before_loss is not None:
            x, y, _ = _difference(sample.position_m, self._before_loss.position_m)
            if hypot(x, y) > JUMP_M + SPEED_MAX_M_S * (sample.time_s - self._before_loss.time_s):
                self._count_jump((x, y, 0.0), origin_m)
            self._before_loss = None
        return sample

    def _count_jump(self, jumped_m: Triple, origin_m: Triple) -> Triple:
        """Count a jump of the position, and return the origin, moved by its vertical part."""
        x, y, z = origin_m
        self._refer(jumps=self.status.reference.jumps + 1, jumped_m=self._north_east_up(jumped_m))
        self._height_off_m += jumped_m[2]
        self._located_m = self._origin_m = self._origin_before_m = x, y, z - jumped_m[2]
        return self._origin_m

    def _take_mode(self, mode: Any) -> None:
        self._mode, before = mode, self.status.mode
        if (after := MODES.get(mode, FlightMode.OTHER)) is before:
            return
        announced = self.reports.mode_changed()
        self._update(mode=after, mode_by=ModeSource.FAILSAFE if self._by_failsafe() else announced)
        if before is FlightMode.OFFBOARD and self.on_offboard_left is not None:
            self.on_offboard_left()

    def _take_health(self, health: Any) -> None:
        self._health = health
        # MAVSDK derives it from the health of GPS, optical flow and vision only.
        local_position_ok = health.is_local_position_ok or (self.is_local and self.position_m is not None)
        self._update(local_position_ok=bool(local_position_ok), armable=bool(health.is_armable))
        if health.is_armable:
            self.texts.note_pass()

    def _take_altitude(self, altitude: Any) -> None:
        """Compare the height with those of a barometer and a rangefinder.

        A difference to the barometer that has changed in a break of the motion is a jump of the height.
        """
        if self.motion is None or self._before_loss is not None or (origin_m := self.setpoint_origin_m) is None:
            return
        height_m, barometer_m = self.motion.position_m[2], BAROMETER_HEIGHT.number(altitude.altitude_monotonic_m)
        stepped_m = height_m - barometer_m - self._barometer_off_m
        climbed_m = BAROMETER_LAG_S * abs(self.motion.velocity_m_s[2])
        if self._compares_height and abs(stepped_m) > JUMP_M + climbed_m:
            self._count_jump((0.0, 0.0, stepped_m), origin_m)
            height_m -= stepped_m
        self._compares_height, self._barometer_off_m = False, height_m - barometer_m
        flies = self.status.armed
        self._heights.take(BAROMETER, height_m, barometer_m, flies=flies)
        self._heights.take(RANGEFINDER, height_m, CLEARANCE.number(altitude.bottom_clearance_m), flies=flies)
        self._report_height()

    def _take_gps(self, gps: Any) -> None:
        """Compare the height with that of the GPS: an autopilot whose height is its barometer's has no other check."""
        if self.motion is None or self._before_loss is not None or self.setpoint_origin_m is None:
            return
        gps_m = gps.absolute_altitude_m if self.status.gps_dimensions == FIX_DIMENSIONS else nan
        sigma_m = GPS_HEIGHT_SIGMA.known(gps.vertical_uncertainty_m) or GPS_SIGMA_M
        self._heights.take(GPS, self.motion.position_m[2], gps_m, sigma_m, flies=self.status.armed)
        self._report_height()

    def _report_height(self) -> None:
        off_m, sensor = self._heights.worst
        if (off_m, sensor) != (self.status.height_off_m, self.status.height_sensor):
            self._update(height_off_m=off_m, height_sensor=sensor)

    def _take_battery(self, battery: Any) -> None:
        percent = CHARGE.known(battery.remaining_percent)
        charge, endurance_s = None if percent is None else percent / 100.0, FLIGHT_TIME.known(battery.time_remaining_s)
        flies = battery.battery_function not in NOT_FOR_FLIGHT
        self.batteries.take(BatteryReport(int(battery.id), charge, endurance_s, flies), self.link_s())
        lowest, shortest_s = self.batteries.charge, self.batteries.endurance_s
        self.reports.take_repeated(BATTERY, battery=lowest, endurance_s=shortest_s)

    def _take_origin(self, message: Any) -> None:
        """Take an origin that the autopilot sends: the one in doubt, or one that has moved and is read again."""
        place_m = self._place_m(message)
        if place_m is None or (self.origin_m is None and not self.is_doubted):
            return
        x, y, z = place_m
        height_m = z - self._height_off_m
        if self.origin_m is None or dist((x, y, height_m), self.origin_m) <= ORIGIN_STEP_M:
            self.locate(place_m)
        else:
            self.doubt()

    def _take_home(self, message: Any) -> None:
        """Take the vehicle's home. It is set at take-off: what moves it later may have moved the origin as well.

        Its height does not count: for two minutes after a take-off PX4 corrects it by its barometer, by up to a metre.
        """
        if (home_m := self._place_m(message)) is None:
            return
        before_m, self._home_m = self._home_m, home_m if self.status.in_air else None
        if self.status.in_air and before_m is not None and dist(home_m[:2], before_m[:2]) > ORIGIN_STEP_M:
            self.doubt()

    def _take_traffic(self, message: Any) -> None:
        if self._traffic.take(message):
            self.expire_traffic()

    def expire_traffic(self) -> None:
        """Take the aircraft that are near at present; to be called repeatedly, as old reports are forgotten."""
        if (traffic := self._traffic.nearest(self.position_m)) != self.status.traffic:
            self._update(traffic=traffic)

    def _place_m(self, message: Any) -> Triple | None:
        """Return the place in a message in the mission frame [m], None if it is malformed or of another vehicle."""
        with suppress(ValueError, KeyError, TypeError):
            fields = json.loads(message.fields_json)
            place = Geodetic(fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3)
            if message.system_id == self.reports.system_id:
                return self._frame.mission_from_geodetic(place)
        return None

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
        self._is_connected = bool(connected)
        self.judge_connection()

    def judge_connection(self) -> None:
        """Take a link as lost or as back: by MAVSDK, but a governed clock has to agree that it is lost."""
        before = self.status.connected
        lasts = before and self._clock.is_governed and self.motion_age_s < LOST_AFTER_S
        connected = self._is_connected or lasts
        if connected == before:
            return
        self._update(connected=connected)
        if connected:
            self._return()
        else:
            self.lose()
