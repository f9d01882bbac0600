"""One vehicle over MAVSDK, in mission-frame metres: degrees, NED and the autopilot's dialect stop here.

The flight mode heard in heartbeats is the evidence that a command took effect, not its acknowledgement: PX4 first
acknowledges every change of mode, then decides. Mode and armed lag behind by up to a second.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from math import degrees
from typing import Any, NamedTuple

from mavsdk.autopilot import Autopilot
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, PositionNedYaw

from agents.ports import FlightMode, Setpoint, VehicleRefusedError, VehicleStatus
from estimation.frames import MissionFrame, wrap_signed_rad
from estimation.state import Telemetry
from gcs.link_calls import VehicleCalls, choose_guided, clock_ratio, find_origin, request_rates
from gcs.link_feed import VehicleFeed
from gcs.link_hub import MavsdkHub

MODE_TIMEOUT_S = 5.0
CLIMB_SLOWEST_M_S = 0.5
SINK_SLOWEST_M_S = 0.3
MANOEUVRE_EXTRA_S = 60.0
"""PX4 has taken 45 s to notice that it had landed from 8 m."""
ALTITUDE_TOLERANCE_M = 0.5
LAND_ATTEMPTS = 3


class MavsdkLink:
    """Implements `agents.ports.VehicleLink` for the vehicle `system_id` on `url`, over the process's `hub`.

    `now_s` is the mission clock, which runs `speed` times as fast as the wall. Flights time out on the mission clock,
    the radio link (`heartbeat_timeout_s`) on the wall's.
    """

    def __init__(
        self,
        hub: MavsdkHub,
        url: str,
        system_id: int,
        frame: MissionFrame,
        now_s: Callable[[], float],
        speed: float = 1.0,
        *,
        telemetry_rate_hz: float = 20.0,
        heartbeat_timeout_s: float = 10.0,
        ready_timeout_s: float = 60.0,
    ) -> None:
        self._hub = hub
        self._url = url
        self._system_id = system_id
        self._frame = frame
        self._now_s = now_s
        self._speed = speed
        self._telemetry_rate_hz = telemetry_rate_hz
        self._heartbeat_timeout_s = heartbeat_timeout_s
        self._ready_timeout_s = ready_timeout_s
        self._parts: _Parts | None = None
        self._guided: Callable[[], object] | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._silent = False
        self._sent = 0
        self._unsent = 0

    @property
    def status(self) -> VehicleStatus:
        """The newest status heard."""
        return self._parts.feed.status if self._parts is not None else VehicleStatus()

    @property
    def dropped(self) -> int:
        """How many telemetry samples were dropped for numbers that are not finite."""
        return self._parts.feed.dropped if self._parts is not None else 0

    @property
    def unsent(self) -> int:
        """How many setpoints could not be handed to MAVSDK."""
        return self._unsent

    def set_speed(self, speed: float) -> None:
        """Tell how many times faster than the wall the mission clock runs, once that is measured."""
        self._speed = speed
        if self._parts is not None:
            self._parts.calls.speed = speed

    async def connect(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        """Find the vehicle, verify its system id, request rates; from now on deliver telemetry on the event loop.

        Raises VehicleRefusedError when it is not heard, is another one, or does not know in time where it is.
        """
        system = await self._hub.find(self._url, self._system_id, self._heartbeat_timeout_s)
        feed = VehicleFeed(system, self._frame, self._now_s)
        calls = VehicleCalls(self._system_id, feed, self._speed)
        self._parts = _Parts(system, feed, calls, Action(system), Offboard(system))
        self._guided = partial(choose_guided, system) if system.autopilot_type() is Autopilot.ARDUPILOT else None
        feed.subscribe()
        # After the action plugin is made, which turns EXTENDED_SYS_STATE down.
        await request_rates(calls, feed.plugin, self._telemetry_rate_hz)
        feed.origin_m = await find_origin(calls, feed, self._frame, self._ready_timeout_s)
        await calls.until(
            lambda: not feed.missing(), MODE_TIMEOUT_S, lambda: f"sent no {feed.missing()}", "check its estimator"
        )
        feed.on_reconnect = self._after_reconnection
        feed.on_telemetry = on_telemetry

    async def take_off(self, altitude_m: float) -> None:
        """Arm, climb to `altitude_m` above the mission origin's datum, and return when the vehicle hovers there."""
        _, feed, calls, action, _ = self._connected()
        if feed.status.armed and feed.status.in_air:
            raise calls.refusal("is in the air already", "land it first")
        self._silent = False
        await self._until_ready(lambda: feed.status.local_position_ok)
        if self._guided is not None:
            await self._enter(FlightMode.OFFBOARD, self._guided)
        elif feed.status.mode not in (FlightMode.HOLD, FlightMode.READY):
            # What the checks allow depends on the mode: PX4 does not arm in the one that the last landing left.
            await self._enter(FlightMode.HOLD, action.hold)
        await self._until_ready(lambda: feed.status.armable)
        climb_m = altitude_m - feed.ground_z_m
        await calls.command("take the take-off altitude", action.set_takeoff_altitude, climb_m)
        await calls.command("arm", action.arm)
        await calls.command("take off", action.takeoff)
        await calls.until(lambda: feed.status.armed, MODE_TIMEOUT_S, lambda: "did not arm", "see its messages")
        await calls.until(
            lambda: self._hovers(altitude_m) or not feed.status.armed,
            max(0.0, climb_m) / CLIMB_SLOWEST_M_S + MANOEUVRE_EXTRA_S,
            lambda: f"did not reach {altitude_m:g} m",
            "land it, and look at its log",
        )
        if not feed.status.armed:
            raise calls.refusal("disarmed during take-off", "clear what it complains about")

    async def start_offboard(self) -> None:
        """Enter offboard; setpoints must be flowing. Returns when the flight mode, not the acknowledgement, says so."""
        parts = self._connected()
        if not self._sent:
            raise parts.calls.refusal("has no setpoint to start offboard with", "send setpoints first")
        await self._enter(FlightMode.OFFBOARD, parts.offboard.start)

    async def stop_offboard(self) -> None:
        """Leave offboard into hold; returns when the flight mode says so. MAVSDK stops repeating setpoints at once."""
        await self._enter(FlightMode.HOLD, self._connected().offboard.stop)

    async def land(self) -> None:
        """Land where the vehicle is; returns when it is disarmed. Setpoints are ignored until the next take-off."""
        _, feed, calls, action, offboard = self._connected()
        # Landed from offboard, PX4 rests in offboard and refuses to arm; and when setpoints come back, it re-enters
        # offboard by itself: it has taken off again.
        self._silent = True
        if feed.status.mode is FlightMode.OFFBOARD or offboard.is_active():
            with suppress(VehicleRefusedError):  # it has to come down all the same
                await self.stop_offboard()
        height_m = feed.position_m[2] - feed.ground_z_m if feed.position_m is not None else 0.0
        await calls.command("land", action.land, attempts=LAND_ATTEMPTS)
        await calls.until(
            lambda: not feed.status.armed,
            max(0.0, height_m) / SINK_SLOWEST_M_S + MANOEUVRE_EXTRA_S,
            lambda: "did not land and disarm",
            "take over by remote control",
        )

    def hand_over(self) -> None:
        """Send nothing from now on, and leave the flight mode alone: somebody else has the vehicle."""
        self._silent = True
        if self._parts is not None:
            # MAVSDK falls silent by itself only once it has been in offboard for a while: without its plugin it must.
            self._parts.offboard.destroy()
            self._parts = self._parts._replace(offboard=Offboard(self._parts.system))

    def take_back(self) -> None:
        """Let setpoints through again; offboard has to be started anew."""
        self._silent = False
        self._sent = 0

    def send(self, setpoint: Setpoint) -> None:
        """Send one setpoint now, unless it is landing or handed over; never blocks, never raises for a lost link.

        MAVSDK repeats the last one at 20 Hz from a thread of its own until offboard is stopped.
        """
        parts = self._parts
        if self._silent:
            return
        if parts is None or parts.feed.origin_m is None:
            self._unsent += 1
            return
        x, y, z = setpoint.position_m
        x0, y0, z0 = parts.feed.origin_m
        north_m, east_m, down_m = self._frame.ned_from_mission((x - x0, y - y0, z - z0))
        heading_deg = degrees(wrap_signed_rad(self._frame.x_bearing_rad - setpoint.yaw_rad))
        try:
            parts.offboard.set_position_ned(PositionNedYaw(north_m, east_m, down_m, heading_deg))
            self._sent += 1
        except (MavsdkError, RuntimeError):
            self._unsent += 1

    async def measure_speed(self, duration_s: float = 1.0) -> float:
        """Return how many times faster than the wall the autopilot's clock runs; 1 for a real vehicle.

        A ratio within a tenth of a whole number is that number. Raises VehicleRefusedError when attitudes stay away.
        """
        _, feed, calls, _, _ = self._connected()
        ratio = clock_ratio(await feed.attitude_clock(duration_s), duration_s)
        if ratio is None:
            raise calls.refusal("sends no attitude to tell the time by", "check the link, or state the speed")
        return ratio

    async def close(self) -> None:
        """Release the link; calls in flight are drained first. May be called twice, and without `connect`."""
        parts, self._parts = self._parts, None
        for task in self._tasks:
            task.cancel()
        if parts is not None:
            parts.feed.on_telemetry = parts.feed.on_reconnect = None
            await parts.calls.close()
            await asyncio.to_thread(parts.destroy)
            await self._hub.release(self._url, self._system_id)

    def _connected(self) -> "_Parts":
        if self._parts is None:
            raise VehicleRefusedError(f"vehicle {self._system_id} is not connected", "connect first")
        return self._parts

    def _hovers(self, altitude_m: float) -> bool:
        feed = self._connected().feed
        off_m = feed.position_m[2] - altitude_m if feed.position_m is not None else ALTITUDE_TOLERANCE_M
        return feed.status.mode is not FlightMode.TAKE_OFF and abs(off_m) < ALTITUDE_TOLERANCE_M

    async def _until_ready(self, condition: Callable[[], bool]) -> None:
        _, feed, calls, _, _ = self._connected()
        await calls.until(
            condition,
            self._ready_timeout_s,
            lambda: f"was not ready ({feed.failing()})",
            "clear what it complains about",
        )

    async def _enter(self, mode: FlightMode, function: Callable[[], object]) -> None:
        _, feed, calls, _, _ = self._connected()
        await calls.command(f"enter {mode.value}", function)
        await calls.until(
            lambda: feed.status.mode is mode,
            MODE_TIMEOUT_S,
            lambda: f"is in {feed.status.mode.value} and did not enter {mode.value}",
            "clear what it complains about",
        )

    def _after_reconnection(self) -> None:
        task = asyncio.get_running_loop().create_task(self._renew())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _renew(self) -> None:
        """Ask again for rates and origin: an autopilot that restarted has forgotten the one and moved the other."""
        with suppress(VehicleRefusedError):  # telemetry that stays away or jumps will tell
            _, feed, calls, _, _ = self._connected()
            await request_rates(calls, feed.plugin, self._telemetry_rate_hz)
            feed.origin_m = await find_origin(calls, feed, self._frame, self._ready_timeout_s)


class _Parts(NamedTuple):
    """What a connected link is made of."""

    system: Any
    feed: VehicleFeed
    calls: VehicleCalls
    action: Any
    offboard: Any

    def destroy(self) -> None:
        """Destroy MAVSDK's plugins; blocks for a moment."""
        self.offboard.destroy()
        self.action.destroy()
        self.feed.close()
