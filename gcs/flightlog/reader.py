"""Reading a log that cordon wrote: closed or not, as far as it is whole."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader

from gcs.exits import InputError
from gcs.flightlog.records import FORMAT, RUN_TOPICS, VEHICLE_TOPICS, Run, RunEnd
from gcs.flightlog.schema import Decoder

RECORD_MAX_BYTES = 256_000_000
"""No record of a log is larger: a length beyond it is a damaged one's."""

KINDS: Mapping[str, type[Any]] = {name: kind for kind, name in VEHICLE_TOPICS.items()}
RUN_KINDS: Mapping[str, type[Any]] = {name: kind for kind, name in RUN_TOPICS.items()}
RecordT = TypeVar("RecordT")


class LogError(InputError):
    """A log cannot be read, or not used for what it was meant to be: the file, and why."""


class LogRecord(NamedTuple):
    """One record, still encoded: its kind, its time stamp [ns], and the bytes with what decodes them."""

    kind: type[Any]
    time_ns: int
    payload: bytes
    decoder: Decoder

    def plain(self) -> dict[str, Any]:
        """Return its fields, and its `number`, as plain data; raises ValueError when it is damaged."""
        return self.decoder.decode(self.payload)

    def message(self) -> Any:
        """Return it as Protobuf sees it; raises ValueError when it is damaged."""
        return self.decoder.message(self.payload)

    def read(self, kind: type[RecordT]) -> RecordT:
        """Return it as the type that it is of; raises ValueError when it is damaged, or of another version's making."""
        return msgspec.convert(self.plain(), kind)


@dataclass(frozen=True)
class FlightLog:
    """What a file holds: the records of the run, and each vehicle's in the order in which they were written.

    `faults` says what is not as it should be: an end that is missing, records that are damaged.
    """

    path: Path
    run_records: list[LogRecord] = field(default_factory=list)
    vehicles: dict[int, list[LogRecord]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    @cached_property
    def run(self) -> Run:
        """What was flown, as it was said last; raises LogError where it never was."""
        said = [each for each in self.run_records if each.kind is Run]
        if not said:
            raise LogError([f"{self.path}: it does not say what was flown: it ends before that was known"])
        return said[-1].read(Run)

    @cached_property
    def end(self) -> RunEnd | None:
        """How the run ended, None where nobody lived to say so."""
        return next((each.read(RunEnd) for each in reversed(self.run_records) if each.kind is RunEnd), None)

    def of_kind(self, vehicle_id: int, kind: type[RecordT]) -> Iterator[RecordT]:
        """Return a vehicle's records of one kind, in order."""
        return (each.read(kind) for each in self.vehicles.get(vehicle_id, ()) if each.kind is kind)


def read_log(path: Path) -> FlightLog:
    """Read a log as far as it is whole; raises LogError when it is none of cordon's."""
    log = FlightLog(path)
    decoders: dict[int, Decoder] = {}
    kinds: dict[int, tuple[type[Any], int, int]] = {}
    try:
        with path.open("rb") as stream:
            for record in _records(stream, log.faults):
                match record:
                    case Schema():
                        decoders[record.id] = Decoder(record.name, record.data)
                    case Channel():
                        known = _topic(record.topic)
                        if known is not None and record.schema_id in decoders:
                            kinds[record.id] = (*known, record.schema_id)
                    case Message() if record.channel_id in kinds:
                        kind, vehicle_id, schema_id = kinds[record.channel_id]
                        records = log.vehicles.setdefault(vehicle_id, []) if vehicle_id else log.run_records
                        records.append(LogRecord(kind, record.log_time, record.data, decoders[schema_id]))
    except OSError as error:
        raise LogError([f"{path}: {error.strerror or error}"]) from error
    if not log.run_records and not log.vehicles:
        raise LogError([f"{path}: it is no log of cordon's"])
    if log.run.format > FORMAT:
        log.faults.append(f"it was written by a newer version of cordon (format {log.run.format}, known is {FORMAT})")
    return log


def _topic(topic: str) -> tuple[type[Any], int] | None:
    """Return the kind of record on a topic, and whose it is (0: the run's); None for what only viewers need."""
    match topic.split("/"):
        case ["", "vehicle", number, name] if number.isdecimal() and name in KINDS:
            return KINDS[name], int(number)
        case ["", name] if name in RUN_KINDS:
            return RUN_KINDS[name], 0
    return None


def _records(stream: Any, faults: list[str]) -> Iterator[Any]:
    """Return records until the file ends or is damaged."""
    try:
        yield from StreamReader(stream, record_size_limit=RECORD_MAX_BYTES).records
    except (McapError, ValueError) as error:
        faults.append(f"it is not whole: {error}")
