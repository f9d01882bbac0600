"""Flights that are killed, or whose disk is full: what is left of their logs, and that it can be flown again."""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from agents.inputs import Tick
from gcs.flightlog.reader import read_log
from gcs.replay.cores import replay
from sitl.server.shared_clock import FOLDER_VARIABLE as CLOCKS_VARIABLE
from sitl.server.shared_clock import US_PER_S, ClockName, Rank, Seat
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.result_keys import RESULT_KEYS
from tests.support.wire import PATIENCE_S, until_now

pytestmark = pytest.mark.wire

SPEED = 5.0
ALOFT_TICKS = 300
"""Of one vehicle, 30 s of the mission's clock: they have taken off."""
FILE_MAX_BYTES = 200_000
LOG_PROGRAM = "gcs.flight.log_program"
LOSS_MAX_S = 4.0
"""Of the wall's clock: what is written is flushed every second, which a busy computer makes late. Not flushed, all of
the flight would still be lost.
"""


def test_a_flight_and_its_log_killed_in_mid_air_leave_all_but_their_last_second(
    mission_file: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "left.mcap"
    command = [sys.executable, "-m", "gcs"]
    flight = [
        "fly",
        with_first_vehicles(mission_file("case2", LOW), 2),
        "--sitl",
        "--speed",
        f"{SPEED:g}",
        "--log",
        str(log),
    ]
    clocks = tmp_path / "clocks"
    clocks.mkdir()
    environment = {**os.environ, "TERM": "dumb", CLOCKS_VARIABLE: str(clocks)}
    monkeypatch.setenv(CLOCKS_VARIABLE, str(clocks))
    with subprocess.Popen([*command, *flight], stderr=subprocess.PIPE, env=environment) as process:
        try:
            flying = until_now(lambda: child_of(process.pid), "the flying process")
            until_now(lambda: log.exists() and ticks(log) > ALOFT_TICKS, "the team aloft")
            (folder,) = clocks.glob("cordon-clock-*")
            with Seat(ClockName(int(folder.name.rpartition("-")[2], 16)), Rank.GUEST) as seat:
                os.kill(child_of(flying, LOG_PROGRAM), signal.SIGKILL)
                os.kill(flying, signal.SIGKILL)
                killed_s = seat.epoch_s + seat.now_us / US_PER_S
            assert process.wait(PATIENCE_S) == 4
        finally:
            process.kill()
    before = log.read_bytes()
    done = subprocess.run(
        [*command, "log", "recover", str(log)], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "incomplete: it was never closed: it ends" in done.stderr
    assert log.read_bytes() == before
    recovered = read_log(tmp_path / "left-recovered.mcap")
    assert recovered.faults == []
    assert recovered.end is None, "nobody lived to say how it ended"
    losses_s = [killed_s - records[-1].time_ns / 1e9 for records in recovered.vehicles.values()]
    print(f"MEASURED lost at kill -9: {', '.join(f'{loss_s:.2f} s' for loss_s in losses_s)}")
    assert len(losses_s) == 2
    assert 0.0 < max(losses_s) <= LOSS_MAX_S * SPEED  # of the clock of the flight
    for vehicle in replay(recovered).vehicles:
        assert (vehicle.difference, vehicle.failure, vehicle.gap) == (None, None, "")
        assert vehicle.identical == vehicle.compared > ALOFT_TICKS


def test_a_disk_that_is_full_is_told_and_a_team_flies_on_with_stubs_of_its_own(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    log = tmp_path / "short.mcap"
    command = [
        sys.executable,
        "-m",
        "gcs",
        "fly",
        mission_file("case1", LOW),
        "--sitl",
        "--speed",
        "10",  # the log is written beside, with the wall's time
        "--duration",
        "20",
    ]
    done = subprocess.run(
        [*command, "--json", "--log", str(log)],
        capture_output=True,
        text=True,
        env={**os.environ, "TERM": "dumb", "COLUMNS": "200"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_MAX_BYTES, FILE_MAX_BYTES)),
        check=False,
    )
    assert done.returncode == 1, done.stderr  # too short to be judged
    assert done.stderr.count("the log is incomplete: File too large; the flight continues\n") == 1
    assert done.stderr.count("the log is incomplete: File too large\n") == 1
    assert f"log: {log} (0.2 MB)" in done.stderr
    assert log.stat().st_size == FILE_MAX_BYTES
    assert all(len(records) > ALOFT_TICKS for records in read_log(log).vehicles.values())
    assert "fit to fly" not in done.stderr, "the vehicles that it brings along give no cause for warnings"
    result = json.loads(done.stdout)
    assert list(result) == RESULT_KEYS[""].split()
    assert (result["source"], result["reference"]) == ("sitl", "truth")
    assert result["duration_s"] == pytest.approx(20.0, abs=0.2)
    assert [vehicle["tactic"] for vehicle in result["vehicles"]] == ["formation"] * 3


def child_of(pid: int, program: str = "") -> int:
    """The first process that a process has started, of those whose command line holds `program`; 0 if none."""
    children = Path(f"/proc/{pid}/task/{pid}/children")
    if not children.exists():
        pytest.skip("this system does not tell whose child a process is")
    pids = map(int, children.read_text().split())
    return next((each for each in pids if program in Path(f"/proc/{each}/cmdline").read_text()), 0)


def ticks(path: Path) -> int:
    """How often the first vehicle has ticked, by a log in the making."""
    if path.stat().st_size < 20_000:
        return 0
    return sum(each.kind is Tick for each in read_log(path).vehicles.get(1, ()))
