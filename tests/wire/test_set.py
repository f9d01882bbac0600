"""`--set`: every process of a flight has the values that were given in place of the mission's."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from gcs.flightlog.reader import read_log
from gcs.link.ports.claims import flight_claims
from gcs.mission.file import load_mission, parse_mission
from tests.support.mission_text import LOW
from tests.support.wire import PATIENCE_S, cordon

pytestmark = pytest.mark.wire


def test_agents_stubs_and_log_have_the_values_given(mission_file: Callable[..., str], tmp_path: Path) -> None:
    mission, log = mission_file("case2", LOW), tmp_path / "set.mcap"
    # A stub at the file's start would be 16 m off, and the preflight would refuse it.
    changes = ("--set", "vehicles[2].start_m=[0.0, -20.0]", "--set", "encirclement.radius_m=12")
    flying = ("fly", mission, "--sitl", "--speed", "10", "--duration", "3", "--json", "--log", str(log))
    with cordon(*flying, *changes) as flight:
        out, err = flight.communicate()
    assert json.loads(out)["ended"]["how"] == "landed", err
    flown = parse_mission(read_log(log).run.mission_text, None)
    assert (flown.encirclement.radius_m, flown.vehicle(3).section.start_m) == (12.0, (0.0, -20.0))


def test_processes_that_were_given_other_values_do_not_fly_together(mission_file: Callable[..., str]) -> None:
    path = mission_file("case2")
    mission = load_mission(path)
    with (
        flight_claims(mission, mission.ids[:1]),
        cordon("fly", path, "--only", "2", "--no-log", "--set", "mission.rate_hz=20") as other,
    ):
        _, err = other.communicate(timeout=PATIENCE_S)
    assert other.returncode == 3
    assert "flies another mission" in err
