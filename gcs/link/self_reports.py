"""An autopilot's reports on its estimator, GPS and connections, as fields of `VehicleStatus` and as a report."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import acos, cos, degrees, hypot, inf, isfinite, radians
from typing import Any

from mavsdk.plugins.mavlink_direct import MavlinkDirect
from mavsdk.plugins.telemetry import BatteryFunction, FixType

from agents.ports import Connection, FlightMode, GpsThreat, ModeSource, VehicleStatus
from agents.safety.failsafe import COMPASS, FIX_DIMENSIONS, RATIO_MAX, STATUS_STALE_S
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
_MODE_COMMANDS = (20, 21, 22, 176)
"""MAV_CMD_NAV_RETURN_TO_LAUNCH, _NAV_LAND, _NAV_TAKEOFF, _DO_SET_MODE."""
_ACCEPTED = 0
_THREATS = {
    GpsThreat.SPOOFED: re.compile(r"\b(gnss|gps)\b.*\bspoof", re.IGNORECASE),
    GpsThreat.JAMMED: re.compile(r"\b(gnss|gps)\b.*\bjam", re.IGNORECASE),
}
BATTERY, GPS, ESTIMATOR = REPEATED = "battery", "GPS", "estimator"
"""What an autopilot reports repeatedly, beside its motion."""
_UNKNOWN = VehicleStatus()
_CHARGE_STATES = {2: "low", 3: "critical", 4: "empty", 5: "failed", 6: "unhealthy"}
"""MAV_BATTERY_CHARGE_STATE_LOW, _CRITICAL, _EMERGENCY, _FAILED, _UNHEALTHY."""
NOT_FOR_FLIGHT = (BatteryFunction.AVIONICS, BatteryFunction.PAYLOAD)
"""What a battery is for that the vehicle does not fly with; their values are MAVLink's."""
BATTERY_FAILSAFE = 0.15
"""The share of the battery at which PX4's failsafe acts (BAT_LOW_THR)."""
_FENCE = re.compile("fence", re.IGNORECASE)


def is_explained(status: VehicleStatus, texts: Sequence[str]) -> bool:
    """Return whether a report or a text of an autopilot explains why its mode changed, other than by lost setpoints.

    A return may be that of any failsafe. Without a GPS fix the position ends before the estimator reports it.
    """
    return (
        status.mode_by is not ModeSource.FAILSAFE
        or status.lost is not Connection.NONE
        or status.mode is FlightMode.RETURN
        or (status.gps_dimensions is not None and status.gps_dimensions < FIX_DIMENSIONS)
        or (status.battery is not None and status.battery <= BATTERY_FAILSAFE)
        or bool(status.estimator_fault or status.battery_fault or _FENCE.search(" ".join(texts)))
    )


class SelfReports:
    """Subscribes to a system's reports, and passes changes of the status to `update`.

    Reports count for a time of `now_s`, which `expire` has to be called for repeatedly.
    """

    def __init__(self, system: Any, update: Callable[..., None], now_s: Callable[[], float]) -> None:
        self.direct: Any = MavlinkDirect(system)
        self.autopilot = autopilot_of(system.autopilot_type().name)
        self.system_id = int(system.get_system_id())
        self._update = update
        self._now_s = now_s
        self._had_remote_control = False
        self._kept: dict[str, tuple[float, tuple[str, ...]]] = {}
        self._stale: set[str] = set()
        self._battery_faults: dict[int, str] = {}
        self._changed_s = self._announced_s = -inf
        self._announced = ModeSource.UNKNOWN

    def subscribe(self, telemetry: Any, posting: Callable[[Callable[[Any], None]], Any], *, gps: bool) -> None:
        """Subscribe, to the GPS only if the mission needs it.

        `posting` wraps a function so that MAVSDK's thread may call it and it runs on the event loop.
        """
        self.direct.subscribe_message(self.autopilot.estimator.message, posting(self._take_estimator))
        self.direct.subscribe_message(self.autopilot.estimator.wind, posting(self._take_wind))
        self.direct.subscribe_message("BATTERY_STATUS", posting(self._take_charge_state))
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
                self._keep("threat", THREAT_S, gps_threat=threat)
        for connection, words in _CONNECTIONS.items():
            if words.search(text) and _LOST.search(text) and not _OVER.search(text):
                self.note_lost(connection)

    def note_lost(self, connection: Connection) -> None:
        """Take the connection whose loss explains a failsafe."""
        self._keep("lost", LOST_S, lost=connection)

    def take_repeated(self, source: str, **values: object) -> None:
        """Take what is reported repeatedly by a `source`, which the status names as stale once it stops."""
        if source in self._stale:
            self._stale.remove(source)
            self._update(stale=self._stale_text)
        self._keep(source, STATUS_STALE_S, **values)

    def expire(self) -> None:
        """Set what was reported too long ago to unknown."""
        for source, (until_s, fields) in list(self._kept.items()):
            if self._now_s() > until_s:
                del self._kept[source]
                self._update(**{field: getattr(_UNKNOWN, field) for field in fields})
                if source in REPEATED:
                    self._stale.add(source)
                    self._update(stale=self._stale_text)

    def mode_changed(self) -> ModeSource:
        """Take a change of mode that has just been received, and return who announced it."""
        self._changed_s = self._now_s()
        return self._announced if self._changed_s - self._announced_s <= CHANGES_WITHIN_S else ModeSource.UNKNOWN

    def close(self) -> None:
        """Unsubscribe; blocks until running callbacks have returned."""
        self.direct.destroy()

    def _take_estimator(self, message: Any) -> None:
        with suppress(ValueError):  # malformed bytes are dropped here
            report = estimator_report(self.autopilot.estimator, json.loads(message.fields_json))
            if report is not None and message.system_id == self.system_id:
                facts = estimator_facts(report)
                self._update(estimator_fault=facts.pop("estimator_fault"))  # it is not over because reports end
                self.take_repeated(ESTIMATOR, **facts)

    def _take_wind(self, message: Any) -> None:
        with suppress(ValueError):
            speed_m_s = wind_m_s(self.autopilot.estimator, json.loads(message.fields_json))
            if speed_m_s is not None and message.system_id == self.system_id:
                self._keep("wind", WIND_S, wind_m_s=round(speed_m_s, 1))

    def _take_charge_state(self, message: Any) -> None:
        """Take what an autopilot says of a battery: it compares the voltage with thresholds, cordon only the charge."""
        with suppress(ValueError, KeyError):
            fields = json.loads(message.fields_json)
            if (
                message.system_id == self.system_id
                and BatteryFunction(fields["battery_function"]) not in NOT_FOR_FLIGHT
            ):
                self._battery_faults[fields["id"]] = _CHARGE_STATES.get(fields["charge_state"], "")
                found = [f"battery {number} {fault}" for number, fault in sorted(self._battery_faults.items()) if fault]
                self._keep("charge state", STATUS_STALE_S, battery_fault=", ".join(found))

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
        self.take_repeated(GPS, gps_dimensions=DIMENSIONS.get(gps.fix_type, 3), satellites=satellites(gps))

    def _take_remote_control(self, status: Any) -> None:
        if self._had_remote_control and not status.is_available:
            self.note_lost(Connection.REMOTE_CONTROL)
        self._had_remote_control = bool(status.is_available)

    def _keep(self, source: str, for_s: float, **values: object) -> None:
        """Set fields of the status for a time."""
        self._kept[source] = self._now_s() + for_s, tuple(values)
        self._update(**values)

    @property
    def _stale_text(self) -> str:
        return ", ".join(sorted(self._stale))


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
