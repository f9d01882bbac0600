"""The flight book: entries of logs made by hand, whose times in the air, crew and endings the test knows."""

import csv
import json
import struct
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path

import pytest
from foxglove import Context

from agents.inputs import AutopilotStatus, Start
from agents.ports import FlightMode, VehicleStatus
from gcs.flightlog import container
from gcs.flightlog.audit import AuditEntry
from gcs.flightlog.reader import read_kinds, read_log
from gcs.flightlog.records import Run, RunEnd, Vehicle, VehicleEnd
from gcs.flightlog.recover import recover
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.mission.file import load_mission
from gcs.report.flight_book import KINDS, BookedFlight, FlightBook, booked, read_book
from tests.conftest import RunHere
from tests.support.flight_logs import engaging, record_simulation
from tests.support.result_keys import OUTPUT_KEYS

BEGAN_S = 1_767_268_800.0
"""2026-01-01, 12:00 UTC."""
CHUNK = 6


def write_flight(path: Path, *, speed: float = 1.0, began_s: float = BEGAN_S, ends: bool = True) -> None:
    """Write a log of two vehicles of px4-trio: 1 flies for 60 s and again for 30 s, 2 for 45 s, on the log's clock."""
    writer, mission = LogWriter(path, Context()), load_mission("px4-trio")
    run = run_of(
        mission, (1, 2), seed=1, source="flight", speed=speed, began_s=began_s, duration_s=150.0, operator="kim.field"
    )
    writer.write(0, 0, stamp_ns(began_s, 0.0), run)
    in_air = {1: ((10.0, 70.0), (80.0, 110.0)), 2: ((20.0, 65.0),)}
    for vehicle, spans in in_air.items():
        records: list[tuple[float, object]] = [
            (1.0, Vehicle("PX4", "1.16.0", (), "px4")),
            (30.0, Start(began_s + 30.0)),
        ]
        for second in range(2, 120):
            is_up = any(first <= second < last for first, last in spans)
            status = VehicleStatus(connected=True, armed=is_up, in_air=is_up, mode=FlightMode.OFFBOARD)
            records.append((float(second), AutopilotStatus(status)))
        if ends:
            how = ("battery", "battery low") if vehicle == 2 else ("landed", "landed and disarmed")
            records.append((120.0, VehicleEnd(1000, 0, None, *how)))
        for number, (at_s, record) in enumerate(sorted(records, key=lambda each: each[0]), start=1):
            writer.write(vehicle, number, stamp_ns(began_s, at_s), record)
            writer.flush()
    for event, operator in (("received", "anna"), ("answered", "anna"), ("received", "ben"), ("head", "zoe")):
        entry = AuditEntry(began_s, event, 1, "bus", operator, "", 1, "", "", "")  # type: ignore[arg-type]
        writer.write(0, 0, stamp_ns(began_s, 121.0), entry)
    if ends:
        writer.write(0, 0, stamp_ns(began_s, 121.0), RunEnd(90.0, 121.0))
    writer.close()


def stamp_ns(began_s: float, at_s: float) -> int:
    return round((began_s + at_s) * 1e9)


def book_of(*paths: Path) -> FlightBook:
    return read_book(paths, lambda _share: None)


def entry_of(path: Path) -> BookedFlight:
    (entry,) = book_of(path).flights
    return entry


def chunks_of(data: bytes) -> Iterator[tuple[int, int]]:
    """Return begin and length of the chunks of a whole file: an own walk through its records."""
    offset = 8
    while offset < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, offset)
        if kind == CHUNK:
            yield offset, length
        offset += 9 + length


@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_an_entry_has_what_the_log_was_written_with(tmp_path: Path, speed: float) -> None:
    """At speed 5 a second of the log is five of the flight."""
    write_flight(tmp_path / "flight.mcap", speed=speed)
    entry = entry_of(tmp_path / "flight.mcap")
    assert (entry.log, entry.began_s, entry.mission, entry.source) == ("flight.mcap", BEGAN_S, "px4-trio", "flight")
    assert entry.place_deg == (47.397742, 8.545594)
    assert entry.crew == ("kim.field", "anna", "ben")
    assert [(each.id, each.kind) for each in entry.vehicles] == [(1, "px4"), (2, "px4")]
    assert [each.airborne_s for each in entry.vehicles] == pytest.approx([90.0 * speed, 45.0 * speed])
    assert entry.airborne_s == pytest.approx(135.0 * speed)
    assert entry.ended is not None
    assert (entry.ended.how, entry.ended.vehicles) == ("battery", (2,)), "the most severe"
    assert (entry.faults, entry.is_damaged, entry.verdict) == ((), False, "")


