"""Facts of the vehicles on the ground over MAVSDK, for the preflight checks: read-only, without arming.

Reads an autopilot's parameters and estimator report, which MAVSDK's plugins read slowly or not at all.

All parameters are requested at once, and missing ones again. MAVSDK's client requests one name after the other and
waits three seconds for each that the firmware does not have. Nothing is written.
"""

import asyncio
import json
import threading
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import inf, radians
from typing import Any, NamedTuple

from mavsdk.plugins.geofence import FenceType, Geofence, GeofenceError
from mavsdk.plugins.info import Info, InfoError
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage
from mavsdk.plugins.mission_raw import MissionRaw, MissionRawError
from mavsdk.vehicle import Vehicle

from agents.ports import VehicleRefusedError
from agents.safety.failsafe import SILENCES_PER_HOUR_MAX
from agents.shell.clock import MissionClock, WallClock, link_s
from estimation.frames import Geodetic, MissionFrame
from gcs.autopilots.autopilot import Autopilot
from gcs.link.calls import AUTOPILOT_COMPONENT, NotReadyError, NotReceivedError, VehicleCalls, command_long, find_origin
from gcs.link.config import link_paces
from gcs.link.feed import VehicleFeed
from gcs.link.gimbal import FOUND_WITHIN_S, NO_GIMBAL_FACTS, CameraGimbal
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.rates import FRAMES_MIN, Losses, RateController, Rates, Traffic
from gcs.link.received_fields import PARAMETER, UNIQUE_ID
from gcs.link.self_reports import EstimatorReport, estimator_report
from gcs.link.signing_keys import signing_keys
from gcs.link.status_texts import HealthItem
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.areas import circle_corners
from gcs.preflight.findings import FenceArea, GpsFix, VehicleFacts
from gcs.preflight.vehicle import CALM_MODES

_PARAMETER_REQUEST_PERIOD_S = 0.4
POLL_S = 0.02
REQUEST_MESSAGE = 512


async def read_parameters(system: Any, autopilot: Autopilot, timeout_s: float) -> Mapping[str, float | None]:
    """Return the parameters wanted by name; None for those not received within `timeout_s` wall seconds.

    Each entry holds the possible names of one parameter: one received name completes it.
    """
    wanted = autopilot.parameters_wanted
    values: dict[str, float | None] = dict.fromkeys(name for names in wanted for name in names)
    loop, direct = asyncio.get_running_loop(), MavlinkDirect(system)
    system_id = int(system.get_system_id())

    def take(message: Any, _user_data: object) -> None:
        with suppress(ValueError, KeyError):  # malformed bytes are dropped here
            fields = json.loads(message.fields_json)
            if message.system_id == system_id and fields["param_id"] in values:
                values[fields["param_id"]] = parameter_value(autopilot, fields["param_type"], fields["param_value"])

    direct.subscribe_message("PARAM_VALUE", take)
    try:
        end_s = loop.time() + timeout_s
        requested_s = -_PARAMETER_REQUEST_PERIOD_S
        while (missing := _missing(wanted, values)) and loop.time() < end_s:
            if loop.time() - requested_s >= _PARAMETER_REQUEST_PERIOD_S:
                requested_s = loop.time()
                _request(direct, system_id, missing)
            await asyncio.sleep(POLL_S)
    finally:
        await asyncio.to_thread(direct.destroy)
    return values


