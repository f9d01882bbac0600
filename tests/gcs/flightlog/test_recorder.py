"""The recorder when something is wrong with it: whoever flies does not notice, and the log says what is missing."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from foxglove import Context
from mcap.reader import make_reader

from agents.inputs import Tick
from gcs.errors import InputError
from gcs.flight.recording import FOLDER_VARIABLE, RecordingOptions, flight_log, report_log
from gcs.flightlog import recorder
from gcs.flightlog.reader import read_log
from gcs.flightlog.recorder import Recorder, RecorderThread
from gcs.flightlog.records import RunEnd
from gcs.flightlog.writer import LogWriter
from gcs.mission.file import load_mission
from tests.support.flight_logs import engaging, files_up_to, record_into
from tests.support.wire import PATIENCE_S, until_now

pytestmark = pytest.mark.slow

DURATION_S = 20.0
TICKS = 200


class HangingDisk:
    """Stands in for the writing to a file that does not come back until it is told to, or for longer than a test."""

    def __init__(self, write: Callable[[bytes], int]) -> None:
        self._write = write
        self.works, self.hangs = threading.Event(), threading.Event()
        self.works.set()

    def write(self, data: bytes) -> int:
        if not self.works.is_set():
            self.hangs.set()
            self.works.wait(PATIENCE_S)
        return self._write(data)


def hanging(writer: LogWriter, monkeypatch: pytest.MonkeyPatch) -> HangingDisk:
    disk = writer._disk
    assert disk is not None
    hanging_disk = HangingDisk(disk.write)
    monkeypatch.setattr(disk, "write", hanging_disk.write)
    return hanging_disk


def recorder_of(writer: LogWriter) -> Recorder:
    return Recorder(writer, time.time, lambda: 1.0)


# A disk that is full


def test_a_file_that_cannot_grow_ends_the_log_and_not_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.mcap"
    writer = LogWriter(path, Context())
    with files_up_to(100_000):
        record = record_into(writer, engaging(), duration_s=DURATION_S, flush_s=1.0)
    assert record.time_s[-1] == DURATION_S
    assert writer.fault == "File too large"
    report_log(writer)
    assert "the log is incomplete: File too large\n" in capsys.readouterr().err
    assert writer.size_bytes == path.stat().st_size <= 100_000
    assert_readable(path)


def assert_readable(path: Path) -> None:
    log = read_log(path)
    assert any("it was never closed" in fault for fault in log.faults)
    assert all(len(records) > 100 for records in log.vehicles.values())
    assert not any("missing" in fault for fault in log.faults), "what is there is without gaps"


def test_a_log_that_has_grown_too_large_is_closed_there(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    writer = LogWriter(path, Context(), size_max_bytes=100_000)
    record_into(writer, engaging(), duration_s=DURATION_S, flush_s=1.0)
    assert writer.fault == "it has reached 0.1 MB and ends there"
    assert 100_000 < path.stat().st_size < 150_000
    log = read_log(path)
    assert log.faults == []
    assert log.end is None
    with path.open("rb") as stream:
        assert make_reader(stream).get_summary() is not None


# An interpreter lock that is held nearly all the time


def test_what_waits_stays_bounded_where_the_recorder_gets_the_lock_seldom() -> None:
    """With 64 vehicles it gets it once in five milliseconds, in which forty items and more come."""
    recording, most = Recorder(NoLog(), lambda: 0.0, lambda: 1.0), 0
    core = recording.vehicle(2)
    for turn in range(2_000):
        for number in range(ITEMS_A_TURN):
            core.write(Tick(float(turn * ITEMS_A_TURN + number)))
        recording.drain_slice()
        most = max(most, len(recording._queue))
    assert most < 2_000, "what waits for the log grows as long as the flight lasts"


ITEMS_A_TURN = 60


class NoLog:
    """A log that writes nothing."""

    fault = ""

    def write(self, vehicle_id: int, number: int, log_time_ns: int, record: object) -> None:
        pass

    def fail(self, reason: str) -> None:
        raise AssertionError(reason)

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


# A disk that hangs


def test_a_disk_that_hangs_is_not_noticed_by_who_flies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "QUEUE_MAX", 50)
    monkeypatch.setattr(recorder, "FLUSH_PERIOD_S", 0.0)
    writer = LogWriter(tmp_path / "log.mcap", Context())
    disk = hanging(writer, monkeypatch)
    recording = recorder_of(writer)
    core = recording.vehicle(2)
    with RecorderThread(recording):
        for tick in range(TICKS):
            if tick == 20:
                until_now(lambda: not recording._queue)
                disk.works.clear()
                began_s = time.monotonic()
            core.write(Tick(float(tick)))
            if tick == 20:
                assert disk.hangs.wait(PATIENCE_S)
        assert time.monotonic() - began_s < PATIENCE_S, "whoever writes waits for the disk"
        disk.works.set()
        until_now(lambda: not recording._queue)
        core.write(Tick(float(TICKS)))
    assert writer.fault == "its disk is too slow: records are missing"
    numbers = [record["number"] for record in ticks_of(tmp_path / "log.mcap")]
    assert numbers[:20] == list(range(1, 21))
    assert numbers[-1] == TICKS + 1
    assert 70 <= len(numbers) < TICKS


def ticks_of(path: Path) -> list[dict[str, int]]:
    """The records of a log that does not say what was flown, as mcap's own reader and Protobuf find them."""
    from gcs.flightlog.schema import Decoder

    with path.open("rb") as stream:
        found = list(make_reader(stream).iter_messages(topics=["/vehicle/2/tick"]))
    return [
        Decoder(schema.name, schema.data).decode(message.data) for schema, _, message in found if schema is not None
    ]


