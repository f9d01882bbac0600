"""A vehicle of a log for the operator's page: what its agent knew at given times."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from msgspec import UNSET
from msgspec.structs import replace

from agents.flight_end import FlightEnd
from agents.inputs import AutopilotStatus
from agents.notes import RingCommanded
from agents.ports import VehicleStatus
from agents.shell.reporter import estimator_words
from agents.tactics import Tactic
from agents.team.messages import LINK_SILENT_S, AutopilotReport
from estimation.state import MOTION, Telemetry
from gcs.console.advice import Severity, event_severity
from gcs.console.rings import flown_ring
from gcs.console.team_state import SILENT_AFTER_S
from gcs.console.vehicle_view import LINK_CUT, SILENT, VehicleView, with_alert, with_outlook, with_unaccounted
from gcs.flightlog.reader import FlightLog, LogRecord
from gcs.flightlog.records import Decision, VehicleEnd, notes_of, outlook_of
from gcs.metrics.ending import UNACCOUNTED
from gcs.station.picture import TargetPicture

_ANGLE_DIGITS, _LENGTH_DIGITS = 4, 2
"""The resolution of the page: a centimetre, and a hundredth of a degree."""
_VARIANCE_DIGITS = 6

_AS_PLANNED = frozenset({FlightEnd.LANDED, FlightEnd.SIMULATED})


class Sampled(NamedTuple):
    """A vehicle at one time, without its surroundings, and its estimate of the target of its ring."""

    vehicle: VehicleView
    target: TargetPicture | None
    ring: int = 0


class _Tick(NamedTuple):
    """A vehicle's decision on a tick, and its newest own data."""

    decision: Any
    status: VehicleStatus | None
    altitude_m: float
    motion_s: float | None


class RecordedVehicle:
    """A vehicle's records, read once; `events` holds the events so far: time, text and severity.

    `rings` holds the rings that were commanded so far, and when.
    """

    def __init__(self, log: FlightLog, vehicle_id: int, rings: Sequence[str] = ()) -> None:
        """Take the names of the mission's rings, none if it has one."""
        self._names = rings
        self.vehicle_id = vehicle_id
        self.events: list[tuple[float, str, Severity]] = []
        self.rings: list[tuple[float, RingCommanded]] = []
        self._records = log.vehicles.get(vehicle_id, [])
        self._speed = log.run.speed
        self._end = log.end_of(vehicle_id)

    def sampled(self, times_s: Iterable[float]) -> Iterator[Sampled]:
        """Return the vehicle at times in order, each by its newest tick then; raises LogError for a damaged record."""
        ticks = self._ticks()
        tick: _Tick | None = None
        following = next(ticks, None)
        for time_s in times_s:
            while following is not None and following.decision.time_s <= time_s:
                tick, following = following, next(ticks, None)
            if tick is None:
                yield Sampled(VehicleView(self.vehicle_id), None)
            else:
                is_over = following is None and tick.decision.time_s < time_s
                yield Sampled(self._vehicle(tick, time_s, is_over=is_over), _target(tick, time_s), tick.decision.ring)

    def _ticks(self) -> Iterator[_Tick]:
        """Return the ticks, and collect the events between them."""
        status: VehicleStatus | None = None
        altitude_m, motion_s = 0.0, None
        end: VehicleEnd | None = None
        for record in self._records:
            if record.kind is Decision:
                decision = record.message()
                notes = notes_of(decision)
                self.events += [(each.time_s, each.text, event_severity(each)) for each in notes]
                self.rings += [(each.time_s, each.ring) for each in notes if each.ring is not None]
                yield _Tick(decision, status, altitude_m, motion_s)
            elif record.kind is AutopilotStatus:
                before, status = status, record.read(AutopilotStatus).status
                if before is not None and before.mode is not status.mode:
                    text = f"mode {before.mode.value} -> {status.mode.value}"
                    self.events.append((self._received_s(record), text, "information"))
            elif record.kind is Telemetry:
                altitude_m, motion_s = record.message().position_m[2], self._received_s(record)
            elif record.kind is VehicleEnd:
                known, end = end, record.read(VehicleEnd)
                is_new = known is None or (known.how, known.reason) != (end.how, end.reason)
                if not is_new or end.how in ("", FlightEnd.IN_FLIGHT.value):  # of an early version; or it flies again
                    continue
                level: Severity = "information" if FlightEnd(end.how) in _AS_PLANNED else "warning"
                text = f"flight ended: {end.reason}"
                if end.unaccounted is not None:
                    text, level = f"{UNACCOUNTED}: {end.reason}", "alarm"
                self.events.append((self._received_s(record), text, level))

    def _received_s(self, record: LogRecord) -> float:
        return record.time_ns * 1e-9 * self._speed

    def _vehicle(self, tick: _Tick, time_s: float, *, is_over: bool) -> VehicleView:
        """Return the vehicle; after its last tick it is unaccounted for unless its log says how its flight ended."""
        decision, end = tick.decision, self._end
        is_unaccounted = is_over and (end is None or end.unaccounted is not None)
        has_ended = is_over and not is_unaccounted
        age_s = (time_s - decision.time_s) / self._speed
        link_age_s = None if tick.motion_s is None else max(time_s - tick.motion_s, 0.0) / self._speed
        is_cut = link_age_s is not None and link_age_s > LINK_SILENT_S
        is_stale = age_s > SILENT_AFTER_S or is_cut
        lost = (LINK_CUT if is_cut else SILENT) if is_stale else ""
        view = VehicleView(
            self.vehicle_id,
            age_s=_rounded(age_s),
            is_stale=is_stale,
            has_ended=has_ended,
            tactic=decision.tactic,
            link_age_s=_rounded(link_age_s),
            ending=end.reason if has_ended and end is not None else "",
            ring=flown_ring(Tactic(decision.tactic), decision.ring, self._names) if self._names else UNSET,
        )
        view = _with_status(_with_motion(view, tick), tick.status)
        if is_unaccounted:
            last = None if end is None else end.unaccounted
            return with_unaccounted(view if last is None else replace(view, position_m=last.position_m))
        view = with_outlook(view, None if has_ended else outlook_of(decision), time_s)
        return with_alert(view, "" if has_ended else decision.alert or lost, is_lost=bool(lost))