def read_estimator(system: Any, autopilot: Autopilot, timeout_s: float) -> EstimatorReport | None:
    """Request the estimator report; None without one within `timeout_s` wall seconds.

    Blocks, and for longer than `timeout_s` where a request is not acknowledged.
    """
    if not autopilot.is_known:
        return None
    dialect = autopilot.estimator
    direct, system_id = MavlinkDirect(system), int(system.get_system_id())
    received, reports = threading.Event(), list[EstimatorReport]()

    def take(message: Any, _user_data: object) -> None:
        with suppress(ValueError):  # malformed bytes are dropped here
            fields = json.loads(message.fields_json)
            report = estimator_report(dialect, fields) if message.system_id == system_id else None
            if report is not None:
                reports.append(report)
                received.set()

    direct.subscribe_message(dialect.message, take)
    try:
        end_s = time.monotonic() + timeout_s
        while not received.is_set() and time.monotonic() < end_s:
            with suppress(MavlinkDirectError):  # not acknowledged: the report may still come unrequested
                direct.send_command(command_long(system_id, REQUEST_MESSAGE, dialect.number))
            received.wait(_PARAMETER_REQUEST_PERIOD_S)
    finally:
        direct.destroy()
    return reports[-1] if reports else None


def parameter_value(autopilot: Autopilot, wire_type: int, value: float | None) -> float | None:
    """Decode a PARAM_VALUE as JSON holds it: without the bytes that are no number."""
    known = PARAMETER.known(value)
    number = None if known is None else autopilot.parameter(wire_type, known)
    return None if number is None else float(number)


def _missing(wanted: Sequence[Sequence[str]], values: Mapping[str, float | None]) -> list[str]:
    return [name for names in wanted if all(values[name] is None for name in names) for name in names]


def _request(direct: Any, system_id: int, names: Sequence[str]) -> None:
    for name in names:
        fields = {"target_system": system_id, "target_component": AUTOPILOT_COMPONENT}
        fields_json = json.dumps({**fields, "param_id": name, "param_index": -1})
        try:
            direct.send_message(MavlinkMessage("PARAM_REQUEST_READ", 0, 0, system_id, AUTOPILOT_COMPONENT, fields_json))
        except MavlinkDirectError:  # the link is down: the findings report the missing value
            return


REQUEST_PERIOD_S = 0.5
REQUEST_MESSAGE, AUTOPILOT_VERSION = 512, 148
RELEASED = ("release", "unknown")


class AutopilotVersion(NamedTuple):
    """The firmware, such as 1.17.0-beta+0f1e2d3c, empty if unknown, and two numbers of AUTOPILOT_VERSION."""

    firmware: str = ""
    uid: int | None = None
    vendor_id: int | None = None


def read_identity(system: Any, timeout_s: float) -> AutopilotVersion:
    """Return an autopilot's identity; blocks for `timeout_s` wall seconds if it is not received.

    MAVSDK requests it once on connection; on a link with losses it is requested again.
    """
    plugin, direct = Info(system), MavlinkDirect(system)
    end_s = time.monotonic() + timeout_s
    try:
        while (identity := _received(plugin)) is None and time.monotonic() < end_s:
            with suppress(MavlinkDirectError):  # not acknowledged: the message may still arrive
                direct.send_command(command_long(system.get_system_id(), REQUEST_MESSAGE, AUTOPILOT_VERSION))
            time.sleep(REQUEST_PERIOD_S)
        return identity or AutopilotVersion()
    finally:
        plugin.destroy()
        direct.destroy()


def _received(plugin: Any) -> AutopilotVersion | None:
    try:
        uid, vendor_id = plugin.get_identification().legacy_uid, plugin.get_product().vendor_id
        known = None if UNIQUE_ID.known(uid) is None else int(uid)
        return AutopilotVersion(_firmware(plugin.get_version()), known, int(vendor_id))
    except InfoError:
        return None


def _firmware(version: Any) -> str:
    kind, commit = version.flight_sw_version_type.name.lower(), version.flight_sw_git_hash
    numbers = f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}"
    return numbers + ("" if kind in RELEASED else f"-{kind}") + (f"+{commit}" if commit.strip("0") else "")


