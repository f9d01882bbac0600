"""Messages of the bus in a log: each once for all vehicles that took it."""

from pathlib import Path

import pytest

from agents.inputs import Tick
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, LogRecord, read_log
from gcs.flightlog.records import Carried, Taken
from gcs.replay.cores import replay
from gcs.replay.playback import MissingRecords, turns
from tests.support.flight_logs import engaging, record_simulation, rewrite

VEHICLES = (1, 2, 3)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> FlightLog:
    path = tmp_path_factory.mktemp("logs") / "flight.mcap"
    record_simulation(engaging(), path, duration_s=10.0)
    return read_log(path)


def taken(log: FlightLog) -> list[Taken]:
    return [each for vehicle_id in VEHICLES for each in log.of_kind(vehicle_id, Taken)]


def test_a_message_that_several_vehicles_took_is_in_the_log_once_and_replays(flown: FlightLog) -> None:
    carried = [each.read(Carried).payload for each in flown.run_records if each.kind is Carried]
    assert len(carried) == len(set(carried)) == len(flown.carried)
    places = [place for each in taken(flown) for place in each.places]
    assert len(places) > 1.5 * len(carried), "most were taken by both others"
    assert set(places) == set(flown.carried)
    # One record holds what came in a row: no more records of messages than ticks.
    assert len(taken(flown)) <= sum(each.kind is Tick for records in flown.vehicles.values() for each in records)
    result = replay(flown)
    assert result.same
    assert all(each.identical == each.ticks for each in result.vehicles)


def test_a_lost_message_is_reported_and_ends_the_comparison_of_those_that_took_it(
    flown: FlightLog, tmp_path: Path
) -> None:
    lost = taken(flown)[10].places[0]

    def without(record: LogRecord) -> object:
        if record.kind is not Carried:
            return record.read(record.kind)
        return None if record.plain()["number"] == lost else record.read(Carried)

    log = rewrite(flown, tmp_path / "lost.mcap", 0, without)
    assert any("messages of the bus: 1 records are missing" in fault for fault in log.faults)
    for vehicle_id in VEHICLES:
        gap = any(isinstance(turn, MissingRecords) for turn in turns(log, vehicle_id))
        assert gap is any(lost in each.places for each in log.of_kind(vehicle_id, Taken))


def test_a_record_of_a_message_that_is_not_there_is_an_error(flown: FlightLog) -> None:
    record = next(each for each in flown.vehicles[1] if each.kind is Taken)
    with pytest.raises(LogError):
        FlightLog(flown.path).messages(record)
