"""A flight for identification over sockets: one stub, a short programme, and what can be made of its log."""

import json
from pathlib import Path

import pytest

from agents.control.excitation import programme
from gcs.flightlog.reader import read_log
from gcs.flightlog.run import mission_of
from gcs.mission.file import load_mission
from gcs.replay.cores import replay
from tests.support.verb_runs import EXCITE, EXCITED, finished, finished_in_turn, write_missions

pytestmark = pytest.mark.wire


def test_a_vehicle_is_excited_alone_inside_its_box_and_its_log_can_be_replayed(tmp_path: Path) -> None:
    write_missions(tmp_path)
    done = finished(EXCITE, tmp_path)
    assert done.fault == "", done.err
    assert "vehicle 1: standby -> excite: start" in done.err
    assert "vehicle 1: excite -> return and land: end" in done.err
    told = json.loads((tmp_path / "excite.out").read_text(encoding="utf-8"))
    assert told["vehicle"] == 1
    assert told["flown"]["parts_missing"] == []
    assert told["flown"]["reach_m"] < 3.0
    assert told["flown"]["speed_m_s"] < 2.0
    assert told["flown"]["speed_m_s"] == pytest.approx(told["preview"]["speed_m_s"], rel=0.15)

    recorded = read_log(tmp_path / "excited.mcap")
    assert set(recorded.vehicles) == {1}
    mission = mission_of(recorded)
    config = mission.agent_config(mission.vehicles[0])
    assert mission.excites
    assert mission.mission.duration_s == programme(config).duration_s == told["preview"]["duration_s"]
    assert load_mission(str(tmp_path / "ring.toml")).excites is False
    [vehicle] = replay(recorded).vehicles
    assert (vehicle.difference, vehicle.failure, vehicle.gap) == (None, None, "")
    assert vehicle.identical == vehicle.compared > 10 * told["preview"]["duration_s"] / 2.0
    report, identified = finished_in_turn(EXCITED, tmp_path)
    assert (report.fault, identified.fault) == ("", ""), (report.err, identified.err)
    evaluated = json.loads((tmp_path / "report.out").read_text(encoding="utf-8"))
    assert evaluated["ring"]["settling_time_s"] is None
    assert set(evaluated["verdicts"].values()) == {None}
