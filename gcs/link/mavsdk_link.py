"""One vehicle over MAVSDK in mission-frame metres: the only place with degrees, NED and autopilot dialects.

The flight mode in the heartbeat confirms a command, not its acknowledgement: PX4 acknowledges every change of mode
before it carries it out. Mode and armed are up to a second old.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from math import degrees
from typing import Any, NamedTuple

from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityNedYaw
from msgspec.structs import replace

from agents.ports import Connection, FlightMode, Setpoint, VehicleRefusedError, VehicleStatus
from agents.shell.clock import LinkTransit, MissionClock
from agents.team.external_positions import ExternalPosition
from agents.team.messages import CameraView
from estimation.frames import MissionFrame, Triple
from estimation.state import Telemetry
from estimation.vectors import wrap_signed_rad
from gcs.link.calls import VehicleCalls, choose_guided, find_origin
from gcs.link.config import LinkConfig
from gcs.link.external_position import NO_EXTERNAL_POSITION, ExternalPositionSender
from gcs.link.feed import VehicleFeed
from gcs.link.gimbal import CameraGimbal
from gcs.link.ground_truth import GroundTruth
from gcs.link.hub import MavsdkHub
from gcs.link.rates import RateController, Rates
from gcs.link.relay.frames import HEARTBEAT
from gcs.link.relay.gate import LinkReport
from gcs.link.self_reports import is_explained


class LinkParts(NamedTuple):
    """The MAVSDK objects of a connected link."""

    system: Any
    feed: VehicleFeed
    calls: VehicleCalls
    action: Any
    offboard: Any
    external: ExternalPositionSender | None

    def send(self, setpoint: Setpoint, origin_m: Triple | None, frame: MissionFrame) -> Triple:
        """Send a setpoint to the vehicle in its own NED, whose origin is at `origin_m` in the mission frame.

        While that is not known, send it to stop, by a velocity: a position would be one of the old origin.
        Returns the position in NED that is sent. Raises what MAVSDK raises.
        """
        heading_deg = degrees(wrap_signed_rad(frame.x_bearing_rad - setpoint.yaw_rad))
        if origin_m is None:
            self.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, heading_deg))
            return (0.0, 0.0, 0.0)
        x, y, z = setpoint.position_m
        x0, y0, z0 = origin_m
        ned_m = frame.ned_from_mission((x - x0, y - y0, z - z0))
        place = PositionNedYaw(*ned_m, heading_deg)
        if setpoint.velocity_m_s:
            x_rate, y_rate, climb = setpoint.velocity_m_s
            velocity = VelocityNedYaw(*frame.ned_from_mission((x_rate, y_rate, climb)), heading_deg)
            self.offboard.set_position_velocity_ned(place, velocity)
        else:
            self.offboard.set_position_ned(place)
        return ned_m

    def destroy(self) -> None:
        """Destroy MAVSDK's plugins; blocks until running callbacks have returned."""
        if self.external is not None:
            self.external.close()
        self.offboard.destroy()
        self.action.destroy()
        self.feed.close()


class PeriodicWait:
    """Waits for periods of a link, or until it is notified."""

    def __init__(self, clock: MissionClock) -> None:
        self._clock = clock
        self._over = asyncio.Event()
        self._notified = False

    def notify(self) -> None:
        """End the present wait."""
        self._notified = True
        self._over.set()

    async def wait(self, period_s: float) -> bool:
        """Wait for a period [s of the link] or for a notification, and return whether it was notified."""
        timer = self._clock.call_at(self._clock.now_s() + period_s * self._clock.time_scale, self._over.set)
        try:
            await self._over.wait()
        finally:
            timer.cancel()
        self._over.clear()
        notified, self._notified = self._notified, False
        return notified