def test_leaving_a_flight_does_not_wait_for_a_disk_that_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "CLOSING_TIMEOUT_S", 0.3)
    writer = LogWriter(tmp_path / "log.mcap", Context())
    disk = hanging(writer, monkeypatch)
    recording = recorder_of(writer)
    with RecorderThread(recording) as thread:
        recording.vehicle(2).write(Tick(0.0))
        disk.works.clear()
    assert recording.fault == "its disk has not answered for 0.3 s: it is not closed"
    disk.works.set()
    until_now(lambda: not thread._thread.is_alive())


# Bugs


def test_a_record_that_cannot_be_written_costs_itself_alone(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "log.mcap", Context())
    recording = recorder_of(writer)
    core = recording.vehicle(2)
    with RecorderThread(recording):
        core.write(Tick(1.0))
        core.note(object())
        core.write(Tick(2.0))
    assert recording.fault.startswith("a object could not be written: KeyError")
    assert [record["number"] for record in ticks_of(tmp_path / "log.mcap")] == [1, 3]


def test_a_recorder_that_fails_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise RuntimeError("out of order")

    writer = LogWriter(tmp_path / "log.mcap", Context())
    monkeypatch.setattr(writer, "flush", fail)
    recording = recorder_of(writer)
    with RecorderThread(recording):
        until_now(lambda: bool(recording.fault))
        recording.note(0, 0, RunEnd(1.0, 1.0))
    assert recording.fault == "the recorder ended: RuntimeError: out of order"


# Where the log is to be


def test_a_flight_that_was_not_told_where_is_flown_without_a_log_where_there_is_no_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "file"))
    assert flight_log(RecordingOptions(), load_mission("case2")) is None
    assert "this flight is not recorded: " in capsys.readouterr().err


def test_a_home_that_nobody_knows_is_no_place(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv(FOLDER_VARIABLE)
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    monkeypatch.setattr(Path, "home", fail)
    assert flight_log(RecordingOptions(), load_mission("case2")) is None
    assert f"set {FOLDER_VARIABLE} to a folder for logs" in capsys.readouterr().err


def test_a_place_that_was_told_and_is_none_ends_in_bad_input(subtests: pytest.Subtests, tmp_path: Path) -> None:
    for name, reason in (
        ("file", "exists already"),
        ("nowhere/log.mcap", "No such file"),
    ):
        with subtests.test(name=name, reason=reason):
            (tmp_path / "file").write_text("kept")
            with pytest.raises(InputError, match=reason):
                flight_log(RecordingOptions(tmp_path / name), load_mission("case2"))
            assert (tmp_path / "file").read_text() == "kept"
