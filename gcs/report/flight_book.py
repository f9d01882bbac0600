"""A flight book: who flew what, when, where and for how long, from the logs of a folder."""

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path

from pydantic import ValidationError

from agents.flight_end import FlightEnd
from agents.inputs import AutopilotStatus, Start
from agents.team.text import printable
from estimation.input_file import toml_content
from gcs.flightlog.audit import AuditEntry
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, read_kinds, read_log
from gcs.flightlog.records import Run, RunEnd, Vehicle, VehicleEnd
from gcs.metrics.catalogue import VerdictState
from gcs.metrics.ending import TeamEnding, VehicleEnding
from gcs.metrics.metrics import evaluated
from gcs.metrics.result import verdict_states
from gcs.mission.mission import FrameSection
from gcs.report.evidence.reading import read_flight
from gcs.report.maps.mapped_flight import timestamp

KINDS = (Run, RunEnd, AuditEntry, Start, Vehicle, VehicleEnd, AutopilotStatus)
"""The records from which a book is kept."""
CSV_COLUMNS = (
    *("began", "mission", "source", "latitude_deg", "longitude_deg", "crew"),
    *("vehicle", "kind", "airborne_min", "ended", "verdicts", "damaged", "log"),
)
_UNIX_MAX_S = 4e9
"""In the year 2096."""
_SECONDS, _MINUTES = 1, 2
"""Digits behind the point."""
Progress = Callable[[float], None]
"""Called with the share of the logs that has been read."""


@dataclass(frozen=True, slots=True)
class BookedVehicle:
    """A vehicle of a flight: its id, its kind (empty: unknown), and its time in the air.

    The time is on the flight's clock, up to the log's end if it had not landed; None where no autopilot reported.
    """

    id: int
    kind: str
    airborne_s: float | None


@dataclass(frozen=True, slots=True)
class BookedFlight:
    """A flight, or the part of one that a log is of. `began_s` is Unix time.

    The place is the mission's origin, None in a local frame. `crew` are who began it and who sent commands. `ended` is
    None if no vehicle took off. `verdicts` is None where they were not asked for, or there is nothing to judge.
    `copy_of` names the log in the book of which this is a copy.
    """

    log: str
    began_s: float
    mission: str
    source: str
    place_deg: tuple[float, float] | None
    crew: tuple[str, ...]
    vehicles: tuple[BookedVehicle, ...]
    ended: TeamEnding | None
    faults: tuple[str, ...] = ()
    is_damaged: bool = False
    verdicts: Mapping[str, VerdictState] | None = None
    copy_of: str = ""

    @property
    def airborne_s(self) -> float | None:
        """The time in the air of all vehicles together; None where it is not known of any."""
        known = [each.airborne_s for each in self.vehicles if each.airborne_s is not None]
        return sum(known) if known else None

    @property
    def verdict(self) -> str:
        """The verdicts in a few words; empty without any."""
        states = {} if self.verdicts is None else self.verdicts
        failed = [name for name, state in states.items() if state is VerdictState.FAILS]
        unjudged = [name for name, state in states.items() if state is VerdictState.NOT_JUDGED]
        parts = [f"{', '.join(failed)} fail{'s' * (len(failed) == 1)}"] * bool(failed)
        parts += [f"{', '.join(unjudged)} not judged"] * bool(unjudged)
        return "; ".join(parts) or "pass" * any(state is VerdictState.PASSES for state in states.values())


@dataclass(frozen=True, slots=True)
class UnreadLog:
    """A log that cannot be read, and why."""

    log: str
    fault: str


