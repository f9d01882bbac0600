"""How near vehicles come to each other on the ways out and home, by motions whose closest approach is known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimation.state import Vector
from gcs.metrics.apart import closest_approach_m
from gcs.metrics.journal import Journal, RunTotals
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import VehicleTrack
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from sitl.server.record import TruthTrack

START_S, FLOWN_S, LANDED_S = 100.0, 20.0, 150.0
Path = Callable[[Vector], tuple[Vector, Vector, Vector]]


@pytest.fixture
def mission() -> Mission:
    """Vehicles keep 3 m apart, unless their heights differ by 2 m; 0.8 of that counts for those in layers."""
    return load_mission("case2", {"safety.separation_m": 3.0, "safety.vertical_separation_m": 2.0})


def beside(y_m: float, height_m: float) -> Path:
    """Hover on the line y = y_m, from 90 s to 140 s at a height, before and after that on the ground."""

    def path(time_s: Vector) -> tuple[Vector, Vector, Vector]:
        aloft = (time_s > 90.0) & (time_s < 140.0)
        return np.zeros_like(time_s), np.full_like(time_s, y_m), np.where(aloft, height_m, 0.0)

    return path


def passes_at(time_s: float, past_m: float, height_m: float) -> Path:
    """Fly along x at 1 m/s, at y = past_m, through x = 0 at a time."""
    return lambda at_s: (at_s - time_s, np.full_like(at_s, past_m), np.full_like(at_s, height_m))


def closest_m(mission: Mission, *paths: Path, by_truth: bool) -> float | None:
    """Return the figure of a flight in which the vehicles flew these paths, ground before and after included."""
    journal, truth = Journal(mission), []
    for i, path in enumerate(paths, start=1):
        time_s = np.arange(80.0, LANDED_S, 0.1)
        x, y, z = path(time_s)
        still = np.zeros_like(x)
        truth.append(TruthTrack(i, time_s, np.column_stack((x, y, z)), np.column_stack((still, still, still))))
        for row in range(time_s.size):
            shown_m = np.array((x[row], y[row] + (0.0 if not by_truth else 9.0), 0.0, 0.0))
            journal.add_sample(i, float(time_s[row]), shown_m, float(z[row]), "formation")
    totals = RunTotals("flight", 0, 0, 1.0, tuple(truth) if by_truth else ())
    return journal.record(START_S, FLOWN_S, totals).ways_closest_m


@pytest.mark.parametrize("by_truth", [True, False])
@pytest.mark.parametrize("at_s", [95.0, 130.0])
def test_the_closest_on_the_ways_is_where_one_passes_the_other(mission: Mission, at_s: float, by_truth: bool) -> None:
    hovering = beside(0.0, 8.0)
    assert closest_m(mission, hovering, passes_at(at_s, 1.5, 9.0), by_truth=by_truth) == pytest.approx(1.5, abs=0.01)


def test_layers_and_vehicles_on_the_ground_do_not_count(mission: Mission) -> None:
    assert closest_m(mission, beside(0.0, 8.0), beside(1.0, 9.7), by_truth=True) is None, "they are in layers"
    landed = closest_m(mission, beside(0.0, 8.0), passes_at(145.0, 1.0, 8.0), by_truth=True)
    assert landed == pytest.approx(np.hypot(5.0, 1.0), abs=0.15), "it was down at 140 s, 5 m before the other passed"


def test_a_vehicle_that_has_landed_does_not_count_in_the_mission_either() -> None:
    """One stands from 10 s on, where the other flies above it at 15 s; before they are 5 m apart."""
    time_s = np.arange(0.0, 20.0, 0.1)
    x_m, y_m = np.array([0.0 * time_s, time_s - 15.0]), np.zeros((2, time_s.size))
    height_m = np.array([np.where(time_s < 10.0, 8.0, 0.0), np.full(time_s.size, 8.0)])
    any_height = np.full_like(x_m, np.inf)
    assert closest_approach_m(x_m, y_m, height_m, any_height) == pytest.approx(5.0, abs=0.11)
    assert closest_approach_m(
        x_m, y_m, np.full_like(height_m, np.nan), np.full((2, time_s.size), np.inf)
    ) == pytest.approx(0.0, abs=0.01)


def test_what_happens_in_the_mission_is_left_to_its_own_figure(mission: Mission) -> None:
    found = closest_m(mission, beside(0.0, 8.0), passes_at(110.0, 1.0, 8.0), by_truth=True)
    assert found == pytest.approx(np.hypot(10.0, 1.0), abs=0.15)


def test_a_vehicle_on_its_way_home_is_apart_by_its_layer_and_the_others_are_not(mission: Mission) -> None:
    """One passes 5 m above the other, on its way home or, at a wrong height, on its way in the formation."""
    time_s = np.arange(0.0, 20.0, 0.1)
    still = np.zeros((time_s.size, 2))
    passing_m = np.column_stack((time_s - 10.0, 0.0 * time_s))
    for tactic, found_m in (("return and land", None), ("formation", 0.0)):
        flies = np.full(time_s.size, "formation"), np.full(time_s.size, tactic)
        below = VehicleTrack(1, still, still, flies[0], altitude_m=np.full(time_s.size, 8.0))
        above = VehicleTrack(2, passing_m, still, flies[1], altitude_m=np.full(time_s.size, 13.0))
        record = Journal(mission).record(0.0, 19.9, RunTotals("flight", 0, 0, 1.0))
        assert evaluated(mission, replace(record, vehicles=(below, above))).closest_approach_m == found_m