MODE_TIMEOUT_S = 5.0
REQUEST_PERIOD_S = 1.0
"""After this a mode that was not entered is requested again [s of the link]."""
CLIMB_SLOWEST_M_S = 0.5
SINK_SLOWEST_M_S = 0.3
MANOEUVRE_EXTRA_S = 60.0
"""PX4 has needed 45 s to detect a landing from 8 m."""
ALTITUDE_TOLERANCE_M = 0.5
REFUSALS = 3
"""How often a mode or a landing has to be refused: the autopilot may carry it out a moment later."""
KILL_ATTEMPTS, KILL_ANSWER_S = 5, 2.0
"""Heartbeats, which confirm disarming, come once a second."""
HEARTBEATS, HEARTBEATS_WITHIN_S = 3, 10.0
"""The status shows what a command has done once so many heartbeats have come since: the last of them was sent after its
arrival, also where a message and its answer take 2.5 s.
"""
WATCH_PERIOD_S = 1.0
SILENCE_MAX_S = 3.0
"""Without motion for this long on a live link, the autopilot has lost the rates: they are requested again."""
RENEWAL_TIMEOUT_S = 5.0
EXPLAINED_S = 3.0
"""Status texts of this time explain a failsafe."""


class MavsdkLink:
    """Implements `agents.ports.VehicleLink` for the vehicle that `config` names, over the process's `hub`.

    Flights time out on the mission's `clock`, the radio link on what carries its messages: the wall's, unless the
    clock is governed.
    """

    def __init__(self, hub: MavsdkHub, config: LinkConfig, clock: MissionClock) -> None:
        self._hub = hub
        self._config = config
        self._clock = clock
        self._transit: LinkTransit | None = None
        self.truth = GroundTruth(config.system_id, config.frame, clock.now_s) if config.truth else None
        self._parts: LinkParts | None = None
        self._gimbal: CameraGimbal | None = None
        self._guided: Callable[[], object] | None = None
        self._keepers: list[asyncio.Task[None]] = []
        self._watch_period = PeriodicWait(clock)
        self._silent = False
        self._muted = False
        self._asking = 0
        self._sent = 0
        self._unsent = 0
        self._newest: Setpoint | None = None
        self._ground_z_m = 0.0
        self._rates: Rates | None = None

    @property
    def status(self) -> VehicleStatus:
        """The newest status received; where expected, with a lack of external positions and the gimbal's fault."""
        if self._parts is None:
            return VehicleStatus()
        status = self._parts.feed.status
        if self._parts.external is not None and self._parts.external.is_stale:
            status = replace(status, estimator_fault=NO_EXTERNAL_POSITION)
        if self._gimbal is not None and (fault := self._gimbal.fault):
            status = replace(status, gimbal_fault=fault, camera=None if self._gimbal.is_silent else status.camera)
        return status

    @property
    def motion(self) -> Telemetry | None:
        """The newest telemetry, None before the first."""
        return self._parts.feed.motion if self._parts is not None else None

    @property
    def views(self) -> Sequence[CameraView]:
        """Where its camera looked so far, as its gimbal reported; empty without a gimbal that is pointed."""
        return () if self._gimbal is None else self._gimbal.views

    @property
    def dropped(self) -> int:
        """Number of telemetry samples dropped for numbers that are not finite."""
        return self._parts.feed.dropped if self._parts is not None else 0

    @property
    def unsent(self) -> int:
        """Number of setpoints that MAVSDK did not accept."""
        return self._unsent

    @property
    def pace(self) -> RateController:
        """The pace of its connection, which all vehicles there share."""
        return self._config.pace

    @property
    def report(self) -> LinkReport:
        """What arrived with the vehicle's system id, from it and from others."""
        return self._hub.report(self._config.system_id)

    def follow_clock(self) -> None:
        """Set the connection's pace of sending by the clock's speed, once it has been measured."""
        if self._parts is not None:
            self._hub.set_pace(self._config.url, self._config.pace, self._clock.speed)

    async def connect(self, on_telemetry: Callable[[Telemetry], None]) -> None:
        """Find the vehicle, verify its system id, request rates, and deliver telemetry on the event loop from then on.

        Raises VehicleRefusedError when it is not received, has another id, or has no position in time.
        """
        system = await self._hub.find(
            self._config.url,
            self._config.system_id,
            self._config.heartbeat_timeout_s,
            signing_key=self._config.signing_key,
            speed=self._clock.speed,
        )
        self._transit = self._clock.transit(self._config.system_id)
        feed = VehicleFeed(
            system,
            self._config.frame,
            self._clock,
            self._hub.posted_calls,
            partial(self._hub.listen, self._config.system_id),
            by_failsafe=lambda: self.report.failsafe,
            truth=self.truth,
            transit=self._transit,
            view_rad=self._config.view_rad,
            asks_traffic=self._config.traffic,
        )
        self._gimbal = feed.gimbal
        received = partial(self._hub.messages, self._config.system_id)
        calls = VehicleCalls(self._config.system_id, feed, self._clock, received)
        external = None
        if self._config.external_positions:
            external = ExternalPositionSender(system, self._config.frame, self._config.origin_m)
        self._parts = LinkParts(system, feed, calls, Action(system), Offboard(system), external)
        guided = feed.autopilot.guided_mode
        self._guided = None if guided is None else partial(choose_guided, system, guided)
        feed.subscribe()
        self._hub.repeat_heartbeat(self._config.system_id)
        # After the action plugin, whose constructor lowers the rate of EXTENDED_SYS_STATE.
        await self._request_rates()
        await self._locate()
        feed.on_telemetry = on_telemetry
        feed.on_loss, feed.on_return = self._mute, self._on_return
        feed.on_offboard_left = self._explain_failsafe
        self._keepers = [asyncio.create_task(self._keep()), asyncio.create_task(self._keep_rates())]

    def locate(self, position: ExternalPosition) -> None:
        """Send the autopilot an external position."""
        parts = self._parts
        if parts is not None and parts.external is not None:
            parts.external.send(position)

    async def take_off(self, altitude_m: float) -> None:
        """Arm, climb to `altitude_m` above the mission origin's datum, and return when the vehicle hovers there."""
        _, feed, calls, action, *_ = self._connected()
        if feed.status.armed and feed.status.in_air:
            raise calls.refusal("is already in the air", "land it first")
        self._silent = False
        await self._until_ready(lambda: feed.status.local_position_ok)
        if self._guided is not None:
            await self._enter(FlightMode.OFFBOARD, self._guided)
        elif not self._can_hold:
            await self._plan_climb(altitude_m)
            await self._enter(FlightMode.TAKE_OFF, action.takeoff)
        elif feed.status.mode not in (FlightMode.HOLD, FlightMode.READY):
            # The arming checks depend on the mode: PX4 does not arm in the mode of the last landing.
            await self._enter(FlightMode.HOLD, action.hold)
        await self._until_ready(lambda: feed.status.armable)
        climb_m = await self._plan_climb(altitude_m)
        began_s = time.monotonic()
        await calls.command("arm", action.arm, done=lambda: feed.status.armed)
        # PX4 climbs by the take-off altitude from where it receives the command: one that climbs receives none.
        await calls.command(
            "take off", action.takeoff, done=lambda: feed.status.in_air or feed.status.mode is FlightMode.TAKE_OFF
        )
        await calls.until(lambda: feed.status.armed, MODE_TIMEOUT_S, lambda: "did not arm", "see its messages")
        await calls.until(
            lambda: self._hovers(altitude_m) or not feed.status.armed,
            max(0.0, climb_m) / CLIMB_SLOWEST_M_S + MANOEUVRE_EXTRA_S,
            lambda: f"did not reach {altitude_m:g} m",
            "land it, and examine its log",
        )
        if not feed.status.armed:
            raise calls.refusal("disarmed during take-off", "resolve the cause that the autopilot reports", began_s)

    async def start_offboard(self) -> None:
        """Enter offboard; setpoints must be flowing. Returns when the flight mode confirms it."""
        parts = self._connected()
        if not self._sent:
            raise parts.calls.refusal("has no setpoint to start offboard with", "send setpoints first")
        if not parts.feed.status.armed:
            raise parts.calls.refusal("is disarmed and cannot start offboard", "end the flight, then take off again")
        await self._enter(FlightMode.OFFBOARD, parts.offboard.start)

    async def stop_offboard(self) -> None:
        """Switch from offboard to hold; returns when the flight mode confirms it. MAVSDK stops repeating setpoints.

        Until then it repeats the last one: without setpoints the autopilot's failsafe acts where the command is lost. A
        vehicle that cannot hold by itself stays in offboard, at its last setpoint, until it lands.
        """
        if not self._can_hold:
            return
        try:
            await self._enter(FlightMode.HOLD, self._connected().action.hold)
        finally:
            self._mute()

    async def catch_up(self) -> None:
        """Wait until the status shows what the calls so far have done, also those that failed or were cancelled."""
        calls, received = self._connected().calls, partial(self._hub.messages, self._config.system_id)
        await calls.idle()
        end = received().get(HEARTBEAT, 0) + HEARTBEATS
        within_s = self._clock.allowed_s(HEARTBEATS_WITHIN_S)
        await calls.reached(lambda: received().get(HEARTBEAT, 0) >= end, within_s)

    async def land(self) -> None:
        """Land where the vehicle is; returns when it is disarmed. Setpoints are ignored until the next take-off."""
        _, feed, calls, action, offboard, _ = self._connected()
        # After landing from offboard, PX4 stays in offboard and refuses to arm; and when setpoints return, it
        # re-enters offboard by itself and takes off again.
        self._silent = True
        if feed.status.mode is FlightMode.OFFBOARD or offboard.is_active():
            with suppress(VehicleRefusedError):  # it lands nevertheless
                await self.stop_offboard()
        height_m = feed.position_m[2] - self._ground_z_m if feed.position_m is not None else 0.0
        await calls.command(
            "land",
            action.land,
            refusals=REFUSALS,
            done=lambda: feed.status.mode is FlightMode.LAND or not feed.status.armed,
        )
        self._mute()
        await calls.until(
            lambda: not feed.status.armed,
            max(0.0, height_m) / SINK_SLOWEST_M_S + MANOEUVRE_EXTRA_S,
            lambda: "did not land and disarm",
            "take over by remote control",
        )

    async def kill(self) -> None:
        """Cut the motors now, whatever controls the vehicle: it falls. Returns when it is disarmed.

        Arming is never forced afterwards; setpoints are ignored until the next take-off.
        """
        _, feed, calls, action, *_ = self._connected()
        self._silent = True
        try:
            await calls.command_until(
                "cut its motors",
                action.kill,
                lambda: not feed.status.armed,
                attempts=KILL_ATTEMPTS,
                each_s=KILL_ANSWER_S,
            )
        finally:
            self._mute()

    def hand_over(self) -> None:
        """Stop sending and leave the flight mode unchanged: a pilot or ground station controls the vehicle."""
        self._silent = True
        self._mute()

    def take_back(self) -> None:
        """Send setpoints again; offboard has to be started again."""
        self._silent = False
        self._sent = 0

    def send(self, setpoint: Setpoint) -> None:
        """Send one setpoint now, unless the vehicle lands or is handed over; never blocks or raises for a lost link.

        MAVSDK repeats the last one at 20 Hz until offboard is stopped; the relay sends no more than the
        setpoint rate. None is sent after a loss of the link or a restart, until the vehicle has sent its origin again.
        While the origin is read again on a live link, the vehicle is sent to stop instead.
        """
        parts = self._parts
        if self._silent:
            return
        origin_m = parts.feed.setpoint_origin_m if parts is not None else None
        if parts is None or (origin_m is None and not parts.feed.is_doubted):
            self._unsent += 1
            return
        try:
            if self._muted:
                self._hub.mute(self._config.url, self._config.system_id, False)
                self._muted = False
            ned_m = parts.send(setpoint, origin_m, self._config.frame)
            self._newest = setpoint
            self._sent += 1
            # One that waits in the transmit queue may never be sent: a newer one replaces it.
            if self._transit is not None and not self._config.pace.is_bound:
                self._transit.send(*ned_m)
            if self._gimbal is not None:
                self._gimbal.point(setpoint.camera_rad)
        except (MavsdkError, RuntimeError):
            self._unsent += 1

    async def measure_speed(self, duration_s: float = 1.0) -> float:
        """Return how many times faster than the wall the autopilot's clock runs; 1 for a real vehicle.

        A ratio within a tenth of a whole number is rounded to it. Raises VehicleRefusedError without attitudes.
        """
        _, _feed, calls, *_ = self._connected()
        ratio = await calls.clock_ratio(self._config.pace.rates, duration_s)
        if ratio is None:
            raise calls.refusal("sends no attitude for the clock's speed", "check the link, or state the speed")
        return ratio

    async def close(self) -> None:
        """Release the link after running calls have ended. May be called twice, and without `connect`."""
        parts, self._parts = self._parts, None
        for keeper in self._keepers:
            keeper.cancel()
        if parts is not None:
            feed = parts.feed
            feed.on_telemetry = feed.on_loss = feed.on_return = feed.on_offboard_left = None
            await parts.calls.close()
            await asyncio.to_thread(parts.destroy)
            await self._hub.release(self._config.url, self._config.system_id)

    def _connected(self) -> LinkParts:
        if self._parts is None:
            raise VehicleRefusedError("is not connected", "connect first", subject=f"vehicle {self._config.system_id}")
        return self._parts

    async def _plan_climb(self, altitude_m: float) -> float:
        """Set the take-off altitude relative to where the vehicle stands, and return it.

        Autopilots take it from their home, which they set there when they arm: a home that was received before is old.
        """
        _, feed, calls, action, *_ = self._connected()
        if feed.position_m is not None:
            self._ground_z_m = feed.position_m[2]
        climb_m = altitude_m - self._ground_z_m
        await calls.command("set the take-off altitude", action.set_takeoff_altitude, climb_m)
        return climb_m

    @property
    def _can_hold(self) -> bool:
        """Whether the vehicle can hold by itself: PX4's hold needs a global position, its take-off mode does not."""
        return self._guided is not None or not self._config.frame.is_local

    def _hovers(self, altitude_m: float) -> bool:
        feed = self._connected().feed
        off_m = feed.position_m[2] - altitude_m if feed.position_m is not None else ALTITUDE_TOLERANCE_M
        arrived = feed.status.mode is not FlightMode.TAKE_OFF or not self._can_hold
        return arrived and abs(off_m) < ALTITUDE_TOLERANCE_M

    async def _until_ready(self, condition: Callable[[], bool]) -> None:
        _, feed, calls, *_ = self._connected()
        within_s = self._config.ready_timeout_s
        if not await calls.reached(condition, self._clock.allowed_s(within_s)):
            failure = f"was not ready ({feed.failing()}) within {within_s:g} s"
            raise calls.unready(failure, "resolve the cause that the autopilot reports")

    async def _enter(self, mode: FlightMode, function: Callable[[], object]) -> None:
        """Request a mode repeatedly: autopilots accept the command even if they cannot enter the mode yet.

        PX4 then refuses it in a second answer, which is MAVSDK's result where the first is lost.
        """
        _, feed, calls, *_ = self._connected()
        began_s = time.monotonic()

        def entered() -> bool:
            return feed.status.mode is mode

        await self._request(mode, function, entered)
        end_s = self._clock.now_s() + self._clock.allowed_s(MODE_TIMEOUT_S)
        while not await calls.reached(entered, REQUEST_PERIOD_S * self._clock.time_scale):
            if self._clock.now_s() > end_s:
                failure = f"is in {feed.status.mode.value} and did not enter {mode.value} within {MODE_TIMEOUT_S:g} s"
                raise calls.refusal(failure, "resolve the cause that the autopilot reports", began_s)
            await self._request(mode, function, entered)

    async def _request(self, mode: FlightMode, function: Callable[[], object], entered: Callable[[], bool]) -> None:
        _, feed, calls, *_ = self._connected()
        self._asking += 1
        try:
            await calls.command(f"enter {mode.value}", function, refusals=REFUSALS, done=entered)
        finally:
            self._asking -= 1
            if self._silent or (feed.origin_m is None and not feed.is_doubted):
                self._mute()

    def _on_return(self) -> None:
        """Read what is missing now; stop a vehicle whose origin is in doubt, as MAVSDK repeats the old position."""
        if self._sent and self._newest is not None and self._connected().feed.is_doubted:
            self.send(self._newest)
        self._watch_period.notify()

    def _mute(self) -> None:
        """Stop MAVSDK from repeating the last setpoint, which it would continue for a while; none is under way.

        Repeated setpoints after a lost link would let PX4 leave its failsafe and re-enter offboard unnoticed.
        """
        self._hub.mute(self._config.url, self._config.system_id, True)
        self._muted = True
        if self._parts is not None and not self._asking:  # a running call must keep its plugin
            self._sent = 0
            self._parts.offboard.destroy()
            self._parts = self._parts._replace(offboard=Offboard(self._parts.system))

    def _explain_failsafe(self) -> None:
        """Note the lost connection that explains why the autopilot's failsafe left offboard, if nothing else does.

        Setpoints are not acknowledged.
        """
        feed = self._connected().feed
        if self._silent or is_explained(feed.status, feed.texts.refusing(time.monotonic() - EXPLAINED_S)):
            return
        if feed.origin_m is None:
            feed.reports.note_lost(Connection.GROUND_STATION)
        elif self._config.pace.losses.lost >= 1.0:
            feed.reports.note_lost(Connection.SETPOINTS)

    async def _keep(self) -> None:
        """Request rates and origin again after a reconnection, after a restart, and without motion on a live link.

        Read the origin again where it is in doubt.
        """
        feed = self._connected().feed
        resets = self.report.estimator_resets
        while True:
            notified = await self._watch_period.wait(WATCH_PERIOD_S)
            if self._clock.is_governed:
                self._hub.send_heartbeats(self._config.url)  # MAVSDK sends heartbeats by the wall's clock
            feed.reports.expire()
            feed.expire_traffic()
            feed.judge_connection()
            silent = feed.motion_age_s > SILENCE_MAX_S
            if silent and (feed.origin_m is not None or feed.is_doubted):
                feed.lose()
            before, resets = resets, self.report.estimator_resets
            if before is not None and resets != before:
                feed.doubt()
            lost = feed.origin_m is None and not (self._config.frame.is_local and feed.clock_received)
            if feed.is_doubted and feed.origin_m is None:
                with suppress(VehicleRefusedError):  # read again later; until then the vehicle stays where it is
                    feed.locate(await self._origin(RENEWAL_TIMEOUT_S))
            elif feed.status.connected and (notified or lost or silent):
                with suppress(VehicleRefusedError):  # requested again later; until then there is no telemetry
                    await self._renew()
            self._config.pace.look(self._hub.traffic(self._config.url), time.monotonic())
            feed.note_link(self.report.round_trip_s, self._config.pace.fault, self._clock.time_scale)

    async def _keep_rates(self) -> None:
        """Request rates that have changed, and messages again that arrive at other rates than requested.

        Over a link that is cut meanwhile a request waits for seconds: that must not delay what `_keep` notices.
        """
        _, feed, calls, *_ = self._connected()
        while True:
            await self._clock.sleep(WATCH_PERIOD_S * self._clock.time_scale)
            if self._rates is not self._config.pace.rates:
                with suppress(VehicleRefusedError):
                    await self._request_rates()
            elif feed.status.connected and feed.motion_age_s < WATCH_PERIOD_S:
                await calls.correct_rates()

    async def _request_rates(self) -> None:
        """Request the rates in force, and set them in the relay."""
        self._rates = self._config.pace.rates
        self._hub.set_pace(self._config.url, self._config.pace, self._clock.speed)
        await self._connected().calls.request_rates(self._rates)

    async def _renew(self) -> None:
        """Request rates and origin: a restarted autopilot has lost the rates, and its origin may have moved.

        Setpoints follow an origin: the flight mode is received before, as setpoints take PX4 back into offboard.
        """
        _, feed, calls, *_ = self._connected()
        await self._request_rates()
        feed.forget_mode()  # the newest may be from before the loss
        await calls.until(
            lambda: feed.clock_received and feed.mode_received,
            RENEWAL_TIMEOUT_S,
            lambda: "sent no flight mode" if feed.clock_received else "sent no attitude",
            "check the link",
        )
        if feed.origin_m is None:
            feed.locate(await self._origin(RENEWAL_TIMEOUT_S))

    async def _locate(self) -> None:
        """Find the origin of the vehicle, and wait for its first telemetry; raises VehicleRefusedError."""
        _, feed, calls, *_ = self._connected()
        feed.locate(await self._origin(self._config.ready_timeout_s))
        missing = feed.missing
        await calls.until(lambda: not missing(), MODE_TIMEOUT_S, lambda: f"sent no {missing()}", "check its estimator")

    async def _origin(self, timeout_s: float) -> Triple | None:
        """Return the origin of the vehicle's NED frame in the mission frame.

        In a local frame it is the configured origin until the autopilot restarts; after a restart it is unknown.
        """
        _, feed, calls, *_ = self._connected()
        if self._config.frame.is_local:
            return None if feed.status.restarts else self._config.origin_m
        return await find_origin(calls, feed, self._config.frame, self._clock, timeout_s)
