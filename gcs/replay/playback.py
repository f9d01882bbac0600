"""A log's records of one vehicle as the inputs of its core and the recorded decisions."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, get_args

import msgspec

from agents.inputs import Command, CoreInput, Tick
from agents.settings.config import AgentConfig
from agents.team.codec import decode
from agents.team.messages import OperatorCommand
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, LogRecord
from gcs.flightlog.records import Decision, LocalCommand, Taken
from gcs.mission.mission import Mission

_CORE_RECORDS = {*get_args(CoreInput), Taken, LocalCommand, Decision}


class MissingRecords(NamedTuple):
    """Records that are missing or cannot be read, with the reason."""

    reason: str


class Turn(NamedTuple):
    """The inputs of a core up to and including a tick, and the decision of that tick.

    The decision is None where the core failed, or where the log ends before the next tick (`is_last`). `number` and
    `payload` are those of the recorded decision.
    """

    inputs: tuple[CoreInput, ...]
    decision: Decision | None = None
    number: int = 0
    payload: bytes = b""
    is_last: bool = False

    @property
    def tick(self) -> Tick | None:
        """The tick of this turn, None where the log ends before it."""
        return self.inputs[-1] if self.inputs and isinstance(self.inputs[-1], Tick) else None


class _ReplayRecord(NamedTuple):
    number: int
    item: CoreInput | Decision
    payload: bytes


def config_of(log: FlightLog, mission: Mission, vehicle_id: int) -> AgentConfig:
    """Return the configuration of a recorded core; raises LogError for a vehicle that is not in the mission."""
    try:
        return mission.agent_config(mission.vehicle(vehicle_id))
    except KeyError as error:
        raise LogError([f"{log.path}: records of vehicle {vehicle_id}, which is not in its mission"]) from error


def recorded_vehicles(log: FlightLog) -> list[int]:
    """Return the vehicles whose control loops were recorded; raises LogError where there is none."""
    ids = sorted(i for i, records in log.vehicles.items() if any(each.kind is Tick for each in records))
    if not ids:
        raise LogError([f"{log.path}: no vehicle's control loop was recorded"])
    return ids


def tick_count(log: FlightLog, vehicle_id: int) -> int:
    """Return how many ticks of a vehicle a log holds."""
    return sum(each.kind is Tick for each in log.vehicles.get(vehicle_id, ()))


def turns(log: FlightLog, vehicle_id: int) -> Iterator[Turn | MissingRecords]:
    """Return a vehicle's inputs and decisions tick by tick, and `MissingRecords` wherever records are missing."""
    inputs: list[CoreInput] = []
    for each in _core_records(log, vehicle_id):
        if isinstance(each, MissingRecords):
            if inputs:
                yield Turn(tuple(inputs), is_last=True)
            yield each
        elif isinstance(each.item, Decision):
            yield Turn(tuple(inputs), each.item, each.number, each.payload)
        else:
            if inputs and isinstance(inputs[-1], Tick):
                yield Turn(tuple(inputs))
                inputs.clear()
            inputs.append(each.item)
            continue
        inputs.clear()
    if inputs:
        yield Turn(tuple(inputs), is_last=True)


def _core_records(log: FlightLog, vehicle_id: int) -> Iterator[_ReplayRecord | MissingRecords]:
    """Return a vehicle's inputs and decisions in order, and `MissingRecords` wherever records are missing."""
    expected = 1
    for record in log.vehicles.get(vehicle_id, ()):
        try:
            fields = record.plain()
            number = int(fields["number"])
            items = _items(log, record, fields) if record.kind in _CORE_RECORDS else ()
        except (LogError, msgspec.ValidationError, KeyError, ValueError, TypeError) as error:
            yield MissingRecords(f"record {expected} ({record.kind.__name__.lower()}) cannot be read: {error}")
            expected += 1
            continue
        if number != expected:
            yield MissingRecords(_missing(expected, number))
        expected = number + 1
        for item in items:
            yield _ReplayRecord(number, item, record.payload)


def _items(log: FlightLog, record: LogRecord, fields: dict[str, Any]) -> Sequence[CoreInput | Decision]:
    """Return the items of a record: consecutive messages share one record, every other item has its own."""
    if record.kind is Taken:
        return log.messages(record)
    if record.kind is not LocalCommand:
        return (msgspec.convert(fields, record.kind),)
    local = msgspec.convert(fields, LocalCommand)
    command = decode(local.payload)
    if not isinstance(command, OperatorCommand):
        raise ValueError("its payload is not an operator command")
    return (Command(local.now_s, command),)


def _missing(expected: int, number: int) -> str:
    if number < expected:
        return f"record {number} comes after record {expected - 1}"
    one = number == expected + 1
    return f"record {expected} is missing" if one else f"records {expected} to {number - 1} are missing"
