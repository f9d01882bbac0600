"""Reading a log that cordon wrote, closed or not, as far as it is undamaged."""

import os
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from mcap.records import Channel, Schema

from agents.flight_end import FlightEnd
from agents.inputs import Message as BusInput
from agents.team.codec import decode
from agents.team.messages import BusMessage
from estimation.input_file import open_plain
from estimation.state import Vector
from gcs.flightlog.container import (
    Container,
    DamageError,
    EncodedMessage,
    Entry,
    LogError,
    NoContainerError,
    unpadded_bytes,
)
from gcs.flightlog.records import (
    FORMAT,
    RUN_TOPICS,
    VEHICLE_TOPICS,
    Carried,
    Run,
    RunEnd,
    Taken,
    TargetTruth,
    VehicleEnd,
)
from gcs.flightlog.schema import PACKAGE, Decoder


class RecordCounter:
    """The counts of a log's records. Records of vehicles and bus messages are numbered, so gaps show missing ones."""

    def __init__(self) -> None:
        self.records: defaultdict[int, int] = defaultdict(int)
        self.damaged = 0
        self._seen: dict[int, tuple[int, int]] = {}
        self._missing_ranges: dict[int, _MissingRange] = {}
        self._first_ns: int | None = None
        self._last_ns = 0

    def note(self, vehicle_id: int, time_ns: int, payload: bytes) -> bool:
        """Count an encoded record; vehicle 0 is the run as a whole. Return whether it is undamaged."""
        number = _number(payload)
        if vehicle_id and not number:
            self.damaged += 1
            return False
        if number:
            last, last_ns = self._seen.get(vehicle_id, (0, time_ns))
            if number != last + 1:
                self._miss(vehicle_id, number - last - 1, last_ns, time_ns)
            self._seen[vehicle_id] = number, time_ns
        if self._first_ns is None:
            self._first_ns = time_ns
        self._last_ns = max(self._last_ns, time_ns)
        self.records[vehicle_id] += 1
        return True

    @property
    def total(self) -> int:
        """The number of records."""
        return sum(self.records.values())

    @property
    def seconds(self) -> float:
        """The duration on the log's clock [s]."""
        return (self._last_ns - (self._first_ns or 0)) / 1e9

    @property
    def faults(self) -> list[str]:
        """The missing records, in a line per vehicle; times count from the log's first record."""
        damaged = [f"{self.damaged} records are damaged and left out"] if self.damaged else []
        return [
            *damaged,
            *(
                self._missing(vehicle_id, missing_range)
                for vehicle_id, missing_range in sorted(self._missing_ranges.items())
            ),
        ]

    def _miss(self, vehicle_id: int, count: int, begin_ns: int, end_ns: int) -> None:
        missing_range = self._missing_ranges.setdefault(vehicle_id, _MissingRange(begin_ns, end_ns))
        missing_range.places += 1
        missing_range.end_ns = max(missing_range.end_ns, end_ns)
        if count > 0:
            missing_range.missing += count
        else:
            missing_range.disordered += 1

    def _missing(self, vehicle_id: int, missing_range: "_MissingRange") -> str:
        first_ns = self._first_ns or 0
        begin_s, end_s = max(missing_range.begin_ns - first_ns, 0) / 1e9, max(missing_range.end_ns - first_ns, 0) / 1e9
        order = f", {missing_range.disordered} are out of order" if missing_range.disordered else ""
        places = f" in {missing_range.places} places" if missing_range.places > 1 else ""
        when = f"between {begin_s:.1f} and {end_s:.1f} s of the log"
        whose = f"vehicle {vehicle_id}" if vehicle_id else "messages of the bus"
        return f"{whose}: {missing_range.missing} records are missing{places}{order}, {when}"


class _MissingRange:
    """The number of a vehicle's missing records, and the times between which they are missing."""

    def __init__(self, begin_ns: int, end_ns: int) -> None:
        self.begin_ns = begin_ns
        self.end_ns = end_ns
        self.missing = 0
        self.disordered = 0
        self.places = 0


