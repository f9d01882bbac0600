"""Teams of which some vehicles are stubs, and boards on the bench. What is refused: `tests/gcs/preflight`."""

import json
import os
import pty
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from agents.shell.clock import WallClock
from gcs.autopilots.px4 import SITL_UID
from gcs.flight.stubs import stub_configs
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Truth
from gcs.mission.file import load_mission
from gcs.report.evidence.reading import read_flight
from sitl.server.process import StubProcess
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.paths import ROOT
from tests.support.wire import cordon, repeated_now

pytestmark = pytest.mark.wire

BOARD_UID = 0x3130_3738


@contextmanager
def beside(mission: str, *, uid: int, **parameters: int) -> Iterator[None]:
    """Serve a stub of vehicle 1 that poses as another vehicle."""
    config, *_ = stub_configs(load_mission(mission))
    process = StubProcess(
        [replace(config, uid=uid, parameters={"COM_OBL_RC_ACT": 4, **parameters})], partial(WallClock, 1.0)
    )
    process.start()
    yield
    process.stop()


def test_stubs_fly_with_a_simulator_that_is_already_there(mission_file: Callable[..., str], tmp_path: Path) -> None:
    mission, log = with_first_vehicles(mission_file("case2", LOW), 2), tmp_path / "hybrid.mcap"

    def attempt() -> None:
        log.unlink(missing_ok=True)
        flying = ("fly", mission, "--sitl", "2", "--duration", "3", "--json", "--log", str(log))
        with beside(mission, uid=SITL_UID), cordon(*flying) as flight:
            out, err = flight.communicate()
        assert flight.returncode in (0, 1), err
        result = json.loads(out)
        assert result["source"] == "hybrid"
        assert result["reference"] == "truth"
        assert result["ended"]["how"] == "landed", err
        assert result["kinds"] == {"1": "simulator in software", "2": "stub"}
        assert "simulator in software: 1; stub: 2" in err
        recorded = read_log(log)
        assert recorded.run.source == "hybrid"
        assert read_flight([recorded]).evidence.record.kinds == {1: "simulator in software", 2: "stub"}
        assert all(any(recorded.of_kind(i, Truth)) for i in recorded.vehicles)

    repeated_now(attempt)


def test_on_the_bench_a_board_flies_once_its_propellers_are_said_to_be_off(mission_file: Callable[..., str]) -> None:
    mission = with_first_vehicles(mission_file("case2", LOW), 2)

    def attempt() -> None:
        with beside(mission, uid=BOARD_UID, SYS_HITL=2):
            code, shown = answered("off", "fly", mission, "--sitl", "2", "--bench", "--no-log", "--duration", "3")
        assert "propellers are off:" in shown
        assert "Landed and disarmed" in shown
        assert code in (0, 1), "a ring of three seconds does not settle"

    repeated_now(attempt)


def answered(answer: str, *arguments: str) -> tuple[int, str]:
    """Run a command on a terminal and answer its question; return its exit code and what was shown."""
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(ROOT)
        os.execv(sys.executable, [sys.executable, "-m", "gcs", *arguments])
    shown = b""
    with suppress(OSError):  # the terminal's other end is closed
        while b"propellers are off:" not in shown:
            shown += os.read(terminal, 4096)
        os.write(terminal, answer.encode() + b"\n")
        while data := os.read(terminal, 4096):
            shown += data
    _, status = os.waitpid(child, 0)
    os.close(terminal)
    return os.waitstatus_to_exitcode(status), shown.decode(errors="replace")