HEARTBEAT_TIMEOUT_S = 5.0
ORIGIN_TIMEOUT_S = 5.0
STATUS_TIMEOUT_S = 4.0
LISTENING_S = 1.5
TRAFFIC_S = 2.0
CORRECTIONS, CORRECTION_S = 3, 1.0
"""How often, and after which time, messages at other rates than requested are requested again before losses count."""
LOSSES_S, LOSSES_LONGEST_S = 40.0, 90.0
"""How long the losses of a connection are counted where they are not known before, and where they would refuse it."""
FRAMES_ENOUGH, BURSTS_ENOUGH = 300, 2
"""The number of frames without a loss that shows that there are few, and that of bursts which may show their length."""
PARAMETERS_TIMEOUT_S = 3.0
LISTENING_IN_FLIGHT_S, PARAMETERS_IN_FLIGHT_S = 0.8, 1.5
"""Shorter timeouts for the preflight check in `fly`, whose links are connected already."""
SLOW_PERIODS = 4.0
"""Timeout in periods of the status rate: GPS and battery status come at half of it, and one message may be lost."""

_DEG_E7 = 1e7
"""Of the integers of mission items."""


def are_known(losses: Losses, pace: RateController, counted_s: float) -> bool:
    """Return whether losses that were counted for a time [s of the link] decide about their connection.

    They do if they permit a flight even with the longest bursts that they may mean; after LOSSES_S, if those that are
    likely do, or if not even the shortest do. Where the data rate is unknown, only losses are counted.
    """
    if counted_s >= LOSSES_LONGEST_S:
        return True
    if not losses.lost:
        return pace.capacity_bytes_s is None or losses.frames >= FRAMES_ENOUGH
    least, likely, most = pace.silences_of(losses)
    if counted_s < LOSSES_S:
        return losses.bursts >= BURSTS_ENOUGH and most <= SILENCES_PER_HOUR_MAX
    return likely <= SILENCES_PER_HOUR_MAX or least > SILENCES_PER_HOUR_MAX


async def known_losses(
    count: Callable[[], Losses], pace: RateController, clock: MissionClock, since_s: float
) -> Losses:
    """Return the losses of a connection once they are known; they have been counted since a time [s of the link]."""
    while not are_known(count(), pace, link_s(clock) - since_s):
        await clock.sleep(_PARAMETER_REQUEST_PERIOD_S * clock.time_scale)
    return count()


async def _nothing() -> None:
    """Do nothing beside the queries."""


async def gather_facts(
    mission: Mission,
    beside: Callable[[], Awaitable[None]] = _nothing,
) -> tuple[VehicleFacts, ...]:
    """Query all vehicles of a mission at once; times are wall seconds. Unreachable vehicles are included.

    `beside` runs once all queries are answered, while the telemetry of all vehicles streams. Raises InputError if the
    signing keys of the links cannot be read.
    """
    keys, paces = signing_keys(mission), link_paces(mission)
    hub = MavsdkHub()
    streaming = _Streaming(len(mission.vehicles), beside)
    connections = {url: _Connection(hub, url, pace, streaming) for url, pace in paces.items()}
    try:
        queries = (
            _facts(connections[vehicle.section.url], mission, vehicle, keys.get(vehicle.system_id))
            for vehicle in mission.vehicles
        )
        return tuple(await asyncio.gather(*queries))
    finally:
        await hub.close()


class _Streaming:
    """Runs something once, while the telemetry of all vehicles streams."""

    def __init__(self, vehicles: int, beside: Callable[[], Awaitable[None]]) -> None:
        self._all = asyncio.Barrier(vehicles)
        self._beside = beside

    async def over(self) -> None:
        """Wait for all vehicles, and for the end of what runs; every vehicle's query has to await this."""
        if await self._all.wait() == 0:
            await self._beside()
        await self._all.wait()


