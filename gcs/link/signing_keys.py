"""The file of a mission's MAVLink signing keys: one per vehicle, so that no vehicle can sign for another.

TOML, with a key of 32 bytes in hexadecimal digits by MAVLink system id: `1 = "00...ff"`. Only its user may read it.
"""

import asyncio
import ipaddress
import json
import secrets
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage

from agents.ports import VehicleRefusedError
from estimation.input_file import toml_content
from gcs.autopilots.registry import AUTOPILOTS
from gcs.errors import InputError
from gcs.keys.private_files import read_private, write
from gcs.link.calls import AUTOPILOT_COMPONENT
from gcs.link.hub import MavsdkHub
from gcs.link.relay.signing import KEY_LENGTH, wall_ticks
from gcs.mission.mission import Mission, MissionVehicle

FIND_TIMEOUT_S = 5.0
SENT_TIMES, SENT_PERIOD_S = 3, 0.2
"""SETUP_SIGNING has no acknowledgement; a repeated one does no harm."""


@dataclass(frozen=True, slots=True)
class SigningSetup:
    """The result for a vehicle: whether it signs with its key, and what was done or why not."""

    vehicle_id: int
    signs: bool
    found: str
    next_step: str = ""


async def set_up_signing(vehicles: Sequence[MissionVehicle], keys: Mapping[int, bytes]) -> tuple[SigningSetup, ...]:
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


async def _set_up(hub: MavsdkHub, vehicle: MissionVehicle, key: bytes) -> SigningSetup:
    url, system_id = vehicle.section.url, vehicle.system_id
    with suppress(VehicleRefusedError):
        await hub.find(url, system_id, FIND_TIMEOUT_S, signing_key=key)
        await hub.release(url, system_id)
        return SigningSetup(vehicle.id, True, "it signs with its key already")
    try:
        await _send_key(await hub.find(url, system_id, FIND_TIMEOUT_S), system_id, key)
        await hub.release(url, system_id)
    except VehicleRefusedError as refusal:
        return SigningSetup(vehicle.id, False, refusal.reason, refusal.next_step)
    try:
        await hub.find(url, system_id, FIND_TIMEOUT_S, signing_key=key)
        await hub.release(url, system_id)
    except VehicleRefusedError as refusal:
        supported = ", ".join(f"{each.label} {each.advice['signing']}" for each in reversed(AUTOPILOTS))
        step = (
            f"disarm it, and check that its firmware supports SETUP_SIGNING ({supported}); a vehicle"
            " with another key accepts this one over USB, or after that key has been removed"
        )
        return SigningSetup(vehicle.id, False, f"it was sent its key, but {refusal.reason}", step)
    return SigningSetup(vehicle.id, True, "it has its key, and signs")


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


SIZE_MAX = 65_536
ISSUE = "`cordon keys issue mavlink` creates keys and sets them up on the vehicles"
HEAD = "# MAVLink 2 signing keys by system id: a key commands its vehicle. Keep this file secret.\n"


def signing_keys(mission: Mission) -> Mapping[int, bytes]:
    """Return the keys of a mission's vehicles by system id; none if its links are not signed.

    Raises InputError when the file cannot be read, other users may read it, or a vehicle has no key in it.
    """
    path = signing_key_path(mission)
    if path is None:
        return {}
    keys = read_keys(path)
    missing = [vehicle.system_id for vehicle in mission.vehicles if vehicle.system_id not in keys]
    if missing:
        raise InputError([_fault(path, f"it has no key for system id {', '.join(map(str, missing))}; next: {ISSUE}")])
    return keys


def signing_key_path(mission: Mission) -> Path | None:
    """Return the path of the keys, None where links are not signed."""
    name = mission.link.signing_key_file
    return None if name is None else mission.folder / name


def read_keys(path: Path) -> dict[int, bytes]:
    """Return the keys in a file by system id; raises InputError."""
    if not path.is_file():
        raise InputError([_fault(path, f"there is no such file; next: {ISSUE}")])
    if path.stat().st_size > SIZE_MAX:
        raise InputError([_fault(path, f"it is larger than {SIZE_MAX} bytes")])
    try:
        content = toml_content(read_private(path).decode())
    except ValueError as error:
        raise InputError([_fault(path, str(error))]) from error
    return {_system_id(path, name): _key(path, name, value) for name, value in content.items()}


def issue_keys(path: Path, system_ids: Iterable[int]) -> dict[int, bytes]:
    """Return the keys in a file, after adding a random one for each system id without; raises InputError."""
    keys = read_keys(path) if path.exists() else {}
    lacking = [system_id for system_id in system_ids if system_id not in keys]
    if lacking:
        keys |= {system_id: secrets.token_bytes(KEY_LENGTH) for system_id in lacking}
        lines = (f'{system_id} = "{key.hex()}"\n' for system_id, key in sorted(keys.items()))
        write(path, (HEAD + "".join(lines)).encode())
    return keys


def _system_id(path: Path, name: str) -> int:
    if not (name.isascii() and name.isdecimal() and 1 <= int(name) <= 254):
        raise InputError([_fault(path, f"{name!r} is not a system id from 1 to 254")])
    return int(name)


def _key(path: Path, name: str, value: object) -> bytes:
    """Return a key from its digits, which no error message contains."""
    try:
        key = bytes.fromhex(value) if isinstance(value, str) else b""
    except ValueError:
        key = b""
    if len(key) != KEY_LENGTH or not any(key):
        raise InputError([_fault(path, f"the key of system id {name} is not {2 * KEY_LENGTH} hexadecimal digits")])
    return key


def _fault(path: Path, reason: str) -> str:
    return f"link.signing_key_file: {path}: {reason}"