def _number(payload: bytes) -> int:
    """Return the number of a record, field 1 of its Protobuf encoding, 0 if none: quicker than decoding the record."""
    if payload[:1] != b"\x08":
        return 0
    value = shift = 0
    for byte in payload[1:11]:
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value
        shift += 7
    return 0


KINDS: Mapping[str, type[Any]] = {name: kind for kind, name in VEHICLE_TOPICS.items()}
RUN_KINDS: Mapping[str, type[Any]] = {name: kind for kind, name in RUN_TOPICS.items()}
RecordT = TypeVar("RecordT")
_VIEWERS = "for viewers"


class LogRecord(NamedTuple):
    """One record, still encoded: its kind, its time stamp [ns], and the bytes with what decodes them."""

    kind: type[Any]
    time_ns: int
    payload: bytes
    decoder: Decoder

    def plain(self) -> dict[str, Any]:
        """Return its fields, and its `number`, as plain data; raises LogError when it is damaged."""
        try:
            return self.decoder.decode(self.payload)
        except ValueError as error:
            raise self._damage(error) from error

    def message(self) -> Any:
        """Return it as a Protobuf message; raises LogError when it is damaged."""
        try:
            return self.decoder.message(self.payload)
        except ValueError as error:
            raise self._damage(error) from error

    def read(self, kind: type[RecordT]) -> RecordT:
        """Return it as its type; raises LogError when it is damaged, or of an incompatible version."""
        try:
            return msgspec.convert(self.plain(), kind)
        except msgspec.ValidationError as error:
            raise self._damage(error) from error

    def _damage(self, error: Exception) -> LogError:
        return LogError([f"{self.decoder.where}: the record at {self.time_ns / 1e9:.3f} s cannot be read: {error}"])


