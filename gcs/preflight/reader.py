"""Reads an autopilot's parameters and estimator report, which MAVSDK's plugins read slowly or not at all.

All parameters are requested at once, and missing ones again. MAVSDK's client requests one name after the other and
waits three seconds for each that the firmware does not have. Nothing is written.
"""

import asyncio
import json
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import isfinite
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage

from gcs.autopilots.autopilot import Autopilot
from gcs.link.calls import AUTOPILOT_COMPONENT, command_long
from gcs.link.estimator_report import EstimatorReport, estimator_report

REQUEST_PERIOD_S = 0.4
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
        requested_s = -REQUEST_PERIOD_S
        while (missing := _missing(wanted, values)) and loop.time() < end_s:
            if loop.time() - requested_s >= REQUEST_PERIOD_S:
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
            received.wait(REQUEST_PERIOD_S)
    finally:
        direct.destroy()
    return reports[-1] if reports else None


def parameter_value(autopilot: Autopilot, wire_type: int, value: float | None) -> float | None:
    """Decode a PARAM_VALUE as JSON holds it: without the bytes that are no number."""
    number = None if value is None or not isfinite(value) else autopilot.parameter(wire_type, value)
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