class _Connection:
    """One connection and the queries of its vehicles."""

    def __init__(self, hub: MavsdkHub, url: str, pace: RateController, streaming: _Streaming) -> None:
        self.hub, self.pace, self.streaming = hub, pace, streaming
        self._url = url
        self._quiet = asyncio.Barrier(pace.vehicles)
        self._clock = WallClock()
        self._streaming, self._streaming_s = Traffic(), link_s(self._clock)

    def note_rates(self) -> None:
        """Count losses from now on: before the rates are set, default streams may fill a slow connection."""
        self._streaming, self._streaming_s = self.hub.traffic(self._url), link_s(self._clock)

    async def measured(self) -> tuple[float | None, Losses]:
        """Return the traffic per second from all vehicles once all queries are answered, and the losses.

        The traffic is None if the data rate is unknown. Every vehicle's query has to await this, also one without an
        answer.
        """
        await self._quiet.wait()
        before, began_s, bytes_s = self.hub.traffic(self._url), time.monotonic(), None
        if self.pace.capacity_bytes_s is not None:
            await asyncio.sleep(TRAFFIC_S)
            down_bytes = self.hub.traffic(self._url).down_bytes - before.down_bytes
            bytes_s = down_bytes / (time.monotonic() - began_s)
        losses = await known_losses(
            lambda: self.hub.traffic(self._url).losses(self._streaming), self.pace, self._clock, self._streaming_s
        )
        await self._quiet.wait()  # the first query that ends may close the connection
        return bytes_s, losses


class CheckedLink(MavsdkLink):
    """A vehicle's link that also reads the facts for the preflight checks; read-only."""

    _counted_since_s: float | None = None

    async def facts(self, vehicle_id: int, settle_s: float) -> VehicleFacts:
        """Return the facts of a connected vehicle once it is healthy, or `settle_s` [s of the link] have passed."""
        system, feed, calls, *_ = self._connected()
        if self._counted_since_s is None:
            self._counted_since_s = link_s(self._clock)
        healthy = calls.reached(lambda: _is_healthy(feed) and not feed.missing(), settle_s * self._clock.time_scale)
        query = _VehicleQuery(vehicle_id, system, feed, calls, self._config.frame, self._config.pace.rates)
        facts = await query.facts(LISTENING_IN_FLIGHT_S, PARAMETERS_IN_FLIGHT_S, after=healthy)
        pace = self._config.pace
        losses = await known_losses(lambda: pace.losses, pace, self._clock, self._counted_since_s)
        if losses.frames >= FRAMES_MIN:
            pace.adapt(losses)
        return replace(facts, link=self.report, losses=losses)

    def count_anew(self) -> None:
        """Count the losses of its connection from now on, for the facts as well."""
        self.pace.count_anew()
        self._counted_since_s = None

    async def _locate(self) -> None:
        """Look up the vehicle's origin; without one, its facts state that it is not ready."""
        with suppress(NotReadyError):
            self._connected().feed.locate(await self._origin(0.0))


def unreachable(vehicle_id: int, refusal: VehicleRefusedError, reason: str) -> VehicleFacts:
    """Return what is known of a vehicle whose link could not be connected, and for what reason."""
    silent = isinstance(refusal, NotReceivedError)
    return VehicleFacts(vehicle_id=vehicle_id, unreachable=(reason, refusal.next_step), silent=silent)


async def _facts(
    connection: _Connection,
    mission: Mission,
    vehicle: MissionVehicle,
    signing_key: bytes | None,
) -> VehicleFacts:
    hub, pace = connection.hub, connection.pace
    url, system_id, frame = vehicle.section.url, vehicle.system_id, mission.mission_frame()
    try:
        system = await hub.find(url, system_id, HEARTBEAT_TIMEOUT_S, signing_key=signing_key)
    except VehicleRefusedError as refusal:
        await connection.measured()
        await connection.streaming.over()
        return unreachable(vehicle.id, refusal, refusal.reason)
    clock = WallClock()
    gimbal = vehicle.section.gimbal
    view_rad = None if gimbal is None else radians(gimbal.view_deg)
    feed = VehicleFeed(system, frame, clock, hub.posted_calls, partial(hub.listen, system_id), view_rad=view_rad)
    calls = VehicleCalls(system_id, feed, clock, partial(hub.messages, system_id))
    try:
        feed.subscribe()
        with suppress(VehicleRefusedError):  # the measured rate shows a refusal
            hub.set_pace(url, pace, 1.0)
            await calls.request_rates(pace.rates)
        for _ in range(CORRECTIONS):
            await clock.sleep(CORRECTION_S)
            if await calls.correct_rates():
                break
        connection.note_rates()
        lost = await _find_place(vehicle, feed, calls, frame)
        query = _VehicleQuery(vehicle.id, system, feed, calls, frame, pace.rates)
        facts = await query.facts(LISTENING_S, PARAMETERS_TIMEOUT_S, lost)
        bytes_s, losses = await connection.measured()
        await connection.streaming.over()
        return replace(facts, link=hub.report(system_id), link_bytes_s=bytes_s, losses=losses)
    finally:
        await calls.close()
        await asyncio.to_thread(feed.close)
        await hub.release(url, system_id)


