"""The identity of an autopilot: its firmware, its unique id, and the vendor of its board."""

import time
from contextlib import suppress
from typing import Any, NamedTuple

from mavsdk.plugins.info import Info, InfoError
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError

from gcs.link.calls import command_long

REQUEST_PERIOD_S = 0.5
REQUEST_MESSAGE, AUTOPILOT_VERSION = 512, 148
RELEASED = ("release", "unknown")


class Identity(NamedTuple):
    """The firmware, such as 1.17.0-beta+0f1e2d3c, empty if unknown, and two numbers of AUTOPILOT_VERSION."""

    firmware: str = ""
    uid: int | None = None
    vendor_id: int | None = None


def read_identity(system: Any, timeout_s: float) -> Identity:
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
        return identity or Identity()
    finally:
        plugin.destroy()
        direct.destroy()


def _received(plugin: Any) -> Identity | None:
    try:
        uid, vendor_id = plugin.get_identification().legacy_uid, plugin.get_product().vendor_id
        return Identity(_firmware(plugin.get_version()), int(uid), int(vendor_id))
    except InfoError:
        return None


def _firmware(version: Any) -> str:
    kind, commit = version.flight_sw_version_type.name.lower(), version.flight_sw_git_hash
    numbers = f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}"
    return numbers + ("" if kind in RELEASED else f"-{kind}") + (f"+{commit}" if commit.strip("0") else "")
