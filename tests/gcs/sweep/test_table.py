"""The table holds what a single simulation reports, and the same bytes whatever the order of the runs."""

import io
import json
import sys
from dataclasses import fields, replace
from typing import Any

import pyarrow
import pyarrow.parquet
import pytest

from gcs.errors import InputError
from gcs.flight.simulated import fly_simulated
from gcs.metrics.departures import Departure
from gcs.metrics.metrics import evaluated
from gcs.metrics.result import FlightResult
from gcs.mission.file import load_mission
from gcs.sweep.columns import TEAM, Row, columns, require_pyarrow, result_row, table_bytes
from gcs.sweep.plan import SweepPlan, Tasks, planned
from gcs.sweep.variation import Variation
from gcs.sweep.workers import flown
from tests.support.result_keys import RESULT_KEYS
from tests.support.ring_flights import five_vehicles, two_rings

NEAR = {"target.start_m": [9.0, -3.0]}
LEFT_OUT = {
    "": "format mission seed source reference wall_time_s realtime_factor events estimate truth_missing faults kinds "
    "plants",
    "ended": "vehicles unaccounted still_flying",
    "ring": "judged_from_s",
    "engagement": "pending",
    "loop": "tick_p50_us tick_p99_us",
    "vehicles": "id",
    "transitions": "begins_at_s members",
    "departures": " ".join(each.name for each in fields(Departure)),
}
"""What the table does not hold of a result: what is the same in every run, wall times, and what is no figure."""


@pytest.fixture(scope="module")
def result() -> FlightResult:
    mission = load_mission("case2", NEAR)
    return evaluated(mission, fly_simulated(mission, 1, 70.0, lambda _: None))


def test_every_metric_of_a_result_has_a_column(result: FlightResult) -> None:
    names = {each.name for each in columns([result_row(result)])}
    named = {
        "": "{}",
        "vehicles": "vehicle_2.{}",
        "transitions": "transitions.{}.worst",
        "reynolds": "reynolds.{}.cohesion_max_m",
    }
    for part, keys in RESULT_KEYS.items():
        for key in {*keys.split()} - {*LEFT_OUT.get(part, "").split()} - {"window_s"}:
            if part or key not in RESULT_KEYS:
                assert named.get(part, part + ".{}").format(key) in names


def test_values_stand_under_their_places_in_the_json_result(result: FlightResult) -> None:
    plain, row = json.loads(result.to_json()), result_row(result)
    assert row["ring.settling_time_s"] == plain["ring"]["settling_time_s"] > 0.0
    assert row["reynolds.ring.cohesion_max_m"] == plain["reynolds"]["ring"]["cohesion_max_m"]
    assert [row["window_begin_s"], row["window_end_s"]] == plain["window_s"]
    assert row["vehicle_3.engaged_at_s"] == plain["vehicles"][2]["engaged_at_s"]
    assert row["verdicts.separation"] is plain["verdicts"]["separation"] is True
    assert "ring.unsettled_at_s" not in row, "what does not apply is missing"


def test_the_worst_and_the_mean_are_those_of_the_vehicles(result: FlightResult) -> None:
    row = result_row(result)
    errors = [vehicle.radius_error_rms_m or 0.0 for vehicle in result.vehicles]
    assert row["vehicles.radius_error_rms_m.worst"] == max(errors)
    assert row["vehicles.radius_error_rms_m.mean"] == pytest.approx(sum(errors) / len(errors))
    lowest = min(each.forwards_min_m_s or 0.0 for each in result.transitions)
    assert row["transitions.forwards_min_m_s.worst"] == lowest


def test_the_errors_of_every_ring_count_that_a_vehicle_was_on() -> None:
    """Vehicle 4 was on the first ring for a while, with larger errors than later on the second."""
    result = evaluated(two_rings(), five_vehicles((0.02, 0.04, 0.06, 0.08, 0.1)))
    first, second = result.rings
    former = replace(first.result.vehicles[0], id=4, radius_error_rms_m=0.5, angular_rate_error_rms_rad_s=0.2)
    changed = replace(first, result=replace(first.result, vehicles=(*first.result.vehicles, former)))
    row = result_row(replace(result, rings=(changed, second)))
    assert row["vehicle_4.radius_error_rms_m"] == pytest.approx(0.08, abs=1e-3)
    assert row["vehicles.radius_error_rms_m.worst"] == 0.5
    assert row["vehicles.radius_error_rms_m.mean"] == pytest.approx((0.3 + 0.5) / 6.0, abs=1e-3)
    assert row["vehicles.angular_rate_error_rms_rad_s.worst"] == 0.2


def test_a_row_does_not_depend_on_how_long_the_flight_took(result: FlightResult) -> None:
    slower = replace(result, wall_time_s=1e6, realtime_factor=0.1, loop=replace(result.loop, tick_p50_us=1e6))
    assert result_row(slower) == result_row(result)


@pytest.fixture(scope="module")
def swept() -> tuple[SweepPlan, dict[int, Row]]:
    """Return a sweep whose values have all kinds of types, flown here in order; one of its runs fails."""
    varied = (Variation("encirclement.radius_m", (8, 8.5)), Variation("target.velocity_m_s", ([0.1, 0.0], "x")))
    plan, faults = planned("case2", varied, (3, 4), {}, 2.0)
    tasks = Tasks(plan)
    return plan, {
        run.index: {"error": faults[run.index]} if run.index in faults else flown(tasks.of(run)) for run in plan.runs
    }


def read(content: bytes) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pyarrow.parquet.read_table(io.BytesIO(content)).to_pylist()
    return rows


def test_a_table_has_a_row_for_each_run(swept: tuple[SweepPlan, dict[int, Row]]) -> None:
    rows = read(table_bytes(*swept))
    keys = ("encirclement.radius_m", "target.velocity_m_s", "seed")
    assert [tuple(row[key] for key in keys) for row in rows] == [
        (radius, velocity, seed) for radius in (8.0, 8.5) for velocity in ("[0.1, 0.0]", "x") for seed in (3, 4)
    ]
    assert [row["error"] is None for row in rows] == 2 * [True, True, False, False]
    assert all("target.velocity_m_s" in row["error"] for row in rows if row["error"])
    assert [row["duration_s"] for row in rows] == 2 * [2.0, 2.0, None, None]
    assert [row["holds"] for row in rows] == 8 * [None], "in 2 s nothing can be judged"
    assert [row["not_judged"] for row in rows] == 2 * [*2 * ["C1, C2, C3, engaged"], None, None]
    assert {each.name for each in TEAM} < set(rows[0])


def test_equal_rows_are_equal_bytes_in_any_order(swept: tuple[SweepPlan, dict[int, Row]]) -> None:
    plan, rows = swept
    tasks = Tasks(plan)
    first = plan.runs[0]
    backwards = dict(sorted((rows | {first.index: flown(tasks.of(first))}).items(), reverse=True))
    assert table_bytes(plan, backwards) == table_bytes(plan, rows)


def test_without_pyarrow_a_message_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pip install 'cordon-gcs\[sweep\]'"):
        require_pyarrow()