async def _find_place(
    vehicle: MissionVehicle, feed: VehicleFeed, calls: VehicleCalls, frame: MissionFrame
) -> tuple[str, str] | None:
    """Set the origin of the feed; return the reason and the next step if the vehicle has no position."""
    try:
        configured = vehicle.origin_m if frame.is_local else None
        feed.locate(configured or await find_origin(calls, feed, frame, WallClock(), ORIGIN_TIMEOUT_S))
    except VehicleRefusedError as refusal:
        return f"it {refusal.clause}", refusal.next_step
    with suppress(VehicleRefusedError):  # the facts state what is missing
        await calls.until(lambda: not feed.missing(), STATUS_TIMEOUT_S, lambda: "is silent", "wait")
    return None


class _VehicleQuery(NamedTuple):
    """A connected vehicle and the objects to query it with."""

    vehicle_id: int
    system: Any
    feed: VehicleFeed
    calls: VehicleCalls
    frame: MissionFrame
    rates: Rates

    async def facts(
        self,
        listening_s: float,
        parameters_timeout_s: float,
        lost: tuple[str, str] | None = None,
        after: Awaitable[object] | None = None,
    ) -> VehicleFacts:
        """Run all queries at once, those of its state `after` something; times are wall seconds."""
        autopilot = self.feed.autopilot

        async def state() -> tuple[Any, ...]:
            await (after or _nothing())
            return await asyncio.gather(
                read_parameters(self.system, autopilot, parameters_timeout_s),
                self._gps(),
                self.calls.run(_plans, self.system, self.frame),
                self.calls.run(read_estimator, self.system, autopilot, parameters_timeout_s),
                self.calls.run(read_identity, self.system, parameters_timeout_s),
            )

        timing, queried = await asyncio.gather(self._timing(listening_s), state())
        (ratio, rate_hz), (parameters, gps, (areas, rally_m), estimator, identity) = timing, queried
        await self._all_batteries()
        feed = self.feed
        if feed.gimbal is not None:
            await self.calls.told(partial(_is_known, feed.gimbal), FOUND_WITHIN_S)
        return VehicleFacts(
            vehicle_id=self.vehicle_id,
            autopilot=autopilot,
            system_id=int(self.system.get_system_id()),
            firmware=identity.firmware,
            uid=identity.uid,
            vendor_id=identity.vendor_id,
            multicopter=self.system.vehicle_type() is Vehicle.MULTICOPTER,
            status=feed.status,
            mode_received=feed.mode_received,
            health=feed.health(),
            failed_checks=feed.texts.failed_checks(),
            origin_m=feed.origin_m,
            lost=lost,
            position_m=feed.position_m,
            gps=gps,
            batteries=tuple(battery for _, battery in sorted(feed.batteries.newest.items())),
            estimator=estimator,
            clock_ratio=ratio,
            telemetry_rate_hz=rate_hz if feed.position_m is not None else None,  # else there is no motion to send
            telemetry_rate_asked_hz=self.rates.telemetry_hz,
            parameters=parameters,
            fence_areas=areas,
            rally_m=rally_m,
            gimbal=NO_GIMBAL_FACTS if feed.gimbal is None else feed.gimbal.facts,
        )

    async def _gps(self) -> GpsFix | None:
        """Wait for the status of the GPS receiver; None without one, and in a local frame."""
        feed = self.feed
        if feed.is_local:
            return None
        end_s = feed.link_s() + SLOW_PERIODS / self.rates.status_hz
        await self.calls.reached(lambda: feed.status.gps_dimensions is not None or feed.link_s() >= end_s, inf)
        dimensions = feed.status.gps_dimensions
        return None if dimensions is None else GpsFix(dimensions, feed.status.satellites)

    async def _all_batteries(self) -> None:
        """Wait until all batteries must have reported: ArduPilot reports one after the other."""
        await self.calls.reached(lambda: self.feed.age_s >= SLOW_PERIODS / self.rates.status_hz, inf)

    async def _timing(self, listening_s: float) -> tuple[float | None, float]:
        """Return the rate of the autopilot's clock relative to its link's, and the motion rate in that clock [Hz]."""
        motions, began_s = self.feed.motions, self.feed.link_s()
        ratio = await self.calls.clock_ratio(self.rates, listening_s)
        return ratio, (self.feed.motions - motions) / (self.feed.link_s() - began_s) / (ratio or 1.0)


