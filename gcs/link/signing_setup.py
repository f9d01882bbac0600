"""Setting up the signing keys of vehicles: SETUP_SIGNING, and whether each vehicle signs with its key afterwards."""

import asyncio
import ipaddress
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage

from agents.ports import VehicleRefusedError
from gcs.link.calls import AUTOPILOT_COMPONENT
from gcs.link.hub import MavsdkHub
from gcs.link.relay.signing import wall_ticks
from gcs.mission.mission import MissionVehicle

FIND_TIMEOUT_S = 5.0
SENT_TIMES, SENT_PERIOD_S = 3, 0.2
"""SETUP_SIGNING has no acknowledgement; a repeated one does no harm."""


@dataclass(frozen=True, slots=True)
class SetUp:
    """The result for a vehicle: whether it signs with its key, and what was done or why not."""

    vehicle_id: int
    signs: bool
    found: str
    next_step: str = ""


async def set_up_signing(vehicles: Sequence[MissionVehicle], keys: Mapping[int, bytes]) -> tuple[SetUp, ...]:
    """Give each vehicle its key, by system id, unless it has it already."""
    hub = MavsdkHub()
    try:
        return tuple(await asyncio.gather(*(_set_up(hub, each, keys[each.system_id]) for each in vehicles)))
    finally:
        await hub.close()


def leaves_this_computer(url: str) -> bool:
    """Return whether other computers may receive the link of a url: over a network, or by radio."""
    parts = urlsplit(url)
    if parts.scheme == "serial":
        return "ttyACM" not in url and "usb" not in url
    with suppress(ValueError):
        return not ipaddress.ip_address(parts.hostname or "").is_loopback
    return parts.hostname != "localhost"


async def _set_up(hub: MavsdkHub, vehicle: MissionVehicle, key: bytes) -> SetUp:
    url, system_id = vehicle.section.url, vehicle.system_id
    with suppress(VehicleRefusedError):
        await hub.find(url, system_id, FIND_TIMEOUT_S, signing_key=key)
        await hub.release(url, system_id)
        return SetUp(vehicle.id, True, "it signs with its key already")
    try:
        await _send_key(await hub.find(url, system_id, FIND_TIMEOUT_S), system_id, key)
        await hub.release(url, system_id)
    except VehicleRefusedError as refusal:
        return SetUp(vehicle.id, False, refusal.reason, refusal.next_step)
    try:
        await hub.find(url, system_id, FIND_TIMEOUT_S, signing_key=key)
        await hub.release(url, system_id)
    except VehicleRefusedError as refusal:
        step = (
            "disarm it, and check that its firmware supports SETUP_SIGNING (ArduPilot does, PX4 since 1.18); a vehicle"
            " with another key accepts this one over USB, or after that key has been removed"
        )
        return SetUp(vehicle.id, False, f"it was sent its key, but {refusal.reason}", step)
    return SetUp(vehicle.id, True, "it has its key, and signs")


async def _send_key(system: Any, system_id: int, key: bytes) -> None:
    fields = {"target_system": system_id, "target_component": AUTOPILOT_COMPONENT}
    fields_json = json.dumps({**fields, "secret_key": list(key), "initial_timestamp": wall_ticks()})
    message = MavlinkMessage("SETUP_SIGNING", 0, 0, system_id, AUTOPILOT_COMPONENT, fields_json)
    direct = MavlinkDirect(system)
    try:
        for _ in range(SENT_TIMES):
            await asyncio.to_thread(direct.send_message, message)
            await asyncio.sleep(SENT_PERIOD_S)
    finally:
        await asyncio.to_thread(direct.destroy)
        await asyncio.to_thread(system.destroy)
