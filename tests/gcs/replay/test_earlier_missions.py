"""Logs with the mission and the plant files of an earlier version: the filters are those that it was flown with."""

from pathlib import Path

import pytest

from gcs.flightlog.reader import read_log
from gcs.flightlog.run import mission_of
from gcs.mission.file import load_mission
from gcs.replay.cores import replay
from gcs.replay.what_if import changed_filters, what_if
from tests.support.flight_logs import record_simulation

pytestmark = pytest.mark.slow

PLANT = "delay_s = 0.2252\n[x]\na0_per_s2 = 1.531\na1_per_s = 1.899\n[y]\na0_per_s2 = 1.534\na1_per_s = 1.912\n"
"""What an earlier version recorded of `px4`: a plant, and nothing of filters."""
SECONDS = 20.0


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
    assert (change.recorded, change.tried) == ({1: 0.232, 2: 0.0266, 3: 0.232}, 0.232)
    differences_m = {each.vehicle_id: each.difference_m for each in found.outcomes}
    assert (differences_m[1], differences_m[3]) == (0.0, 0.0)
    assert differences_m[2] != 0.0