def _is_known(gimbal: CameraGimbal) -> bool:
    return gimbal.facts.answers


def _is_healthy(feed: VehicleFeed) -> bool:
    """Return whether all health items are good; arming checks only in a mode in which cordon arms."""
    calm = feed.status.mode in CALM_MODES
    items = feed.health()
    return bool(items) and all(well or (item is HealthItem.ARMING and not calm) for item, well in items.items())


def _plans(
    system: Any, frame: MissionFrame
) -> tuple[tuple[FenceArea, ...] | None, tuple[tuple[float, float], ...] | None]:
    """Download geofence and rally points, one after the other: an autopilot answers for one plan at a time."""
    return _fence_areas(system, frame), _rally_m(system, frame)


def _rally_m(system: Any, frame: MissionFrame) -> tuple[tuple[float, float], ...] | None:
    """Download the rally points; None if that fails. Blocks, for seconds without an answer."""
    if frame.origin is None:
        return ()
    plugin, altitude_m = MissionRaw(system), frame.origin.altitude_m
    try:
        places = [Geodetic(each.x / _DEG_E7, each.y / _DEG_E7, altitude_m) for each in plugin.download_rallypoints()]
    except (MissionRawError, ValueError):
        return None
    finally:
        plugin.destroy()
    return tuple(frame.mission_from_geodetic(place)[:2] for place in places)


def _fence_areas(system: Any, frame: MissionFrame) -> tuple[FenceArea, ...] | None:
    """Download the geofence's areas; None if that fails. Blocks, for seconds without an answer."""
    if frame.origin is None:
        return ()
    plugin = Geofence(system)
    try:
        fence = plugin.download_geofence()
        return tuple(_area(frame, each, each.points) for each in fence.polygons) + tuple(
            _area(frame, each, [each.point], each.radius) for each in fence.circles
        )
    except (GeofenceError, ValueError):
        return None
    finally:
        plugin.destroy()


def _area(frame: MissionFrame, area: Any, points: Sequence[Any], radius_m: float = 0.0) -> FenceArea:
    """Return a polygon's area, or that of the circle about a single point; raises ValueError for an invalid area."""
    altitude_m = frame.origin.altitude_m if frame.origin is not None else 0.0
    places = (Geodetic(point.latitude_deg, point.longitude_deg, altitude_m) for point in points)
    corners = [frame.mission_from_geodetic(place)[:2] for place in places]
    if radius_m:
        corners = list(circle_corners(corners[0], radius_m))
    return FenceArea(tuple(corners), area.fence_type is FenceType.INCLUSION)
