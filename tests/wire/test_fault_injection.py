"""Faults that `cordon fly --sitl --fault` injects, and what the team and its records say of them.

Values that `--set` gives in place of the mission's are those of agents, stubs and log.
"""

import json
from collections.abc import Callable
from math import dist, hypot
from pathlib import Path

import pytest

from estimation.state import Telemetry
from gcs.cli.report import ReportOptions, report
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Truth
from gcs.mission.file import parse_mission
from gcs.report.evidence.reading import read_flight
from tests.support.mission_text import LOW
from tests.support.wire import PATIENCE_S, cordon

pytestmark = pytest.mark.wire

FLY = ("--sitl", "--speed", "max", "--json")


def test_faults_come_at_their_times_and_the_team_reacts(
    mission_file: Callable[..., str], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    log = tmp_path / "faults.mcap"
    faults = (
        "origin-moved@4:2",
        "height-jumped@6:3",
        "foreign-mode@10:2",
        "one-vehicle-not-heard@14:3",
        "link-cut@20:3",
    )
    options = [word for fault in faults for word in ("--fault", fault)]
    # A stub at the file's start would be 16 m off, and the preflight would refuse it.
    options += ["--set", "vehicles[2].start_m=[0.0, -20.0]", "--set", "encirclement.radius_m=12"]
    with cordon("fly", mission_file("case2", LOW), *FLY, "--duration", "30", "--log", str(log), *options) as flight:
        out, err = flight.communicate(timeout=PATIENCE_S)
    result, recorded = json.loads(out), read_log(log)
    assert "4.0 s: injected: origin moved, vehicle 2" in err
    assert tuple(result["faults"]) == recorded.run.faults == faults
    flown = parse_mission(recorded.run.mission_text, None)
    assert (flown.encirclement.radius_m, flown.vehicle(3).section.start_m) == (12.0, (0.0, -20.0))
    with subtests.test("reactions"):
        events = [(event["time_s"], event["vehicle"], event["text"]) for event in result["events"]]
        piloted_s = [at_s for at_s, vehicle, text in events if vehicle == 2 and "-> pilot override" in text]
        assert len(piloted_s) == 1
        assert 10.0 <= piloted_s[0] <= 13.0, "a mode is reported once a second, and messages take theirs"
        unheard = {vehicle: at_s for at_s, vehicle, text in events if "peer silent" in text and vehicle != 3}
        assert unheard.keys() == {1, 2}
        assert all(14.0 < at_s < 30.0 for at_s in unheard.values())
        stale_s = [at_s for at_s, vehicle, text in events if vehicle == 3 and text.startswith("telemetry stale")]
        assert len(stale_s) == 1
        assert 20.0 < stale_s[0] < 26.0
    with subtests.test("what positions refer to"):
        moved, jumped = (event for event in result["events"] if "reference" in event)
        assert [(each["vehicle"], each["reference"]["what"]) for each in (moved, jumped)] == [
            (2, "origin moved"),
            (3, "position jumped"),
        ]
        north_m, east_m, up_m = (moved["reference"][f"{name}_m"] for name in ("north", "east", "up"))
        assert hypot(north_m, east_m, up_m) == pytest.approx(10.0, abs=0.05)
        jump_m = [jumped["reference"][f"{name}_m"] for name in ("north", "east", "up")]
        assert jump_m == pytest.approx([0.0, 0.0, 6.0], abs=0.2)
        html = tmp_path / "report.html"
        report([log], options=ReportOptions(html=html))
        logged = [each for each in read_flight([recorded]).evidence.record.events if each.reference is not None]
        assert [each.to_dict()["reference"] for each in logged] == [moved["reference"], jumped["reference"]]
        assert f"origin moved {north_m:.1f} m north, {east_m:.1f} m east, {up_m:.1f} m up" in html.read_text()
    for vehicle in (2, 3):
        with subtests.test("positions told are the true ones", vehicle=vehicle):
            true = {round(each.time_s, 1): each.position_m for each in recorded.of_kind(vehicle, Truth)}
            told = [(each.position_m, round(each.time_s, 1)) for each in recorded.of_kind(vehicle, Telemetry)]
            off_m = [dist(told_m, true[time_s]) for told_m, time_s in told if time_s in true]
            assert len(off_m) > 200
            assert max(off_m) < 0.5, "rounded to a tenth of a second, at 2 m/s"


def test_without_stubs_no_fault_is_injected(mission_file: Callable[..., str]) -> None:
    with cordon("fly", mission_file("case2"), "--fault", "link-cut@3") as flight:
        _, err = flight.communicate(timeout=PATIENCE_S)
    assert flight.returncode == 2
    assert "--fault: it needs --sitl" in err
