"""Reads an autopilot's parameters and estimator report, which MAVSDK's plugins read slowly or not at all.

All parameters are requested at once, and missing ones again. MAVSDK's client requests one name after the other and
waits three seconds for each that the firmware does not have. Nothing is written.
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
from gcs.link.estimator_report import EstimatorReport, estimator_report
from gcs.preflight.estimator import DIALECTS
from gcs.preflight.findings import AutopilotKind

REQUEST_PERIOD_S = 0.4
POLL_S = 0.02
REQUEST_MESSAGE = 512
INTEGER_LAST = 6
"""The last MAV_PARAM_TYPE of an integer of 32 bits or less; 9 is a 32-bit float."""


async def read_parameters(
    system: Any, kind: AutopilotKind, wanted: Sequence[Sequence[str]], timeout_s: float
) -> Mapping[str, float | None]:
    """Return parameters by name; None for those not received within `timeout_s` wall seconds.

    Each entry of `wanted` holds the possible names of one parameter: one received name completes it.
    """
    values: dict[str, float | None] = dict.fromkeys(name for names in wanted for name in names)
    loop, direct = asyncio.get_running_loop(), MavlinkDirect(system)
    system_id = int(system.get_system_id())

    def take(message: Any, _user_data: object) -> None:
        with suppress(ValueError, KeyError):  # malformed bytes are dropped here
            fields = json.loads(message.fields_json)
            if message.system_id == system_id and fields["param_id"] in values:
                values[fields["param_id"]] = parameter_value(kind, fields["param_type"], fields["param_value"])

    direct.subscribe_message("PARAM_VALUE", take)
    try:
        end_s = loop.time() + timeout_s
        requested_s = -REQUEST_PERIOD_S
        while (missing := _missing(wanted, values)) and loop.time() < end_s:
            if loop.time() - requested_s >= REQUEST_PERIOD_S:
                requested_s = loop.time()
                _request(direct, system_id, missing)
            await asyncio.sleep(POLL_S)
    finally:
        await asyncio.to_thread(direct.destroy)
    return values


def read_estimator(system: Any, kind: AutopilotKind, timeout_s: float) -> EstimatorReport | None:
    """Request the estimator report; None without one within `timeout_s` wall seconds.

    Blocks, and for longer than `timeout_s` where a request is not acknowledged.
    """
    dialect = DIALECTS.get(kind)
    if dialect is None:
        return None
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
            received.wait(REQUEST_PERIOD_S)
    finally:
        direct.destroy()
    return reports[-1] if reports else None


def parameter_value(kind: AutopilotKind, wire_type: int, value: float | None) -> float | None:
    """Decode a PARAM_VALUE: PX4 sends the bytes of an integer as a float, ArduPilot its value as a float."""
    if value is None or not isfinite(value):
        return None
    if kind is AutopilotKind.PX4 and wire_type <= INTEGER_LAST:
        return float(struct.unpack("<i", struct.pack("<f", value))[0])
    return float(value)


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
