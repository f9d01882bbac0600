"""Flights of stubs with users' planners, over MAVLink and Zenoh: what they reach, their replay, and their failure."""

import json
import os
from collections.abc import Callable
from math import tau
from pathlib import Path

import numpy as np
import pytest

from cordon.reading import read
from gcs.errors import Exit
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Truth
from gcs.mission.planner import VARIABLE
from tests.conftest import RunHere
from tests.support.mission_text import LOW, LOW_M
from tests.support.paths import DOCS
from tests.support.wire import PATIENCE_S, cordon

pytestmark = pytest.mark.wire

NEAR = ("start_m = [35.0, -5.0]", "start_m = [10.0, -4.0]")
PERTURBED = ("vehicles[0].true_scale={a0=0.85, a1=1.1}", "vehicles[2].true_scale={a0=1.15, a1=0.9}")
FAILING = """
from cyclic_pursuit import CyclicPursuit


class Failing(CyclicPursuit):
    '''Raises an exception on vehicle 2, in the 200th tick on the ring.'''

    def __init__(self, config):
        super().__init__(config)
        self._fails, self._planned = config.vehicle_id == 2, 0

    def plan(self, task):
        self._planned += task.tactic.value == "encircle"
        if self._fails and self._planned == 200:
            raise ZeroDivisionError("no plan")
        return super().plan(task)
"""


@pytest.fixture(autouse=True)
def planners(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes and this one find the examples, and planners of a test."""
    folders = (str(tmp_path), str(DOCS / "examples" / "planners"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (*folders, os.environ.get("PYTHONPATH")))))
    monkeypatch.delenv(VARIABLE, raising=False)
    for folder in folders:
        monkeypatch.syspath_prepend(folder)


def flown(mission: str, planner: str, duration_s: float, log: Path) -> tuple[int, dict[str, object], str]:
    """Fly stubs with other plants than the planner's; return exit code, result and what is told."""
    options = [word for value in (f"mission.planner={planner}", *PERTURBED) for word in ("--set", value)]
    given = ("--sitl", "--speed", "max", "--json", "--allow-plugins", "--duration", str(duration_s), "--log", str(log))
    with cordon("fly", mission, *given, *options) as flight:
        out, err = flight.communicate(timeout=2.0 * PATIENCE_S)
    return flight.returncode, json.loads(out), err


def assert_on_ring(log: Path) -> None:
    """Assert from true positions alone that three vehicles circle the target at the end, evenly, as in the mission."""
    flight = read(log)
    bearings_rad = []
    for channels in flight.vehicles.values():
        late = (channels.time_s > 120.0) & (channels.time_s < 145.0)
        time_s = channels.time_s[late]
        off_m = channels.position_m[late] - np.column_stack((10.0 + 0.1 * time_s, np.full(time_s.size, -4.0)))
        np.testing.assert_allclose(np.hypot(*off_m.T), 10.0, atol=0.5)
        bearings_rad.append(np.unwrap(np.arctan2(off_m[:, 1], off_m[:, 0])))
        assert np.polyfit(time_s, bearings_rad[-1], 1)[0] == pytest.approx(0.05, rel=0.05)
    at_end_rad = sorted(each[-1] % tau for each in bearings_rad)
    np.testing.assert_allclose(np.diff([*at_end_rad, at_end_rad[0] + tau]), tau / 3.0, atol=0.1)


@pytest.mark.long
@pytest.mark.parametrize("planner", ["cyclic_pursuit:CyclicPursuit", "nmpc:Nmpc"])
def test_an_example_meets_c1_to_c3_and_is_replayed_bit_for_bit(
    planner: str, mission_file: Callable[..., str], tmp_path: Path, run_here: RunHere
) -> None:
    log = tmp_path / "flight.mcap"
    code, result, err = flown(mission_file("case2", LOW, NEAR), planner, 150.0, log)
    assert code == Exit.HOLDS, err
    verdicts = result["verdicts"]
    assert isinstance(verdicts, dict)
    assert [verdicts[name] for name in ("C1", "C2", "C3", "separation", "kept")] == [True] * 5
    assert result["reference"] == "truth"
    assert_on_ring(log)
    recorded = read_log(log)
    assert recorded.run.planner is not None
    assert recorded.run.planner.name == planner
    assert run_here("replay", str(log)).code == Exit.BAD_INPUT, "its code is not run unless that is allowed"
    again = run_here("replay", str(log), "--allow-plugins", "--json")
    replayed = json.loads(again.out)
    assert again.code == Exit.HOLDS, again.err
    assert (replayed["other_versions"], replayed["tolerance"]) == ([], None)
    for each in replayed["vehicles"]:
        assert each["identical"] == each["compared"] == each["ticks"] > 1500


def test_a_vehicle_whose_planner_raises_lands_and_the_others_hold_return_and_land(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    (tmp_path / "failing.py").write_text(FAILING)
    log = tmp_path / "flight.mcap"
    code, result, err = flown(mission_file("case2", LOW, NEAR), "failing:Failing", 150.0, log)
    assert code == Exit.ENDED_IN_FLIGHT
    for text in ("vehicle 2, 20.", "ZeroDivisionError: no plan", "correct the planner"):
        assert text in err
    events = result["events"]
    assert isinstance(events, list)
    changes: dict[int, list[str]] = {1: [], 2: [], 3: []}
    for event in events:
        if "-> " in event["text"]:
            changes[event["vehicle"]].append(event["text"].partition("-> ")[2].partition(":")[0])
    assert changes[2] == ["formation", "encircle", "land"]
    for vehicle in (1, 3):
        assert changes[vehicle] == ["formation", "encircle", "hold", "return and land", "land"]
    recorded = read_log(log)
    for vehicle in (1, 2, 3):
        *_, last = recorded.of_kind(vehicle, Truth)
        assert last.position_m[2] < 0.1 < LOW_M, "it is down"
    closest = result["closest_approach_m"]
    assert isinstance(closest, float)
    assert closest > 3.0
