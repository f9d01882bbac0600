"""One vehicle over MAVSDK, in mission-frame metres: degrees, NED and the autopilot's dialect stop here.

The flight mode heard in heartbeats is the evidence that a command took effect, not its acknowledgement: PX4 first
acknowledges every change of mode, then decides. Mode and armed lag behind by up to a second.
"""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from math import degrees, inf
from typing import Any, NamedTuple

from mavsdk.autopilot import Autopilot
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityNedYaw

from agents.ports import (
    FlightMode,
    Setpoint,
    VehicleRefusedError,
    VehicleStatus,
)
from estimation.frames import MissionFrame, Triple, wrap_signed_rad
from estimation.state import Telemetry
from gcs.link.calls import (
    VehicleCalls,
    choose_guided,
    find_origin,
    measure_clock,
    request_rates,
)
from gcs.link.feed import VehicleFeed
from gcs.link.hub import MavsdkHub
from gcs.mission.mission import LinkSection

MODE_TIMEOUT_S = 5.0
CLIMB_SLOWEST_M_S = 0.5
SINK_SLOWEST_M_S = 0.3
MANOEUVRE_EXTRA_S = 60.0
"""PX4 has taken 45 s to notice that it had landed from 8 m."""
ALTITUDE_TOLERANCE_M = 0.5
LAND_ATTEMPTS = 3
KILL_ATTEMPTS, KILL_HEARD_S = 5, 2.0
"""Heartbeats, which tell that it is disarmed, come once a second."""
WATCH_PERIOD_S = 1.0
SILENCE_MAX_S = 3.0
"""Motion that stays away for longer on a link that lives was forgotten by the autopilot, and is asked for again."""
RENEWAL_TIMEOUT_S = 5.0
SETPOINT_EARLY_SHARE = 0.25
"""How much of its period a setpoint may be early: ticks are not exact."""