def test_a_log_that_ends_in_flight_counts_up_to_its_end(tmp_path: Path) -> None:
    """It is not closed either: it is read without an index."""
    write_flight(tmp_path / "whole.mcap", ends=False)
    data = (tmp_path / "whole.mcap").read_bytes()
    at = [begin for begin, _ in chunks_of(data)][90]  # of vehicle 1, which is in the air again
    (tmp_path / "cut.mcap").write_bytes(data[:at])
    entry = entry_of(tmp_path / "cut.mcap")
    first, second = entry.vehicles
    assert first.airborne_s == pytest.approx(60.0 + 8.0, abs=2.0)
    assert second.airborne_s is None, "nothing of it is left"
    assert entry.ended is not None
    assert entry.ended.how == "in flight"
    assert "never closed" in entry.faults[0]
    assert not entry.is_damaged, "as everywhere else"


def test_simulations_have_no_time_in_the_air_and_may_have_a_local_frame(tmp_path: Path) -> None:
    path = tmp_path / "sim.mcap"
    record_simulation(engaging("case2-field", (("frame",), {"local": True})), path, duration_s=3.0)
    entry = entry_of(path)
    assert (entry.place_deg, entry.airborne_s, entry.source) == (None, None, "simulation")
    assert entry.ended is not None
    assert entry.ended.how == "simulated"


def test_a_copy_is_listed_and_does_not_count(tmp_path: Path) -> None:
    write_flight(tmp_path / "flight.mcap")
    write_flight(tmp_path / "other.mcap", began_s=BEGAN_S - 86400.0)
    recover(tmp_path / "flight.mcap", tmp_path / "flight-recovered.mcap", lambda _share: None)
    book = book_of(*sorted(tmp_path.iterdir()))
    assert [(each.log, each.copy_of) for each in book.flights] == [
        ("other.mcap", ""),
        ("flight-recovered.mcap", ""),
        ("flight.mcap", "flight-recovered.mcap"),
    ]
    assert book.airborne_s == pytest.approx({"flight": 270.0})


def test_the_index_leads_to_the_same_records_and_spares_the_other_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "sim.mcap"
    record_simulation(engaging(), path, duration_s=10.0, flush_s=0.5)
    unpacked = list[int]()
    whole_unpack = container._unpacked

    def unpack(body: bytes) -> bytes:
        unpacked.append(len(body))
        return whole_unpack(body)

    monkeypatch.setattr(container, "_unpacked", unpack)
    kinds = (Run, RunEnd, Start, VehicleEnd)
    chosen, by_index = read_kinds(path, kinds), len(unpacked)
    whole = read_log(path)
    in_all = len(unpacked) - by_index
    assert 0 < by_index < in_all / 2
    for vehicle in (0, 1, 2, 3):
        found = chosen.vehicles.get(vehicle, chosen.run_records)
        expected = [each for each in whole.vehicles.get(vehicle, whole.run_records) if each.kind in kinds]
        assert [(each.time_ns, each.payload) for each in found] == [(each.time_ns, each.payload) for each in expected]
    assert booked(read_kinds(path, KINDS)) == booked(whole)


def test_a_damaged_chunk_is_a_fault(tmp_path: Path, run_here: RunHere) -> None:
    path = tmp_path / "flight.mcap"
    write_flight(path)
    data = bytearray(path.read_bytes())
    begin, length = list(chunks_of(bytes(data)))[40]
    data[begin + length] ^= 0xFF
    path.write_bytes(data)
    assert entry_of(path).is_damaged
    (tmp_path / "none.mcap").write_bytes(b"no log")
    (tmp_path / "empty.mcap").write_bytes(b"")
    ran = run_here("flights", str(tmp_path), "--json")
    assert ran.code == 1
    book = json.loads(ran.out)
    assert [each["log"] for each in book["flights"]] == ["flight.mcap"]
    assert book["flights"][0]["damaged"] is True
    assert {each["log"]: each["fault"] for each in book["unread"]} == {
        "none.mcap": "it is not an MCAP file",
        "empty.mcap": "it is empty",
    }
    for named in ("flight.mcap: damaged", "none.mcap: it is not an MCAP file"):
        assert named in ran.err


