"""An autopilot's reports on its estimator, GPS and connections, as fields of `VehicleStatus` and as a report."""

import asyncio
import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import acos, cos, degrees, hypot, inf, isfinite, radians
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkDirect
from mavsdk.plugins.telemetry import FixType

from agents.ports import Connection, GpsThreat, ModeSource
from agents.safety.failsafe import COMPASS, RATIO_MAX
from gcs.autopilots.autopilot import ATTITUDE, CORDON_ID, POS_VERT_ABS, SENSORS, EstimatorDialect
from gcs.autopilots.registry import autopilot_of
from gcs.link.received_fields import RATIOS, SATELLITES, WINDS


@dataclass(frozen=True, slots=True)
class EstimatorReport:
    """An estimator's report: test ratios by sensor (above 1 the sensor is rejected), available states, and faults.

    `relative` and `absolute`: a horizontal position is available, from its start or on Earth; `wrong` names its errors.
    Raises ValueError for ratios that are not finite.
    """

    ratios: Mapping[str, float]
    relative: bool
    absolute: bool
    wrong: tuple[str, ...] = ()
    glitch: bool = False

    def __post_init__(self) -> None:
        if not all(map(isfinite, self.ratios.values())):
            raise ValueError(f"a test ratio of {dict(self.ratios)} is not finite")


def wind_m_s(dialect: EstimatorDialect, fields: Mapping[str, object]) -> float | None:
    """Return the horizontal wind's speed in a message's fields; None where a component is unknown."""
    parts = [WINDS[name].known(fields.get(name)) for name in dialect.wind_components]
    known = [part for part in parts if part is not None]
    return hypot(*known) if len(known) == len(parts) else None


def estimator_report(dialect: EstimatorDialect, fields: Mapping[str, object]) -> EstimatorReport | None:
    """Return the report in a message's fields; None without flags. An unknown ratio is left out."""
    flags = fields.get("flags")
    if not isinstance(flags, int):
        return None
    values = (
        (name, RATIOS[field].known(fields.get(field))) for name, field in zip(SENSORS, dialect.ratios, strict=True)
    )
    faults = [fault for bit, fault in dialect.errors.items() if flags & bit]
    faults += ["no attitude"] if not flags & ATTITUDE else []
    faults += ["no height"] if not flags & POS_VERT_ABS else []
    return EstimatorReport(
        ratios={name: value for name, value in values if value is not None},
        relative=bool(flags & dialect.relative),
        absolute=bool(flags & dialect.absolute),
        wrong=tuple(faults),
        glitch=bool(flags & dialect.glitch),
    )


LOST_S = 15.0
"""A lost connection explains a mode change within this time: PX4 holds for 5 s before its failsafe acts."""
THREAT_S = 30.0
"""How long a status text about GPS signals counts: autopilots send it once."""
WIND_S = 10.0
"""How long a wind estimate counts: an estimator that loses it stops reporting it."""
DIMENSIONS = {FixType.NO_GPS: 0, FixType.NO_FIX: 0, FixType.FIX_2D: 2}
_LOST = re.compile(r"\b(lost|failsafe)\b", re.IGNORECASE)
_OVER = re.compile(r"\b(regained|cleared|restored)\b", re.IGNORECASE)
_CONNECTIONS = {
    Connection.GROUND_STATION: re.compile(r"\b(ground (control )?station|gcs)\b", re.IGNORECASE),
    Connection.REMOTE_CONTROL: re.compile(r"\b(remote control|manual control|rc|radio)\b", re.IGNORECASE),
}
CHANGES_WITHIN_S = 3.0
"""A report of who changes the mode explains a change within this time: heartbeats come once a second."""
_PILOT = re.compile(r"\bpilot took over\b", re.IGNORECASE)
AUTOPILOT_COMPONENT = 1
_CRITICAL = (5, 6)
"""MAV_STATE_CRITICAL and _EMERGENCY: PX4 reports them while it flies a failsafe, ArduPilot once one has triggered."""
_MODE_COMMANDS = (20, 21, 22, 176)
"""MAV_CMD_NAV_RETURN_TO_LAUNCH, _NAV_LAND, _NAV_TAKEOFF, _DO_SET_MODE."""
_ACCEPTED = 0
_THREATS = {
    GpsThreat.SPOOFED: re.compile(r"\b(gnss|gps)\b.*\bspoof", re.IGNORECASE),
    GpsThreat.JAMMED: re.compile(r"\b(gnss|gps)\b.*\bjam", re.IGNORECASE),
}