@dataclass(frozen=True, slots=True)
class FlightBook:
    """The flights of a folder in the order in which they began, and the logs that cannot be read."""

    flights: tuple[BookedFlight, ...]
    unread: tuple[UnreadLog, ...]

    @property
    def is_damaged(self) -> bool:
        """Whether a log is damaged, or cannot be read."""
        return bool(self.unread) or any(each.is_damaged for each in self.flights)

    @property
    def airborne_s(self) -> Mapping[str, float]:
        """The time in the air of all vehicles together, without copies, by the source of the flights."""
        total_s: dict[str, float] = {}
        for each in self.flights:
            if not each.copy_of and each.airborne_s is not None:
                total_s[each.source] = total_s.get(each.source, 0.0) + each.airborne_s
        return total_s

    def to_dict(self) -> dict[str, object]:
        """Return it as plain data, for JSON."""
        return {
            "flights": [_flight_dict(each) for each in self.flights],
            "unread": [{"log": each.log, "fault": each.fault} for each in self.unread],
            "airborne_s": {source: round(total_s, _SECONDS) for source, total_s in self.airborne_s.items()},
        }

    def to_csv(self) -> str:
        """Return it as a table with a row for each vehicle of a flight, for spreadsheets; copies are left out."""
        text = StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(CSV_COLUMNS)
        for each in self.flights:
            if not each.copy_of:
                table.writerows(_csv_row(each, vehicle) for vehicle in each.vehicles)
        return text.getvalue()


def read_book(logs: Sequence[Path], progress: Progress, *, with_verdicts: bool = False) -> FlightBook:
    """Read logs, quickly by their indices; with verdicts each is read as a whole and judged, which takes seconds."""
    flights, unread = list[BookedFlight](), list[UnreadLog]()
    for done, path in enumerate(logs):
        progress(done / len(logs))
        try:
            flights.append(_judged(path) if with_verdicts else booked(read_kinds(path, KINDS)))
        except LogError as error:
            unread.append(UnreadLog(path.name, error.faults[0].removeprefix(f"{path}: ")))
    flights.sort(key=lambda each: (each.began_s, each.is_damaged, each.log))  # a damaged log is the copy
    return FlightBook(tuple(_with_copies(flights)), tuple(unread))


def date_text(unix_s: float) -> str:
    """Return a time in UTC, to the minute."""
    return f"{datetime.fromtimestamp(unix_s, UTC):%Y-%m-%d %H:%M}"


def booked(log: FlightLog) -> BookedFlight:
    """Return the entry of a log, of which the records of `KINDS` are read; raises LogError for a damaged record."""
    run = log.run
    if not 0.0 <= run.began_s < _UNIX_MAX_S:
        raise LogError([f"{log.path}: it began at {run.began_s:g} s of Unix time, which is no date"])
    vehicles = tuple(_vehicle(log, each) for each in run.vehicles)
    return BookedFlight(
        log.path.name,
        run.began_s,
        printable(run.mission),
        run.source,
        _place_deg(log),
        _crew(log),
        vehicles,
        TeamEnding.of(list(_endings(log, vehicles))),
        tuple(log.faults),
        log.is_damaged,
    )


def _judged(path: Path) -> BookedFlight:
    """Return the entry of a log with the verdicts, None for a mission that did not start."""
    log = read_log(path)
    entry = booked(log)
    try:
        flight = read_flight([log])
    except LogError:
        return entry
    states = verdict_states(evaluated(flight.mission, flight.evidence.record))
    return replace(entry, verdicts={name: each for name, each in states.items() if each is not VerdictState.NOT_ASKED})


def _with_copies(flights: Sequence[BookedFlight]) -> Iterator[BookedFlight]:
    """Return the flights; a log of the same run and vehicles as one before, such as a recovered one, is its copy."""
    seen: dict[object, str] = {}
    for each in flights:
        first = seen.setdefault((each.began_s, each.mission, tuple(vehicle.id for vehicle in each.vehicles)), each.log)
        yield each if first == each.log else replace(each, copy_of=first)


def _vehicle(log: FlightLog, vehicle_id: int) -> BookedVehicle:
    kinds = [each.kind for each in log.of_kind(vehicle_id, Vehicle)]
    return BookedVehicle(vehicle_id, kinds[-1] if kinds else "", _airborne_s(log, vehicle_id))