def test_a_log_without_a_date_is_listed_with_its_fault(tmp_path: Path) -> None:
    write_flight(tmp_path / "flight.mcap", began_s=1e9)
    write_flight(tmp_path / "undated.mcap", began_s=5e9)
    book = book_of(*sorted(tmp_path.iterdir()))
    assert [each.log for each in book.flights] == ["flight.mcap"]
    assert [(each.log, "5e+09" in each.fault) for each in book.unread] == [("undated.mcap", True)]


def test_the_command_prints_a_table_json_and_csv(tmp_path: Path, run_here: RunHere, subtests: pytest.Subtests) -> None:
    write_flight(tmp_path / "flight.mcap")
    with subtests.test("table"):
        ran = run_here("flights", str(tmp_path))
        assert ran.code == 0
        row = ran.out.splitlines()[1]
        for text in (
            "2026-01-01 12:00",
            "px4-trio",
            "47.39774, 8.54559",
            "kim.field, anna, ben",
            "2.2 (1: 1.5, 2: 0.8)",
        ):
            assert text in row
        assert "flight: 1 flight, 2.2 minutes" in ran.out
    with subtests.test("json and csv"):
        table = tmp_path / "book.csv"
        ran = run_here("flights", str(tmp_path), "--json", "--csv", str(table))
        book = json.loads(ran.out)
        assert " ".join(book) == OUTPUT_KEYS["flights"]
        (flight,) = book["flights"]
        assert " ".join(flight) == OUTPUT_KEYS["flights[] of flights"]
        assert " ".join(flight["vehicles"][0]) == OUTPUT_KEYS["vehicles[] of flights"]
        assert (flight["began"], flight["airborne_s"]) == ("2026-01-01T12:00:00.000Z", 135.0)
        assert flight["verdicts"] is None
        first, second = csv.DictReader(StringIO(table.read_text()))
        assert (first["vehicle"], first["airborne_min"]) == ("1", "1.5")
        assert (second["vehicle"], second["airborne_min"]) == ("2", "0.75")
        assert (first["latitude_deg"], first["crew"]) == ("47.397742", "kim.field anna ben")
        assert table.stat().st_mode & 0o077 == 0


def test_verdicts_are_those_of_the_report(tmp_path: Path, run_here: RunHere) -> None:
    record_simulation(engaging(), tmp_path / "sim.mcap", duration_s=60.0)
    reported = json.loads(run_here("report", str(tmp_path / "sim.mcap"), "--json").out)["verdicts"]
    ran = run_here("flights", str(tmp_path), "--verdicts", "--json")
    (flight,) = json.loads(ran.out)["flights"]
    assert ran.code == 0, "verdicts that fail are no damage"
    assert True in flight["verdicts"].values()
    assert flight["verdicts"] == {name: reported[name] for name in flight["verdicts"]}


def test_bad_input_ends_in_2_and_names_what_is_wrong(
    tmp_path: Path, run_here: RunHere, subtests: pytest.Subtests, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there.csv").write_text("kept")
    (tmp_path / "file.mcap").write_text("")
    monkeypatch.setenv("CORDON_LOGS", str(tmp_path / "default"))
    rows: Sequence[tuple[tuple[str, ...], str]] = (
        ((str(tmp_path / "missing"),), f"FOLDER: '{tmp_path}/missing' is no folder"),
        ((str(tmp_path / "file.mcap"),), f"FOLDER: '{tmp_path}/file.mcap' is no folder"),
        ((), f"FOLDER: '{tmp_path}/default' is no folder"),
        ((str(tmp_path), "--csv", str(tmp_path / "there.csv")), "there.csv' exists already"),
        ((str(tmp_path), "--csv", str(tmp_path / "book.txt")), "--csv: 'book.txt' must end in .csv"),
    )
    for words, named in rows:
        with subtests.test(named):
            ran = run_here("flights", *words)
            assert (ran.code, named in ran.err) == (2, True), ran.err
    assert (tmp_path / "there.csv").read_text() == "kept"


def test_the_default_folder_is_that_of_recorded_flights(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CORDON_LOGS", str(tmp_path))
    ran = run_here("flights")
    assert (ran.code, ran.out) == (0, f"{tmp_path}: no log of a flight\n")
