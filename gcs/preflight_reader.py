"""Reading an autopilot's parameters all at once: one request each, side by side, and only what is missing again.

MAVSDK's own parameter client asks for one name after the other, and waits three seconds for each that the firmware does
not know. Nothing is written.
"""

import asyncio
import json
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import isfinite
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage

from gcs.findings import AutopilotKind
from gcs.link_calls import AUTOPILOT_COMPONENT

ASK_AGAIN_S = 0.4
POLL_S = 0.02
INTEGER_LAST = 6
"""The last MAV_PARAM_TYPE of an integer of 32 bits or less; 9 is a 32-bit float."""


async def read_parameters(
    system: Any, kind: AutopilotKind, wanted: Sequence[Sequence[str]], timeout_s: float
) -> Mapping[str, float | None]:
    """Return parameters by name; None for what was not answered within `timeout_s` wall seconds.

    Each entry of `wanted` holds several names of one parameter: it is answered once one of them is.
    """
    values: dict[str, float | None] = dict.fromkeys(name for names in wanted for name in names)
    loop, direct = asyncio.get_running_loop(), MavlinkDirect(system)
    system_id = int(system.get_system_id())

    def take(message: Any, _user_data: object) -> None:
        with suppress(ValueError, KeyError):  # malformed bytes are dropped here
            told = json.loads(message.fields_json)
            if message.system_id == system_id and told["param_id"] in values:
                values[told["param_id"]] = parameter_value(kind, told["param_type"], told["param_value"])

    direct.subscribe_message("PARAM_VALUE", take)
    try:
        end_s = loop.time() + timeout_s
        asked_s = -ASK_AGAIN_S
        while (missing := _missing(wanted, values)) and loop.time() < end_s:
            if loop.time() - asked_s >= ASK_AGAIN_S:
                asked_s = loop.time()
                _ask(direct, system_id, missing)
            await asyncio.sleep(POLL_S)
    finally:
        await asyncio.to_thread(direct.destroy)
    return values


def parameter_value(kind: AutopilotKind, wire_type: int, value: float | None) -> float | None:
    """Return what a PARAM_VALUE means: PX4 sends an integer's bytes as a float's, ArduPilot sends it as a float."""
    if value is None or not isfinite(value):
        return None
    if kind is AutopilotKind.PX4 and wire_type <= INTEGER_LAST:
        return float(struct.unpack("<i", struct.pack("<f", value))[0])
    return float(value)


def _missing(wanted: Sequence[Sequence[str]], values: Mapping[str, float | None]) -> list[str]:
    return [name for names in wanted if all(values[name] is None for name in names) for name in names]


def _ask(direct: Any, system_id: int, names: Sequence[str]) -> None:
    for name in names:
        fields = {"target_system": system_id, "target_component": AUTOPILOT_COMPONENT}
        fields_json = json.dumps({**fields, "param_id": name, "param_index": -1})
        try:
            direct.send_message(MavlinkMessage("PARAM_REQUEST_READ", 0, 0, system_id, AUTOPILOT_COMPONENT, fields_json))
        except MavlinkDirectError:  # a link that is down: the value stays unknown, and that is told
            return