class MavsdkLink:
    """Implements `agents.ports.VehicleLink` for the vehicle `system_id` on `url`, over the process's `hub`.

    `now_s` is the mission clock, which runs `speed` times as fast as the wall. Flights time out on the mission clock,
    the radio link (`heartbeat_timeout_s`) on the wall's. In a local frame `origin_m` is where the vehicle's NED begins.
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
        settings: LinkSection | None = None,
        origin_m: Triple | None = None,
        heartbeat_timeout_s: float = 10.0,
        ready_timeout_s: float = 60.0,
    ) -> None:
        self._hub = hub
        self._url = url
        self._system_id = system_id
        self._frame = frame
        self._now_s = now_s
        self._speed = speed
        self._settings = settings or LinkSection()
        self._told_origin_m = origin_m or (0.0, 0.0, 0.0)
        self._heartbeat_timeout_s = heartbeat_timeout_s
        self._ready_timeout_s = ready_timeout_s
        self._parts: _Parts | None = None
        self._guided: Callable[[], object] | None = None
        self._keeper: asyncio.Task[None] | None = None
        self._attention = asyncio.Event()
        self._silent = False
        self._asking = 0
        self._sent = 0
        self._unsent = 0
        self._send_next_s = -inf

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
        await request_rates(calls, feed.plugin, self._settings)
        feed.origin_m = await self._origin(self._ready_timeout_s)
        await calls.until(
            lambda: not feed.missing(), MODE_TIMEOUT_S, lambda: f"sent no {feed.missing()}", "check its estimator"
        )
        feed.on_telemetry = on_telemetry
        feed.on_loss, feed.on_return = self._mute, self._attention.set
        self._keeper = asyncio.get_running_loop().create_task(self._keep())

    async def take_off(self, altitude_m: float) -> None:
        """Arm, climb to `altitude_m` above the mission origin's datum, and return when the vehicle hovers there."""
        _, feed, calls, action, _ = self._connected()
        if feed.status.armed and feed.status.in_air:
            raise calls.refusal("is in the air already", "land it first")
        self._silent = False
        await self._until_ready(lambda: feed.status.local_position_ok)
        if self._guided is not None:
            await self._enter(FlightMode.OFFBOARD, self._guided)
        elif not self._can_hold:
            await self._plan_climb(altitude_m)
            await self._enter(FlightMode.TAKE_OFF, action.takeoff)
        elif feed.status.mode not in (FlightMode.HOLD, FlightMode.READY):
            # What the checks allow depends on the mode: PX4 does not arm in the one that the last landing left.
            await self._enter(FlightMode.HOLD, action.hold)
        await self._until_ready(lambda: feed.status.armable)
        climb_m = await self._plan_climb(altitude_m)
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
        if not parts.feed.status.armed:
            raise parts.calls.refusal("is disarmed, and starts no offboard from there", "end the flight, take off anew")
        await self._enter(FlightMode.OFFBOARD, parts.offboard.start)

    async def stop_offboard(self) -> None:
        """Leave offboard into hold; returns when the flight mode says so. MAVSDK stops repeating setpoints at once.

        Where a vehicle cannot hold by itself, it stays in offboard, at its last setpoint, until it lands.
        """
        if not self._can_hold:
            return
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
        self._mute()
        await calls.until(
            lambda: not feed.status.armed,
            max(0.0, height_m) / SINK_SLOWEST_M_S + MANOEUVRE_EXTRA_S,
            lambda: "did not land and disarm",
            "take over by remote control",
        )

    async def kill(self) -> None:
        """Cut the motors now, wherever the vehicle is and whoever has it: it falls. Returns when it is disarmed.

        It is never armed by force afterwards; setpoints are ignored until the next take-off.
        """
        _, feed, calls, action, _ = self._connected()
        self._silent = True
        try:
            await calls.insist(
                "cut its motors",
                action.kill,
                lambda: not feed.status.armed,
                attempts=KILL_ATTEMPTS,
                each_s=KILL_HEARD_S,
            )
        finally:
            self._mute()

    def hand_over(self) -> None:
        """Send nothing from now on, and leave the flight mode alone: somebody else has the vehicle."""
        self._silent = True
        self._mute()

    def take_back(self) -> None:
        """Let setpoints through again; offboard has to be started anew."""
        self._silent = False
        self._sent = 0

    def send(self, setpoint: Setpoint) -> None:
        """Send one setpoint now, unless it is landing or handed over; never blocks, never raises for a lost link.

        Those that come faster than the setpoint rate are left out. MAVSDK repeats the last one at 20 Hz from a thread
        of its own until offboard is stopped. Nothing is sent to a vehicle whose place is not known: after a loss of the
        link or a restart that is until it has said anew where it is.
        """
        parts = self._parts
        if self._silent or not self._due():
            return
        if parts is None or parts.feed.origin_m is None:
            self._unsent += 1
            return
        x, y, z = setpoint.position_m
        x0, y0, z0 = parts.feed.origin_m
        north_m, east_m, down_m = self._frame.ned_from_mission((x - x0, y - y0, z - z0))
        heading_deg = degrees(wrap_signed_rad(self._frame.x_bearing_rad - setpoint.yaw_rad))
        place = PositionNedYaw(north_m, east_m, down_m, heading_deg)
        try:
            if setpoint.velocity_m_s:
                x_rate, y_rate, climb = setpoint.velocity_m_s
                velocity_m_s = self._frame.ned_from_mission((x_rate, y_rate, climb))
                parts.offboard.set_position_velocity_ned(place, VelocityNedYaw(*velocity_m_s, heading_deg))
            else:
                parts.offboard.set_position_ned(place)
            self._sent += 1
        except (MavsdkError, RuntimeError):
            self._unsent += 1

    async def measure_speed(self, duration_s: float = 1.0) -> float:
        """Return how many times faster than the wall the autopilot's clock runs; 1 for a real vehicle.

        A ratio within a tenth of a whole number is that number. Raises VehicleRefusedError when attitudes stay away.
        """
        _, feed, calls, _, _ = self._connected()
        ratio = await measure_clock(calls, feed, self._settings, duration_s)
        if ratio is None:
            raise calls.refusal("sends no attitude to tell the time by", "check the link, or state the speed")
        return ratio

    async def close(self) -> None:
        """Release the link; calls in flight are drained first. May be called twice, and without `connect`."""
        parts, self._parts = self._parts, None
        if self._keeper is not None:
            self._keeper.cancel()
        if parts is not None:
            parts.feed.on_telemetry = parts.feed.on_loss = parts.feed.on_return = None
            await parts.calls.close()
            await asyncio.to_thread(parts.destroy)
            await self._hub.release(self._url, self._system_id)

    def _connected(self) -> "_Parts":
        if self._parts is None:
            raise VehicleRefusedError(f"vehicle {self._system_id} is not connected", "connect first")
        return self._parts

    async def _plan_climb(self, altitude_m: float) -> float:
        """Tell the vehicle how far above its home to climb, and return that."""
        _, feed, calls, action, _ = self._connected()
        climb_m = altitude_m - feed.ground_z_m
        await calls.command("take the take-off altitude", action.set_takeoff_altitude, climb_m)
        return climb_m

    @property
    def _can_hold(self) -> bool:
        """Whether it can hold its place by itself: PX4's hold is a place on Earth; take-off hovers where it ends."""
        return self._guided is not None or not self._frame.is_local

    def _hovers(self, altitude_m: float) -> bool:
        feed = self._connected().feed
        off_m = feed.position_m[2] - altitude_m if feed.position_m is not None else ALTITUDE_TOLERANCE_M
        arrived = feed.status.mode is not FlightMode.TAKE_OFF or not self._can_hold
        return arrived and abs(off_m) < ALTITUDE_TOLERANCE_M

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
        self._asking += 1
        try:
            await calls.command(f"enter {mode.value}", function)
        finally:
            self._asking -= 1
            if self._silent or feed.origin_m is None:
                self._mute()
        await calls.until(
            lambda: feed.status.mode is mode,
            MODE_TIMEOUT_S,
            lambda: f"is in {feed.status.mode.value} and did not enter {mode.value}",
            "clear what it complains about",
        )

    def _due(self) -> bool:
        """Say whether a setpoint is due by the setpoint rate, and if so, plan the next."""
        if self._settings.setpoint_rate_hz is None:
            return True
        now_s, period_s = self._now_s(), 1.0 / self._settings.setpoint_rate_hz
        if now_s < self._send_next_s - SETPOINT_EARLY_SHARE * period_s:
            return False
        planned_s = self._send_next_s + period_s
        self._send_next_s = planned_s if planned_s > now_s else now_s + period_s
        return True

    def _mute(self) -> None:
        """Make MAVSDK forget the setpoint that it repeats; it falls silent by itself only after a while in offboard.

        Were it to go on after a lost link, PX4 would be back in offboard, out of its failsafe, before anybody saw it.
        """
        if self._parts is not None and not self._asking:  # a call that is in flight must not lose its plugin
            self._sent = 0
            self._parts.offboard.destroy()
            self._parts = self._parts._replace(offboard=Offboard(self._parts.system))

    async def _keep(self) -> None:
        """Ask again for rates and origin whenever the vehicle came back, restarted, or fell silent on a living link."""
        feed = self._connected().feed
        while True:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._attention.wait(), WATCH_PERIOD_S)
            told = self._attention.is_set()
            self._attention.clear()
            silent = time.monotonic() - feed.motion_heard_s > SILENCE_MAX_S
            if silent and feed.origin_m is not None:
                feed.lose()
            lost = feed.origin_m is None and not (self._frame.is_local and feed.clock_heard)
            if feed.status.connected and (told or lost or silent):
                with suppress(VehicleRefusedError):  # asked again later; meanwhile there is no telemetry
                    await self._renew()

    async def _renew(self) -> None:
        """Ask for rates and origin: an autopilot that restarted has forgotten the one and moved the other."""
        _, feed, calls, _, _ = self._connected()
        await request_rates(calls, feed.plugin, self._settings)
        await calls.until(lambda: feed.clock_heard, RENEWAL_TIMEOUT_S, lambda: "sent no attitude", "check the link")
        if feed.origin_m is None:
            feed.origin_m = await self._origin(RENEWAL_TIMEOUT_S)

    async def _origin(self, timeout_s: float) -> Triple | None:
        """Return where the vehicle's own NED begins.

        In a local frame that is as told until the autopilot restarts: then it may begin anywhere, and nobody knows.
        """
        _, feed, calls, _, _ = self._connected()
        if self._frame.is_local:
            return None if feed.status.restarts else self._told_origin_m
        return await find_origin(calls, feed, self._frame, timeout_s)


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
