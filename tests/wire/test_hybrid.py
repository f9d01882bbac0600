"""Teams of which some vehicles are stubs, and boards on the bench: what flies, and what is refused."""

import json
import os
import pty
import sys
from collections.abc import Callable
from contextlib import suppress
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
from tests.support.mission_text import LOW
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S, cordon

pytestmark = pytest.mark.wire

FLY = ("--duration", "12", "--json")
BOARD_UID = 0x3130_3738


def beside(mission: str, *, uid: int, **parameters: int) -> StubProcess:
    """Return a stub of vehicle 1 that poses as another vehicle."""
    (config,) = (each for each in stub_configs(load_mission(mission)) if each.vehicle_id == 1)
    return StubProcess(
        [replace(config, uid=uid, parameters={"COM_OBL_RC_ACT": 4, **parameters})], partial(WallClock, 1.0)
    )


def test_stubs_fly_with_a_simulator_that_is_already_there(mission_file: Callable[..., str], tmp_path: Path) -> None:
    mission, log = mission_file("case2", LOW), tmp_path / "hybrid.mcap"
    simulator = beside(mission, uid=SITL_UID)
    simulator.start()
    with cordon("fly", mission, "--sitl", "2,3", *FLY, "--log", str(log)) as flight:
        out, err = flight.communicate(timeout=120.0)
    simulator.stop()
    result = json.loads(out)
    assert result["source"] == "hybrid"
    assert result["reference"] == "truth"
    assert result["ended"]["how"] == "landed", err
    assert result["kinds"] == {"1": "simulator in software", "2": "stub", "3": "stub"}
    assert "simulator in software: 1; stub: 2, 3" in err
    recorded = read_log(log)
    assert recorded.run.source == "hybrid"
    assert read_flight([recorded]).evidence.record.kinds == {1: "simulator in software", 2: "stub", 3: "stub"}
    assert all(any(recorded.of_kind(i, Truth)) for i in recorded.vehicles)


@pytest.mark.parametrize(
    ("uid", "hitl", "refused"),
    [
        (BOARD_UID, 0, "real and simulated vehicles: real flight: 1; stub: 2, 3"),
        (BOARD_UID, 2, "it is a board with a simulated body"),
    ],
    ids=["a real vehicle", "a board"],
)
def test_real_vehicles_and_boards_are_refused_beside_stubs(
    uid: int, hitl: int, refused: str, mission_file: Callable[..., str]
) -> None:
    mission = mission_file("case2", LOW)
    other = beside(mission, uid=uid, SYS_HITL=hitl)
    other.start()
    with cordon("fly", mission, "--sitl", "2,3", "--no-log", *FLY) as flight:
        _, err = flight.communicate(timeout=PATIENCE_S)
    other.stop()
    assert flight.returncode == 3
    assert refused in " ".join(err.split())


def test_on_the_bench_a_board_flies_once_its_propellers_are_said_to_be_off(mission_file: Callable[..., str]) -> None:
    mission = mission_file("case2", LOW)
    board = beside(mission, uid=BOARD_UID, SYS_HITL=2)
    board.start()
    code, shown = answered("off", "fly", mission, "--sitl", "2,3", "--bench", "--no-log", "--duration", "3")
    board.stop()
    assert "propellers are off:" in shown
    assert "Landed and disarmed" in shown
    assert code in (0, 1), "a ring of three seconds does not settle"


def answered(answer: str, *arguments: str) -> tuple[int, str]:
    """Run a command on a terminal and answer its question; return its exit code and what was shown."""
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(ROOT)
        os.execv(sys.executable, [sys.executable, "-m", "gcs", *arguments])
    shown = b""
    while b"propellers are off:" not in shown:
        shown += os.read(terminal, 4096)
    os.write(terminal, answer.encode() + b"\n")
    with suppress(OSError):  # the terminal's other end is closed
        while data := os.read(terminal, 4096):
            shown += data
    _, status = os.waitpid(child, 0)
    os.close(terminal)
    return os.waitstatus_to_exitcode(status), shown.decode(errors="replace")
