"""The log's process: it writes what it is sent, outlives the flight, and never disturbs it."""

import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from agents.inputs import Tick
from agents.ports import VehicleRefusedError
from gcs.flight import log_process
from gcs.flight.log_process import LogProcess, LogRequest
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import RunEnd
from gcs.flightlog.run import run_of
from gcs.mission.file import load_mission
from gcs.viewer.origin_gate import Address
from tests.support.flight_logs import engaging, record_simulation
from tests.support.paths import ROOT, finds_tests
from tests.support.wire import until_now

MISSION = load_mission("case2")
RECORDS = 500
KILLED = f"""
import os, signal
from pathlib import Path
from tests.gcs.flight.test_log_process import Tick, opened
log = opened(Path({{path!r}}))
for number in range({RECORDS}):
    log.write(1, number + 1, number, Tick(float(number)))
log.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def opened(path: Path) -> LogProcess:
    log = LogProcess(LogRequest(MISSION, path))
    run = run_of(MISSION, MISSION.ids, seed=0, source="flight", speed=1.0, began_s=0.0, duration_s=1.0)
    log.write(0, 0, 0, run)
    return log


def _is_closed(path: Path) -> bool:
    try:
        return "it was never closed" not in str(read_log(path).faults)
    except LogError:  # its process has yet to write the first record
        return False


def test_a_flight_is_written_as_if_by_its_own_process(tmp_path: Path) -> None:
    record_simulation(engaging(), tmp_path / "direct.mcap", duration_s=8.0)
    direct = read_log(tmp_path / "direct.mcap")
    log = LogProcess(LogRequest(MISSION, tmp_path / "sent.mcap"))
    for vehicle_id, records in {0: direct.run_records, **direct.vehicles}.items():
        for record in records:
            log.write(vehicle_id, record.plain()["number"], record.time_ns, record.read(record.kind))
    log.close()
    sent = read_log(log.path or Path())
    assert (log.fault, sent.faults) == ("", [])
    assert log.size_bytes == (tmp_path / "sent.mcap").stat().st_size
    assert sent.run == direct.run
    assert {
        i: [(each.kind, each.time_ns, each.payload) for each in records] for i, records in sent.vehicles.items()
    } == {i: [(each.kind, each.time_ns, each.payload) for each in records] for i, records in direct.vehicles.items()}


def test_records_that_come_fast_are_sent_in_few_batches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each batch gives the interpreter lock away, for milliseconds where many vehicles fly."""
    now_s, sent = 0.0, list[float]()
    monkeypatch.setattr(log_process, "monotonic", lambda: now_s)
    log = opened(tmp_path / "log.mcap")
    send = log._send

    def counted(*frames: bytes) -> None:
        sent.append(now_s)
        send(*frames)

    monkeypatch.setattr(log, "_send", counted)
    for number in range(2 * RECORDS):  # 10 000 a second
        now_s = number * 1e-4
        log.write(1, number + 1, number, Tick(float(number)))
    assert 4 <= len(sent) <= 7
    log.close()
    assert [each.read(Tick).now_s for each in read_log(tmp_path / "log.mcap").vehicles[1]] == list(range(2 * RECORDS))


def test_a_log_is_completed_when_the_flying_process_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    flying = subprocess.run(
        [sys.executable, "-c", KILLED.format(path=str(path))], cwd=ROOT, env=finds_tests(), check=False
    )
    assert flying.returncode == -signal.SIGKILL
    until_now(lambda: _is_closed(path))
    assert [each.read(Tick).now_s for each in read_log(path).vehicles[1]] == list(range(RECORDS))


def test_ctrl_c_is_left_to_the_flying_process(tmp_path: Path) -> None:
    log = opened(tmp_path / "log.mcap")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        log._process.send_signal(number)
    log.write(0, 0, 0, RunEnd(1.0, 1.0))
    log.close()
    assert log.fault == ""
    assert read_log(tmp_path / "log.mcap").end == RunEnd(1.0, 1.0)


def test_a_log_whose_process_is_killed_ends_and_says_so(tmp_path: Path) -> None:
    log = opened(tmp_path / "log.mcap")
    log.write(1, 1, 0, Tick(0.0))
    log._process.kill()
    log._process.wait()
    for number in range(RECORDS):
        log.write(1, number, number, Tick(float(number)))
    assert log.fault == "the process that writes it has ended"
    log.close()


def test_a_record_that_its_type_does_not_permit_costs_no_other(tmp_path: Path) -> None:
    log = opened(tmp_path / "log.mcap")
    log.write(1, 1, 0, Tick("now"))  # type: ignore[arg-type]
    log.write(1, 2, 0, Tick(1.0))
    log.close()
    assert log.fault.startswith("a Tick could not be written: ValidationError: Expected `float`, got `str`")
    assert [each.read(Tick) for each in read_log(tmp_path / "log.mcap").vehicles[1]] == [Tick(1.0)]


def test_an_address_that_is_taken_refuses_the_flight_and_leaves_no_file(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        request = LogRequest(MISSION, tmp_path / "log.mcap", Address("127.0.0.1", taken.getsockname()[1]))
        with pytest.raises(VehicleRefusedError, match="--live: cannot listen") as refusal:
            LogProcess(request)
    assert "--live-address" in refusal.value.next_step
    assert list(tmp_path.iterdir()) == []
