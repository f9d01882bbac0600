"""What the figure of a sweep shows, and the worst cases, of rows that are written here."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from gcs.sweep.columns import TEAM, Column, Row, full_rows
from gcs.sweep.figure import Picture, save_sweep_figure, sweep_figure
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


def test_nothing_is_drawn_between_two_names(plan: SweepPlan, rows: dict[int, Row]) -> None:
    for over, joined in ((RADIUS, {"-"}), (SHAPE, {"None"})):
        figure = sweep_figure(Picture("", METRICS[1:2], (over,), full_rows(plan, rows)))
        medians = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
        assert {line.get_linestyle() for line in medians} == joined
        assert bool(figure.axes[0].patches) is (over == SHAPE)


def test_figures_are_drawn_over_one_key_over_two_and_over_the_seed(
    plan: SweepPlan, rows: dict[int, Row], tmp_path: Path
) -> None:
    drawn = set()
    for over in ((RADIUS,), (SHAPE,), (RADIUS, SHAPE), ("seed",), ("seed",)):
        path = tmp_path / "sweep.svg"
        save_sweep_figure(Picture("title", METRICS, over, full_rows(plan, rows)), path)
        drawn.add(path.read_bytes())
    assert len(drawn) == 4, "the same sweep is the same picture"


LONG = "draw.a_rather_long_parameter_of_a_study_m_s2"
LONG_METRIC = Column("a_metric_with_a_name_that_is_so_long_that_it_needs_two_lines_in_every_panel_m_s", float, "")
MANY = (Column("holds", bool, ""), METRICS[1], LONG_METRIC, METRICS[2])


def drawn_rows() -> list[Row]:
    """Return the rows of 400 runs with values drawn from ranges."""
    random = np.random.default_rng(0)
    return [
        {
            RADIUS: float(random.uniform(8.0, 14.0)),
            LONG: float(random.uniform(0.0, 0.3)),
            "planner": f"a planner with a long name, number {index % 2}",
            "mission": f"a-mission-with-a-long-name-{index % 7}",
            "holds": bool(random.random() > 0.2),
            **{each.name: float(1e4 * random.random()) for each in MANY[1:]},
        }
        for index in range(400)
    ]


def test_drawn_values_are_taken_together_in_parts_of_the_same_size() -> None:
    rows = drawn_rows()
    picture = Picture("", MANY, (RADIUS,), rows).together()
    places = [float(place) for place in picture.places(RADIUS)]
    groups = [picture.groups(MANY[1])[place,] for place in places]
    assert 4 <= len(places) <= 12
    assert max(map(len, groups)) - min(map(len, groups)) <= 1
    in_order = [float(row[MANY[1].name]) for row in sorted(rows, key=lambda row: float(row[RADIUS]))]
    assert [sorted(group) for group in groups] == [
        sorted(part) for part in np.split(np.array(in_order), np.cumsum([len(group) for group in groups])[:-1])
    ]
    few = Picture("", MANY, (RADIUS,), [row | {RADIUS: float(index % 8)} for index, row in enumerate(rows)])
    assert few.together().rows == few.rows, "values that were given stay as they are"


@pytest.mark.parametrize(
    ("over", "apart"),
    [((RADIUS,), ("planner",)), ((LONG, RADIUS), ()), (("mission",), ()), (("planner", "mission"), ())],
)
@pytest.mark.parametrize("metrics", [MANY, (LONG_METRIC,)])
def test_no_text_is_cut_and_no_numbers_overlap(
    over: tuple[str, ...], apart: tuple[str, ...], metrics: tuple[Column, ...]
) -> None:
    title = "a-mission-with-a-long-name, " * 5 + "400 runs: 210 pass, 100 fail (C1 20, C2 40, C3 100), 90 not judged"
    figure = sweep_figure(Picture(title, metrics, over, drawn_rows(), apart))
    figure.canvas.draw()
    used, (width_in, height_in) = figure.get_tightbbox(), figure.get_size_inches()
    assert min(used.x0, used.y0) >= -0.01
    assert used.x1 <= width_in + 0.01
    assert used.y1 <= height_in + 0.01
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
            labels = [label for tick in ticks for label in (tick.label1, tick.label2)]
            require_apart(
                [each for each in labels if each.get_text() and each.get_visible() and not each.get_rotation()]
            )
        require_apart(axes.texts)


def require_apart(texts: Sequence[Text]) -> None:
    for one, other in combinations(texts, 2):
        assert not one.get_window_extent().overlaps(other.get_window_extent()), (one, other)


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
