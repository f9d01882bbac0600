"""The file of a mission's MAVLink signing keys: one per vehicle, so that no vehicle can sign for another.

TOML, with a key of 32 bytes in hexadecimal digits by MAVLink system id: `1 = "00...ff"`. Only its user may read it.
"""

import secrets
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path

from gcs.errors import InputError
from gcs.keys.private_files import read_private, write
from gcs.link.relay.signing import KEY_LENGTH
from gcs.mission.mission import Mission

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
        content = tomllib.loads(read_private(path).decode())
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
