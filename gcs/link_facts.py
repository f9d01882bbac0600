"""What vehicles say about themselves on the ground, over MAVSDK: asked, listened to, never armed, nothing written."""

import asyncio
import time
from contextlib import suppress
from typing import Any

from mavsdk.autopilot import Autopilot
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.param import Param, ParamError, ParamResult
from mavsdk.plugins.telemetry import FixType
from mavsdk.vehicle import Vehicle

from agents.ports import VehicleRefusedError
from estimation.frames import MissionFrame, Triple
from estimation.state import Telemetry
from gcs.findings import AutopilotKind, GpsFix, VehicleFacts
from gcs.link_calls import VehicleCalls, clock_ratio, find_origin, request_rates
from gcs.link_feed import VehicleFeed
from gcs.link_hub import MavsdkHub
from gcs.mission import Mission, MissionVehicle
from gcs.preflight_parameters import parameters_wanted

HEARTBEAT_TIMEOUT_S = 5.0
ORIGIN_TIMEOUT_S = 5.0
STATUS_TIMEOUT_S = 4.0
LISTENING_S = 1.5
TELEMETRY_RATE_HZ = 20.0
KINDS = {Autopilot.PX4: AutopilotKind.PX4, Autopilot.ARDUPILOT: AutopilotKind.ARDUPILOT}
DIMENSIONS = {FixType.NO_GPS: 0, FixType.NO_FIX: 0, FixType.FIX_2D: 2}


async def gather_facts(mission: Mission, heartbeat_timeout_s: float = HEARTBEAT_TIMEOUT_S) -> tuple[VehicleFacts, ...]:
    """Ask all vehicles of a mission at once; times are wall seconds. A vehicle that is not there is a fact as well."""
    hub = MavsdkHub()
    frame = mission.mission_frame()
    try:
        asked = (_facts(hub, vehicle, frame, heartbeat_timeout_s) for vehicle in mission.vehicles)
        return tuple(await asyncio.gather(*asked))
    finally:
        await hub.close()


async def _facts(hub: MavsdkHub, vehicle: MissionVehicle, frame: MissionFrame, timeout_s: float) -> VehicleFacts:
    url, system_id = vehicle.section.url, vehicle.system_id
    try:
        system = await hub.find(url, system_id, timeout_s)
    except VehicleRefusedError as refusal:
        return VehicleFacts(vehicle_id=vehicle.id, unreachable=(refusal.reason, refusal.next_step))
    feed = VehicleFeed(system, frame, time.monotonic)
    calls = VehicleCalls(system_id, feed, speed=1.0)
    param = Param(system)
    kind = KINDS.get(system.autopilot_type(), AutopilotKind.OTHER)
    multicopter = system.vehicle_type() is Vehicle.MULTICOPTER
    try:
        return await _asked(vehicle.id, feed, calls, param, frame, kind, multicopter)
    finally:
        await calls.close()
        await asyncio.to_thread(param.destroy)
        await asyncio.to_thread(feed.close)
        await hub.release(url, system_id)


async def _asked(
    vehicle_id: int,
    feed: VehicleFeed,
    calls: VehicleCalls,
    param: Any,
    frame: MissionFrame,
    kind: AutopilotKind,
    multicopter: bool,
) -> VehicleFacts:
    feed.subscribe()
    with suppress(VehicleRefusedError):  # the rate that is measured will tell
        await request_rates(calls, feed.plugin, TELEMETRY_RATE_HZ)
    origin_m, lost = await _origin(vehicle_id, feed, calls, frame)
    feed.origin_m = origin_m
    with suppress(VehicleRefusedError):  # what is missing is told by the facts
        await calls.until(lambda: origin_m is None or not feed.missing(), STATUS_TIMEOUT_S, lambda: "is silent", "wait")
    ratio, rate_hz = await _timing(feed)
    parameters = await calls.run(_parameters, param, kind)
    return VehicleFacts(
        vehicle_id=vehicle_id,
        autopilot=kind,
        multicopter=multicopter,
        status=feed.status,
        health=feed.health(),
        says=feed.said(),
        origin_m=origin_m,
        lost=lost,
        position_m=feed.position_m,
        gps=await calls.run(_gps, feed.plugin),
        clock_ratio=ratio,
        telemetry_rate_hz=rate_hz if origin_m is not None else None,  # else nothing is delivered
        telemetry_rate_asked_hz=TELEMETRY_RATE_HZ,
        parameters=parameters,
    )


async def _origin(
    vehicle_id: int, feed: VehicleFeed, calls: VehicleCalls, frame: MissionFrame
) -> tuple[Triple | None, tuple[str, str] | None]:
    try:
        return await find_origin(calls, feed, frame, ORIGIN_TIMEOUT_S), None
    except VehicleRefusedError as refusal:
        return None, (refusal.reason.removeprefix(f"vehicle {vehicle_id} "), refusal.next_step)


async def _timing(feed: VehicleFeed) -> tuple[float | None, float]:
    """Return how fast the autopilot's clock runs, and the motion samples per second of that clock."""
    times_s: list[float] = []

    def note(sample: Telemetry) -> None:
        times_s.append(sample.time_s)

    feed.on_telemetry = note
    ratio = clock_ratio(await feed.attitude_clock(LISTENING_S), LISTENING_S)
    feed.on_telemetry = None
    return ratio, len(times_s) / LISTENING_S / (ratio or 1.0)


def _parameters(param: Any, kind: AutopilotKind) -> dict[str, float | None]:
    """Read the parameters that the preflight judges; blocks, for seconds where one is not answered."""
    values: dict[str, float | None] = {}
    for names in parameters_wanted(kind):
        for name in names:
            values[name] = _parameter(param, name)
            if values[name] is not None:
                break
    return values


def _parameter(param: Any, name: str) -> float | None:
    for read in (param.get_param_float, param.get_param_int):
        try:
            return float(read(name))
        except ParamError as error:
            if error.result is not ParamResult.WRONG_TYPE:
                return None
    return None


def _gps(telemetry: Any) -> GpsFix | None:
    try:
        info = telemetry.gps_info()
    except MavsdkError:
        return None
    return GpsFix(DIMENSIONS.get(info.fix_type, 3), int(info.num_satellites))