def _with_motion(view: VehicleView, tick: _Tick) -> VehicleView:
    decision = tick.decision
    if not decision.HasField("own"):
        return view
    x, y, x_rate, y_rate = (round(each, _LENGTH_DIGITS) for each in list(decision.own.mean)[MOTION])
    setpoint = decision.setpoint if decision.HasField("setpoint") else None
    on_ring = decision.HasField("place") and decision.HasField("polar")
    lead_rad = decision.place.lead_rad if on_ring and decision.place.HasField("lead_rad") else None
    return replace(
        view,
        position_m=(x, y, round(tick.altitude_m, _LENGTH_DIGITS)),
        velocity_m_s=(x_rate, y_rate),
        setpoint_m=None if setpoint is None else tuple(_rounded(each) for each in setpoint.position_m[:2]),
        yaw_rad=None if setpoint is None else round(setpoint.yaw_rad, _ANGLE_DIGITS),
        radius_m=_rounded(decision.polar.radius_m) if on_ring else None,
        angular_rate_rad_s=round(decision.polar.angular_rate_rad_s, _ANGLE_DIGITS) if on_ring else None,
        lead_rad=None if lead_rad is None else round(lead_rad, _ANGLE_DIGITS),
    )


def _with_status(view: VehicleView, status: VehicleStatus | None) -> VehicleView:
    if status is None:
        return view
    autopilot = AutopilotReport(*(getattr(status, each) for each in AutopilotReport.__struct_fields__))
    return replace(view, mode=status.mode.value, autopilot=autopilot, estimator=estimator_words(status))


def _target(tick: _Tick, time_s: float) -> TargetPicture | None:
    if not tick.decision.HasField("target"):
        return None
    target = tick.decision.target
    x, y, x_rate, y_rate = (round(each, _LENGTH_DIGITS) for each in target.mean)
    covariance = list(target.covariance)
    xx, xy, yy = (round(covariance[at], _VARIANCE_DIGITS) for at in (0, 1, 5))
    return TargetPicture((x, y), (x_rate, y_rate), (xx, xy, yy), round(max(time_s - target.sighted_s, 0.0), 2))


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, _LENGTH_DIGITS)