@dataclass(frozen=True)
class FlightLog:
    """The content of a file: the records of the run, and each vehicle's in the order in which they were written.

    `faults` lists what is wrong: a missing end, damaged records. It `is_damaged` if records between others are lost.
    """

    path: Path
    run_records: list[LogRecord] = field(default_factory=list)
    vehicles: dict[int, list[LogRecord]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    is_damaged: bool = False

    def add(self, vehicle_id: int, record: LogRecord) -> None:
        """Add a vehicle's record, or one of the run, vehicle 0."""
        records = self.vehicles.setdefault(vehicle_id, []) if vehicle_id else self.run_records
        records.append(record)

    @property
    def recovered(self) -> str:
        """How much of it was read, as text."""
        records = [self.run_records, *self.vehicles.values()]
        stamps_ns = [each.time_ns for some in records for each in (some[0], some[-1]) if some]
        seconds = (max(stamps_ns) - min(stamps_ns)) / 1e9 if stamps_ns else 0.0
        return f"{sum(map(len, records))} records of {seconds:.1f} s were read"

    @cached_property
    def run(self) -> Run:
        """The newest record of the run; raises LogError if there is none."""
        runs = [each for each in self.run_records if each.kind is Run]
        if not runs:
            reason = "it holds no record of the run (mission and vehicles): it ends too early, or that part is damaged"
            raise LogError([f"{self.path}: {each}" for each in (reason, *self.faults)])
        return runs[-1].read(Run)

    @cached_property
    def end(self) -> RunEnd | None:
        """How the run ended, None if its process ended before it was recorded."""
        return next((each.read(RunEnd) for each in reversed(self.run_records) if each.kind is RunEnd), None)

    @cached_property
    def carried(self) -> dict[int, BusMessage]:
        """The messages that cores of its process received, by number, without those that cannot be decoded."""
        carried = (each.message() for each in self.run_records if each.kind is Carried)
        decoded = ((each.number, _decoded(each.payload)) for each in carried)
        return {place: message for place, message in decoded if message is not None}

    @cached_property
    def target_path(self) -> tuple[Vector, Vector] | None:
        """The times (K,) and true positions (K, 2) of a target that reacts, None where it follows the mission."""
        known = [each.read(TargetTruth) for each in self.run_records if each.kind is TargetTruth]
        if not known:
            return None
        return np.array([each.time_s for each in known]), np.array([each.position_m for each in known])

    def messages(self, record: LogRecord) -> list[BusInput]:
        """Return the inputs from the bus in a record; raises LogError where a message is lost."""
        taken = record.read(Taken)
        lost = [place for place in taken.places if place not in self.carried]
        if lost:
            raise LogError([f"{self.path}: message {lost[0]} of the bus is missing or damaged"])
        return [BusInput(now_s, self.carried[at]) for at, now_s in zip(taken.places, taken.times_s, strict=True)]

    def of_kind(self, vehicle_id: int, kind: type[RecordT]) -> Iterator[RecordT]:
        """Return a vehicle's records of one kind, in order."""
        return (each.read(kind) for each in self.vehicles.get(vehicle_id, ()) if each.kind is kind)

    def end_of(self, vehicle_id: int) -> VehicleEnd | None:
        """Return how a vehicle's flight ended, None if the log ends before that."""
        records = reversed(self.vehicles.get(vehicle_id, ()))
        end = next((each.read(VehicleEnd) for each in records if each.kind is VehicleEnd), None)
        return None if end is None or end.how == FlightEnd.IN_FLIGHT.value else end


def read_log(path: Path) -> FlightLog:
    """Read a log as far as it is undamaged; raises LogError when it is not a log of cordon.

    Records with a valid checksum are decoded only when they are read, which is quick; a record that is damaged
    nevertheless raises LogError then. A log of a newer version is decoded at once, to leave out the records that this
    version does not support.
    """
    log, counter = FlightLog(path), RecordCounter()
    with open_container(path) as container:
        topics = _Topics(path)
        for entry in container.entries():
            if (taken := topics.record(entry)) is not None:
                vehicle_id, record = taken
                if counter.note(vehicle_id, record.time_ns, record.payload):
                    log.add(vehicle_id, record)
    if not counter.total:
        raise LogError([f"{path}: it holds no cordon record", *(f"{path}: {fault}" for fault in container.faults)])
    log.faults.extend(faults_of(container, counter) + topics.faults)
    return _supported(replace(log, is_damaged=container.is_damaged or bool(counter.faults)))


def read_kinds(path: Path, kinds: Collection[type[Any]]) -> FlightLog:
    """Read only the records of some kinds, among them `Run`; raises LogError when it is not a log of cordon.

    Of a closed log only the chunks that hold such records are read, and only these are checked. One that is not closed,
    or whose index or chunks are damaged, is read as a whole.
    """
    log, topics = FlightLog(path), _Topics(path)
    try:
        with open_container(path) as container:
            for entry in container.indexed(lambda topic: (known := topic_of(topic)) is not None and known[0] in kinds):
                if (taken := topics.record(entry)) is not None:
                    log.add(*taken)
    except DamageError:
        return read_log(path)
    log.faults.extend(topics.faults)
    return _supported(log) if log.run_records else read_log(path)


def _supported(log: FlightLog) -> FlightLog:
    """Return a log of this version's format, one of a newer as far as it is supported; raises LogError for an older."""
    path = log.path
    if log.run.format < FORMAT:
        raise LogError([f"{path}: it has format {log.run.format}, which cordon 0.1 reads; this version reads {FORMAT}"])
    if log.run.format > FORMAT:
        newer = f"format {log.run.format}; this version reads up to {FORMAT}"
        log.faults.append(f"it was written by a newer version of cordon ({newer})")
        _leave_out_unknown(log)
    return log


def _decoded(payload: bytes) -> BusMessage | None:
    try:
        return decode(payload)
    except ValueError:
        return None


@contextmanager
def open_container(path: Path) -> Iterator[Container]:
    """Open a log; raises LogError when that fails, or when it is not an MCAP file."""
    try:
        with open_plain(path) as stream:
            yield Container(stream, unpadded_bytes(stream, os.fstat(stream.fileno()).st_size))
    except OSError as error:
        raise LogError([f"{path}: {error.strerror or error}"]) from error
    except NoContainerError as error:
        raise LogError([f"{path}: {error}"]) from error


def faults_of(container: Container, counter: RecordCounter) -> list[str]:
    """Return the faults of a log that has been read to its end."""
    unclosed = f"it was never closed: it ends {counter.seconds:.1f} s after its first record"
    return [*([] if container.is_closed else [unclosed]), *container.faults, *counter.faults]


def _leave_out_unknown(log: FlightLog) -> None:
    """Leave out the records that this version cannot read, and report their number by kind."""
    unknown: Counter[str] = Counter()
    for records in (log.run_records, *log.vehicles.values()):
        readable = [each for each in records if _is_readable(each)]
        unknown.update(
            Counter(each.kind.__name__ for each in records) - Counter(each.kind.__name__ for each in readable)
        )
        records[:] = readable
    for kind, count in sorted(unknown.items()):
        log.faults.append(f"{count} records of kind {kind} have content that this version does not support")


def _is_readable(record: LogRecord) -> bool:
    try:
        record.read(record.kind)
    except LogError:
        return False
    return True


class _Topics:
    """The channels of a file, as far as this version supports them."""

    def __init__(self, path: Path) -> None:
        self.known: dict[int, tuple[type[Any], int, Decoder]] = {}
        self._path = path
        self._schemas: dict[int, Schema] = {}
        self._others: dict[int, str] = {}
        self._unread: Counter[str] = Counter()

    def record(self, entry: Entry) -> tuple[int, LogRecord] | None:
        """Return the vehicle (0: the run) and the record of a message on a known channel, and take other entries."""
        if type(entry) is not EncodedMessage:
            self._take(entry)
        elif (topic := self.known.get(entry.channel_id)) is not None:
            kind, vehicle_id, decoder = topic
            return vehicle_id, LogRecord(kind, entry.time_ns, entry.payload, decoder)
        else:
            self._unread[self._others.get(entry.channel_id, "the description of their channel is lost")] += 1
        return None

    def _take(self, entry: Entry) -> None:
        """Add a schema or a channel; the first with an id counts."""
        match entry:
            case Schema():
                self._schemas.setdefault(entry.id, entry)
            case Channel() if entry.id not in self.known and entry.id not in self._others:
                schema = self._schemas.get(entry.schema_id)
                if schema is None or schema.name.startswith(f"{PACKAGE}."):
                    self._add_channel(entry, schema)
                else:
                    self._others[entry.id] = _VIEWERS

    def _add_channel(self, channel: Channel, schema: Schema | None) -> None:
        topic = topic_of(channel.topic)
        if topic is None:
            self._others[channel.id] = f"{channel.topic} is unknown to this version"
        elif schema is None:
            self._others[channel.id] = f"{channel.topic}: its schema is lost"
        else:
            kind, vehicle_id = topic
            try:
                decoder = Decoder(schema.name, schema.data, f"{self._path}: {channel.topic}")
                decoder.require(kind)
            except ValueError as error:
                self._others[channel.id] = f"{channel.topic}: {error}"
            else:
                self.known[channel.id] = kind, vehicle_id, decoder

    @property
    def faults(self) -> list[str]:
        """The records that are present and not read, other than those for viewers."""
        return [
            f"{count} records are not read: {why}" for why, count in sorted(self._unread.items()) if why != _VIEWERS
        ]


def topic_of(topic: str) -> tuple[type[Any], int] | None:
    """Return the kind of record on a topic, and its vehicle (0: the run); None for what only viewers need."""
    match topic.split("/"):
        case ["", "vehicle", number, name] if number.isdecimal() and name in KINDS:
            return KINDS[name], int(number)
        case ["", name] if name in RUN_KINDS:
            return RUN_KINDS[name], 0
    return None
