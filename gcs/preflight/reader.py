"""Reading what MAVSDK's own plugins do not tell, or too slowly: an autopilot's parameters, its estimator's report.

Parameters are read all at once: one request each, side by side, and only what is missing again. MAVSDK's own client
asks for one name after the other, and waits three seconds for each that the firmware does not know. Nothing is written.
"""

import asyncio
import json
import struct
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import isfinite
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage

from gcs.link.calls import AUTOPILOT_COMPONENT, command_long
from gcs.preflight.estimator import DIALECTS, estimator_report
from gcs.preflight.findings import AutopilotKind, EstimatorReport

ASK_AGAIN_S = 0.4
POLL_S = 0.02
REQUEST_MESSAGE = 512
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


def read_estimator(system: Any, kind: AutopilotKind, timeout_s: float) -> EstimatorReport | None:
    """Ask for the estimator's report; None where it does not come within `timeout_s` wall seconds.

    Blocks: for longer than that where a request is not even acknowledged.
    """
    dialect = DIALECTS.get(kind)
    if dialect is None:
        return None
    direct, system_id = MavlinkDirect(system), int(system.get_system_id())
    heard, reports = threading.Event(), list[EstimatorReport]()

    def take(message: Any, _user_data: object) -> None:
        with suppress(ValueError):  # malformed bytes are dropped here
            told = json.loads(message.fields_json)
            report = estimator_report(kind, told) if message.system_id == system_id else None
            if report is not None:
                reports.append(report)
                heard.set()

    direct.subscribe_message(dialect.message, take)
    try:
        end_s = time.monotonic() + timeout_s
        while not heard.is_set() and time.monotonic() < end_s:
            with suppress(MavlinkDirectError):  # not acknowledged: it may come unasked, and else that is told
                direct.send_command(command_long(system_id, REQUEST_MESSAGE, dialect.number))
            heard.wait(ASK_AGAIN_S)
    finally:
        direct.destroy()
    return reports[-1] if reports else None


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