def _airborne_s(log: FlightLog, vehicle_id: int) -> float | None:
    """Return how long a vehicle was in the air; None without a status of its autopilot."""
    records = log.vehicles.get(vehicle_id, [])
    total_ns, since_ns, is_reported = 0, None, False
    for each in records:
        if each.kind is AutopilotStatus:
            is_reported, in_air = True, bool(each.message().status.in_air)
            if in_air and since_ns is None:
                since_ns = each.time_ns
            elif not in_air and since_ns is not None:
                total_ns, since_ns = total_ns + each.time_ns - since_ns, None
    if since_ns is not None:
        total_ns += records[-1].time_ns - since_ns
    return total_ns / 1e9 * log.run.speed if is_reported else None


def _place_deg(log: FlightLog) -> tuple[float, float] | None:
    """Return latitude and longitude of the mission's origin, None in a local frame; raises LogError."""
    try:
        frame = FrameSection.model_validate(toml_content(log.run.mission_text).get("frame", {}))
    except (ValueError, ValidationError) as error:
        raise LogError([f"{log.path}: its mission cannot be read: {error}"]) from error
    if frame.latitude_deg is None or frame.longitude_deg is None:
        return None
    return frame.latitude_deg, frame.longitude_deg


def _crew(log: FlightLog) -> tuple[str, ...]:
    """Return who began the flight, and then who sent commands, by the audit log."""
    commanded = [each.read(AuditEntry) for each in log.run_records if each.kind is AuditEntry]
    names = [log.run.operator, *(each.operator for each in commanded if each.event == "received")]
    return tuple(dict.fromkeys(printable(name) for name in names if name))


def _endings(log: FlightLog, vehicles: Sequence[BookedVehicle]) -> Iterator[VehicleEnding]:
    """Return how the vehicles ended that took off or whose end is recorded."""
    for vehicle in vehicles:
        records = log.vehicles.get(vehicle.id, ())
        if (end := log.end_of(vehicle.id)) is not None:
            yield VehicleEnding(vehicle.id, FlightEnd(end.how), end.reason)
        elif vehicle.airborne_s or any(each.kind is Start for each in records):
            yield VehicleEnding(vehicle.id, FlightEnd.IN_FLIGHT, "the log ends in flight")


def _flight_dict(flight: BookedFlight) -> dict[str, object]:
    latitude_deg, longitude_deg = flight.place_deg or (None, None)
    ended, verdicts = flight.ended, flight.verdicts
    held = {VerdictState.PASSES: True, VerdictState.FAILS: False}
    return {
        "log": flight.log,
        "began": timestamp(flight.began_s),
        "mission": flight.mission,
        "source": flight.source,
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "crew": list(flight.crew),
        "vehicles": [
            {"id": each.id, "kind": each.kind or None, "airborne_s": _rounded(each.airborne_s)}
            for each in flight.vehicles
        ],
        "airborne_s": _rounded(flight.airborne_s),
        "ended": None if ended is None else {"how": ended.how.value, "reason": ended.reason},
        "verdicts": None if verdicts is None else {name: held.get(state) for name, state in verdicts.items()},
        "faults": list(flight.faults),
        "damaged": flight.is_damaged,
        "copy_of": flight.copy_of or None,
    }


def _csv_row(flight: BookedFlight, vehicle: BookedVehicle) -> tuple[object, ...]:
    minutes = "" if vehicle.airborne_s is None else round(vehicle.airborne_s / 60.0, _MINUTES)
    place: tuple[object, object] = flight.place_deg or ("", "")
    ended = "" if flight.ended is None else flight.ended.how.value
    of_flight = timestamp(flight.began_s), flight.mission, flight.source, *place, " ".join(flight.crew)
    return (*of_flight, vehicle.id, vehicle.kind, minutes, ended, flight.verdict, flight.is_damaged, flight.log)


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, _SECONDS)
