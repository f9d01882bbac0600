"""A flight for identification over sockets: one stub, a short programme, and what can be made of its log."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from agents.control.excitation import programme
from gcs.flightlog.reader import read_log
from gcs.flightlog.run import mission_of
from gcs.mission.file import load_mission
from gcs.replay.cores import replay
from tests.support.mission_text import LOW

pytestmark = pytest.mark.wire

SHORT = """[excitation]
offset_m = [0.0, 6.0]
half_width_m = 3.0
steps_s = 8.0
sweep_s = 8.0
sweep_from_hz = 0.15
rest_s = 3.0

[target]
"""


def test_a_vehicle_is_excited_alone_inside_its_box_and_its_log_can_be_replayed(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    path, log = mission_file("case2", ("[target]\n", SHORT), LOW), tmp_path / "excited.mcap"
    command = [sys.executable, "-m", "gcs", "excite", path, "--sitl", "--speed", "10", "--json", "--log", str(log)]
    environment = {**os.environ, "TERM": "dumb", "NO_COLOR": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert "vehicle 1: standby -> excite: start" in done.stderr
    assert "vehicle 1: excite -> return and land: end" in done.stderr
    told = json.loads(done.stdout)
    assert told["vehicle"] == 1
    assert told["flown"]["parts_missing"] == []
    assert told["flown"]["reach_m"] < 3.0
    assert told["flown"]["speed_m_s"] < 2.0
    assert told["flown"]["speed_m_s"] == pytest.approx(told["preview"]["speed_m_s"], rel=0.15)

    recorded = read_log(log)
    assert set(recorded.vehicles) == {1}
    mission = mission_of(recorded)
    config = mission.agent_config(mission.vehicles[0])
    assert mission.excites
    assert mission.mission.duration_s == programme(config).duration_s == told["preview"]["duration_s"]
    assert load_mission(path).excites is False
    [vehicle] = replay(recorded).vehicles
    assert (vehicle.difference, vehicle.failure, vehicle.gap) == (None, None, "")
    assert vehicle.identical == vehicle.compared > 10 * told["preview"]["duration_s"] / 2.0
    evaluated = subprocess.run(
        [sys.executable, "-m", "gcs", "report", str(log), "--json"],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment,
        check=False,
    )
    assert evaluated.returncode == 0, evaluated.stderr
    report = json.loads(evaluated.stdout)
    assert report["ring"]["settling_time_s"] is None
    assert set(report["verdicts"].values()) == {None}