class SelfReports:
    """Subscribes to a system's reports, and passes changes of the status to `update`."""

    def __init__(self, system: Any, update: Callable[..., None]) -> None:
        self.direct: Any = MavlinkDirect(system)
        self.autopilot = autopilot_of(system.autopilot_type().name)
        self.system_id = int(system.get_system_id())
        self._update = update
        self._had_remote_control = False
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._mode: object = None
        self._is_critical = False
        self._changed_s = self._announced_s = -inf
        self._announced = ModeSource.UNKNOWN

    def subscribe(self, telemetry: Any, posting: Callable[[Callable[[Any], None]], Any], *, gps: bool) -> None:
        """Subscribe, to the GPS only if the mission needs it.

        `posting` wraps a function so that MAVSDK's thread may call it and it runs on the event loop.
        """
        self.direct.subscribe_message(self.autopilot.estimator.message, posting(self._take_estimator))
        self.direct.subscribe_message(self.autopilot.estimator.wind, posting(self._take_wind))
        self.direct.subscribe_message("HEARTBEAT", posting(self._take_heartbeat))
        self.direct.subscribe_message("COMMAND_ACK", posting(self._take_acknowledgement))
        telemetry.subscribe_rc_status(posting(self._take_remote_control))
        if gps:
            telemetry.subscribe_gps_info(posting(self._take_gps))

    def take_text(self, text: str) -> None:
        """Take a status text: autopilots report some conditions only as text."""
        if _PILOT.search(text):
            self._announce(ModeSource.PILOT)
        for threat, words in _THREATS.items():
            if words.search(text):
                self._keep("gps_threat", threat, GpsThreat.NONE, THREAT_S)
        for connection, words in _CONNECTIONS.items():
            if words.search(text) and _LOST.search(text) and not _OVER.search(text):
                self._keep("lost", connection, Connection.NONE, LOST_S)

    def note_lost(self, connection: Connection) -> None:
        """Take the connection whose loss explains a failsafe."""
        self._keep("lost", connection, Connection.NONE, LOST_S)

    def close(self) -> None:
        """Unsubscribe; blocks until running callbacks have returned."""
        self.direct.destroy()

    def _take_estimator(self, message: Any) -> None:
        with suppress(ValueError):  # malformed bytes are dropped here
            report = estimator_report(self.autopilot.estimator, json.loads(message.fields_json))
            if report is not None and message.system_id == self.system_id:
                self._update(**estimator_facts(report))

    def _take_wind(self, message: Any) -> None:
        with suppress(ValueError):
            speed_m_s = wind_m_s(self.autopilot.estimator, json.loads(message.fields_json))
            if speed_m_s is not None and message.system_id == self.system_id:
                self._keep("wind_m_s", round(speed_m_s, 1), None, WIND_S)

    def _take_heartbeat(self, message: Any) -> None:
        """Take mode and state; a failsafe that begins with a change of mode caused it."""
        with suppress(ValueError, KeyError):
            if (message.system_id, message.component_id) != (self.system_id, AUTOPILOT_COMPONENT):
                return
            fields = json.loads(message.fields_json)
            mode, is_critical = fields["custom_mode"], fields["system_status"] in _CRITICAL
            if mode != self._mode:
                self._mode, self._changed_s = mode, self._now_s()
                recent = self._changed_s - self._announced_s <= CHANGES_WITHIN_S
                announced = self._announced if recent else ModeSource.UNKNOWN
                begins = is_critical and not self._is_critical
                self._update(mode_by=ModeSource.FAILSAFE if begins else announced)
            self._is_critical = is_critical

    def _take_acknowledgement(self, message: Any) -> None:
        """Take the acknowledgement of a command; one of another station arrives where a hub copies all messages."""
        with suppress(ValueError, KeyError):
            fields = json.loads(message.fields_json)
            known = message.system_id == self.system_id and fields["result"] == _ACCEPTED
            if known and fields["command"] in _MODE_COMMANDS and fields["target_system"] not in (0, CORDON_ID):
                self._announce(ModeSource.STATION)

    def _announce(self, source: ModeSource) -> None:
        """Note who changes the mode: it explains a change that has just been received, or one that follows."""
        self._announced, self._announced_s = source, self._now_s()
        if self._announced_s - self._changed_s <= CHANGES_WITHIN_S:
            self._update(mode_by=source)

    def _take_gps(self, gps: Any) -> None:
        self._update(gps_dimensions=DIMENSIONS.get(gps.fix_type, 3), satellites=satellites(gps))

    def _take_remote_control(self, status: Any) -> None:
        if self._had_remote_control and not status.is_available:
            self._keep("lost", Connection.REMOTE_CONTROL, Connection.NONE, LOST_S)
        self._had_remote_control = bool(status.is_available)

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()

    def _keep(self, field: str, value: object, after: object, for_s: float) -> None:
        """Set a field of the status for a time."""
        if field in self._timers:
            self._timers[field].cancel()
        self._update(**{field: value})
        self._timers[field] = asyncio.get_running_loop().call_later(for_s, lambda: self._update(**{field: after}))


def satellites(gps: Any) -> int | None:
    """Return the number of satellites of MAVSDK's GPS report, None if it is unknown."""
    number = SATELLITES.known(gps.num_satellites)
    return None if number is None else int(number)


def estimator_facts(report: EstimatorReport) -> dict[str, Any]:
    """Return the status fields from an estimator's report.

    The highest test ratio counts, without the compass while another sensor is rejected.
    """
    faults = [*report.wrong, *([] if report.relative or report.absolute else ["no horizontal position"])]
    ranked = [(name != COMPASS and ratio > RATIO_MAX, ratio, name) for name, ratio in report.ratios.items()]
    _, ratio, name = max(ranked, default=(False, None, ""))
    return {
        "estimator_ratio": None if ratio is None else round(ratio, 1),
        "estimator_sensor": name,
        "estimator_fault": ", ".join(faults),
    }


def tilt_deg(roll_deg: float, pitch_deg: float) -> int:
    """Return the angle between a vehicle's axis and the vertical in whole degrees."""
    upright = cos(radians(roll_deg)) * cos(radians(pitch_deg))
    return round(degrees(acos(min(max(upright, -1.0), 1.0))))
