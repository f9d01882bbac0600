"""Logs with the mission and the plant files of an earlier version: the filters are those that it was flown with."""

from pathlib import Path

import pytest

from estimation.settings import OwnFilterSettings
from gcs.flightlog.reader import read_log
from gcs.flightlog.run import mission_of
from gcs.mission.file import load_mission, parse_mission
from gcs.replay.cores import replay
from gcs.replay.what_if import changed_filters, what_if
from tests.support.flight_logs import engaging, record_simulation
from tests.support.mission_text import content, put, text_of
from tests.support.paths import MISSIONS

pytestmark = pytest.mark.slow

PLANT = "delay_s = 0.2252\n[x]\na0_per_s2 = 1.531\na1_per_s = 1.899\n[y]\na0_per_s2 = 1.534\na1_per_s = 1.912\n"
"""What an earlier version recorded of `px4`: a plant, and nothing of filters."""
SECONDS = 20.0


def test_a_log_with_the_plant_file_px4_is_replayed_with_the_filters_defaults(tmp_path: Path) -> None:
    mission = put(content(), ("target", "start_m"), [8.0, -5.0])
    mission = put(mission, ("encirclement", "lag_weight"), 10.0)
    for index in range(3):
        mission = put(mission, ("vehicles", index, "plant"), "px4")
    flown = parse_mission(text_of(mission), MISSIONS, {"px4": PLANT})
    record_simulation(flown, tmp_path / "log.mcap", duration_s=SECONDS)
    log = read_log(tmp_path / "log.mcap")
    assert [plant.name for plant in log.run.plants] == ["px4"]
    read = mission_of(log)
    assert [each.own_filter for each in read.vehicles] == [OwnFilterSettings()] * 3
    assert (read.encirclement.lag_weight, read.vehicle(1).plant.delay_s) == (10.0, 0.2252)
    assert all(each.ticks == each.compared == each.identical > 0 for each in replay(log).vehicles)


def test_an_own_filter_of_the_mission_in_a_log_is_every_vehicles(tmp_path: Path) -> None:
    noise = ("own_filter",), {"position_noise_m": 0.1, "velocity_noise_m_s": 0.05}
    mission = engaging("case2", noise)
    record_simulation(mission, tmp_path / "log.mcap", duration_s=SECONDS)
    log = read_log(tmp_path / "log.mcap")
    expected = OwnFilterSettings(position_noise_m=0.1, velocity_noise_m_s=0.05)
    assert [each.own_filter for each in mission_of(log).vehicles] == [expected] * 3
    assert all(each.ticks == each.compared == each.identical > 0 for each in replay(log).vehicles)


def test_a_log_of_today_holds_every_vehicles_profile(tmp_path: Path) -> None:
    mission = load_mission("mixed-team")
    record_simulation(mission, tmp_path / "log.mcap", duration_s=SECONDS)
    log = read_log(tmp_path / "log.mcap")
    assert [plant.name for plant in log.run.plants] == ["ardupilot", "px4"]
    assert mission_of(log) == mission
    assert all(each.ticks == each.compared == each.identical > 0 for each in replay(log).vehicles)


def test_what_if_tries_a_value_on_vehicles_that_flew_with_different_ones(tmp_path: Path) -> None:
    mission = load_mission("mixed-team")
    record_simulation(mission, tmp_path / "log.mcap", duration_s=SECONDS)
    log = read_log(tmp_path / "log.mcap")
    found = what_if(log, mission, changed_filters(mission, ["own_filter.velocity_noise_m_s=0.232"]))
    (change,) = found.changes
    assert change.key == "own_filter.velocity_noise_m_s"
    assert (change.recorded, change.tried) == ({1: 0.232, 2: 0.0265, 3: 0.232}, 0.232)
    differences_m = {each.vehicle_id: each.difference_m for each in found.outcomes}
    assert (differences_m[1], differences_m[3]) == (0.0, 0.0)
    assert differences_m[2] != 0.0
