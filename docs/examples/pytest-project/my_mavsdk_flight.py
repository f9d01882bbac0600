"""A flight by MAVSDK: arm, take off, fly to a place in offboard, land."""

from collections.abc import AsyncIterator, Callable
from math import dist
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.offboard import PositionNedYaw


async def fly(url: str, north_m: float, east_m: float, height_m: float) -> None:
    """Fly the vehicle at `url` to a place relative to its start, and land there."""
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=-1.0)
        action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)
        await first(telemetry.subscribe_health(), lambda health: health.is_armable)
        await action.arm()
        await action.takeoff()
        await first(telemetry.subscribe_position(), lambda position: position.relative_altitude_m > 2.0)

        await offboard.set_position_ned(PositionNedYaw(north_m, east_m, -height_m, 0.0))
        await offboard.start()

        def arrived(motion: Any) -> bool:
            place = motion.position
            return dist((place.north_m, place.east_m, place.down_m), (north_m, east_m, -height_m)) < 0.3

        await first(telemetry.subscribe_position_velocity_ned(), arrived)
        await action.land()
        await first(telemetry.subscribe_armed(), lambda armed: not armed)


async def first(values: AsyncIterator[Any], condition: Callable[[Any], bool]) -> None:
    """Wait for a value that meets a condition."""
    async for value in values:
        if condition(value):
            return
