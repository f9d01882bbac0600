"""What the figure of a sweep shows, and the worst cases, of rows that are written here."""

from pathlib import Path

import numpy as np
import pytest

from gcs.sweep.columns import TEAM, Column, Row, full_rows
from gcs.sweep.figure import Picture, save_sweep_figure
from gcs.sweep.plan import SweepPlan
from gcs.sweep.summary import SweepSummary, worst_cases
from gcs.sweep.variation import Variation

pytestmark = pytest.mark.slow

C = "cordon sim 'my mission.toml'"
RADIUS, SHAPE = "encirclement.radius_m", "formation.shape"
METRICS = (
    Column("holds", bool, ""),
    *(each for each in TEAM if each.name in ("closest_approach_m", "ring.settling_time_s")),
)


@pytest.fixture
def plan() -> SweepPlan:
    variations = (Variation(RADIUS, (12, 8)), Variation(SHAPE, ("line", "a wedge")))
    return SweepPlan("", {}, {"formation.spacing_m": 6.0}, variations, (0, 1), 30.0, {})


@pytest.fixture
def rows() -> dict[int, Row]:
    """Return the rows of eight runs: the first failed, the second is the worst, the last is not flown."""
    rows: dict[int, Row] = {
        index: {"holds": True, "verdicts.C3": True, "closest_approach_m": 4.0 + index} for index in range(1, 7)
    }
    rows[0] = {"error": "it failed"}
    rows[1] |= {"holds": False, "verdicts.C3": False, "closest_approach_m": 2.5}
    rows[5] |= {"ring.settling_time_s": 9.0}
    rows[6] |= {"ring.settling_time_s": 9.5}
    return rows


def test_metrics_are_grouped_by_what_they_are_drawn_over(plan: SweepPlan, rows: dict[int, Row]) -> None:
    holds, settling, closest = METRICS
    picture = Picture("", METRICS, (RADIUS,), full_rows(plan, rows))
    assert picture.places(RADIUS) == [8, 12]
    assert picture.places(SHAPE) == ["line", "a wedge"]
    np.testing.assert_array_equal(picture.groups(closest)[12,], [2.5, 6.0, 7.0])
    np.testing.assert_array_equal(picture.groups(holds)[12,], [0.0, 1.0, 1.0], "a run without a result is neither")
    assert set(picture.groups(settling)) == {(8,)}, "what has no value is left out"


def test_runs_that_were_not_judged_do_not_pass_and_values_without_a_mission_are_set_apart(
    plan: SweepPlan, rows: dict[int, Row]
) -> None:
    holds, settling, _ = METRICS
    judged = rows[2]
    unjudged: Row = {"not_judged": "C1, C2, C3", "closest_approach_m": 5.0}
    rows |= {0: {"error": "no mission"}, 1: {"error": "no mission"}, 3: dict(unjudged), 4: dict(unjudged), 5: unjudged}
    picture = Picture("", METRICS, (RADIUS, SHAPE), full_rows(plan, rows))
    assert picture.invalid() == [(12, "line")]
    np.testing.assert_array_equal(picture.groups(holds)[12, "a wedge"], [1.0, 0.0], "one of two was judged")
    assert (8, "line") not in picture.groups(holds), "none of two was judged"
    assert picture.lacking(holds) == {(12, "a wedge"): 0.5, (8, "line"): 1.0}
    assert picture.lacking(settling) == {(12, "a wedge"): 1.0, (8, "line"): 1.0}
    assert judged["holds"] is True
    summary = SweepSummary.of(8, rows.values())
    assert summary.line == "7 of 8 runs: 2 pass, 3 not judged, 2 without a result"
    assert (summary.hold, summary.do_not_hold, summary.not_judged, summary.failed) == (2, 0, 3, 2)
    reasons = [case.reasons for case in worst_cases(plan, rows, (), "mine.toml", 1)]
    assert reasons == [("not judged: C1, C2, C3",), ("error: no mission",)]


def test_a_map_hatches_what_was_not_judged_and_leaves_what_has_no_mission_grey(
    plan: SweepPlan, rows: dict[int, Row], tmp_path: Path
) -> None:
    rows |= {0: {"error": "no mission"}, 1: {"error": "no mission"}, 6: {"closest_approach_m": 5.0}}
    drawn = {}
    for name, shown in (("all", rows), ("valid", {i: rows[i] for i in (2, 3)})):
        path = tmp_path / f"{name}.svg"
        save_sweep_figure(Picture("", METRICS[:1], (RADIUS, SHAPE), full_rows(plan, shown)), path)
        drawn[name] = path.read_text()
    for style in ("fill: url(#h", "fill: #e4e4e4"):
        assert (drawn["all"].count(style), drawn["valid"].count(style)) == (2, 0), "a cell, and the legend"


def test_figures_are_drawn_over_one_key_over_two_and_over_the_seed(
    plan: SweepPlan, rows: dict[int, Row], tmp_path: Path
) -> None:
    drawn = set()
    for over in ((RADIUS,), (SHAPE,), (RADIUS, SHAPE), ("seed",), ("seed",)):
        path = tmp_path / "sweep.svg"
        save_sweep_figure(Picture("title", METRICS, over, full_rows(plan, rows)), path)
        drawn.add(path.read_bytes())
    assert len(drawn) == 4, "the same sweep is the same picture"


def test_the_worst_cases_come_with_what_flies_them(plan: SweepPlan, rows: dict[int, Row]) -> None:
    always = "--set formation.spacing_m=6.0 --set encirclement.radius_m"
    cases = [(case.reasons, case.command) for case in worst_cases(plan, rows, METRICS, "my mission.toml", 3)]
    assert cases == [
        (
            ("worst in ring.settling_time_s (9.5)",),
            f"{C} {always}=8 --set 'formation.shape=a wedge' --seed 0 --duration 30",
        ),
        (
            ("worst in closest_approach_m (2.5)", "fails: C3"),
            f"{C} {always}=12 --set formation.shape=line --seed 1 --duration 30",
        ),
        (("error: it failed",), f"{C} {always}=12 --set formation.shape=line --seed 0 --duration 30"),
    ]
