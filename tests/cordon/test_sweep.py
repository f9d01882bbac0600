"""Sweeps from Python, compared with flights of cordon.simulate one by one."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

import cordon
from gcs.sweep.columns import result_row
from gcs.sweep.draws import drawn_values, random_of
from tests.support.wire import PATIENCE_S

pytestmark = pytest.mark.slow

RADIUS, GUST = "encirclement.radius_m", "draw.gust_m_s2"
DURATION_S = 6.0


class Waiting:
    """Holds its place."""

    def __init__(self, config: cordon.AgentConfig) -> None:
        self._home_m = np.array(config.home_m)

    def plan(self, task: cordon.Task) -> cordon.Plan | None:
        return cordon.Plan(self._home_m, self._home_m, np.zeros(2))


def wind(gust_m_s2: float, seed: int) -> Sequence[cordon.Disturbance]:
    return [cordon.Disturbance(1.0 + 0.1 * (seed % 5), (0.0, gust_m_s2), until_s=4.0)]


def other(seed: int) -> Mapping[int, cordon.Plant]:
    axis = cordon.PlantAxis(0.5 + 0.1 * (seed % 3), 1.0)
    return {2: cordon.Plant(axis, axis, delay_s=0.1)}


def random_wind(draw: cordon.Draw) -> Sequence[cordon.Disturbance]:
    return [cordon.Disturbance(1.0, (0.0, draw.values[GUST] * draw.random.uniform(0.5, 1.5)))]


def far_m(flight: cordon.Flight) -> float:
    return float(np.abs(flight.vehicles[2].position_m).max())


def swept(jobs: int, folder: Path | None = None, runs: int = 3) -> cordon.SweepResult:
    return cordon.sweep(
        {"plain": "case1", "field": cordon.load("case2-field")},
        runs=runs,
        vary={RADIUS: cordon.Range(8.0, 14.0), GUST: [0.1, 0.5]},
        seed=4,
        duration_s=DURATION_S,
        plants=lambda draw: other(draw.seed),
        events=lambda draw: wind(draw.values[GUST], draw.seed),
        planners={"cordon": None, "waiting": Waiting},
        metrics={"far_m": far_m, "end_s": lambda flight: flight.record.time_s[-1]},
        series=folder,
        jobs=jobs,
    )


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sweep") / "series"


@pytest.fixture(scope="module")
def result(series: Path) -> cordon.SweepResult:
    return swept(2, series)


def test_a_row_is_the_flight_that_simulate_flies(result: cordon.SweepResult) -> None:
    table = result.table
    assert len(result) == 3 * 2 * 2
    assert table["planner"].tolist() == 6 * ["cordon", "waiting"]
    assert table["mission"].tolist() == 3 * ["plain", "plain", "field", "field"]
    for row in range(len(result)):
        name = {"plain": "case1", "field": "case2-field"}[str(table["mission"][row])]
        seed = int(table["seed"][row])
        flown = cordon.simulate(
            cordon.load(name, {RADIUS: float(table[RADIUS][row])}),
            seed=seed,
            duration_s=DURATION_S,
            planner=Waiting if table["planner"][row] == "waiting" else None,
            plants=other(seed),
            events=wind(float(table[GUST][row]), seed),
        )
        expected = result_row(flown.metrics) | {"far_m": far_m(flown), "end_s": DURATION_S}
        for column in {*table} - {"mission", "planner", "seed", "series", RADIUS, GUST}:
            value = expected.get(column, "" if table[column].dtype.kind == "U" else np.nan)
            np.testing.assert_array_equal(table[column][row], value, err_msg=f"row {row}: {column}")
        assert {*expected} <= {*table}
        np.testing.assert_array_equal(result.flight(row).vehicles[2].position_m, flown.vehicles[2].position_m)


def test_missions_and_planners_have_the_same_draws(result: cordon.SweepResult) -> None:
    for key in (RADIUS, GUST, "seed"):
        of_draws = result.table[key].reshape(3, 4)
        assert (of_draws == of_draws[:, :1]).all(), key
        assert key == GUST or len({*of_draws[:, 0].tolist()}) == 3


def test_the_table_and_the_series_are_the_same_with_one_worker(
    result: cordon.SweepResult, series: Path, tmp_path: Path
) -> None:
    alone = swept(1, tmp_path)
    assert [*alone.table] == [*result.table]
    for name, column in result.table.items():
        np.testing.assert_array_equal(alone.table[name], column, err_msg=name)
    for name in result.table["series"]:
        assert (tmp_path / name).read_bytes() == (series / name).read_bytes()


def test_series_are_the_channels(result: cordon.SweepResult, series: Path) -> None:
    frame = result.flight(5).frame().drop(columns="tick_us")
    read = pyarrow.parquet.read_table(series / str(result.table["series"][5])).to_pandas()
    assert [*read.columns] == [*frame.columns]
    for name in frame.columns:
        np.testing.assert_array_equal(read[name].to_numpy(), frame[name].to_numpy(), err_msg=name)


def test_the_summary_counts_and_the_figure_shows_the_groups(result: cordon.SweepResult, tmp_path: Path) -> None:
    lines = result.summary().splitlines()
    assert lines[0].split() == ["mission", "planner", "runs", "pass", "failed", "far_m", "end_s"]
    of_group = result.table["far_m"][(result.table["mission"] == "field") & (result.table["planner"] == "waiting")]
    assert f"{np.median(of_group):.3g}" in lines[2].split()[5:6]
    assert lines[2].split()[:5] == ["field", "waiting", "3", "0", "0"]
    figure = result.plot(tmp_path / "sweep.png")
    assert (tmp_path / "sweep.png").stat().st_size > 10_000
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sum(label.startswith("median: ") for label in labels) == 4
    np.testing.assert_array_equal(result.frame()["far_m"].to_numpy(), result.table["far_m"])
    with pytest.raises(cordon.InputError, match="far_m"):
        result.summary(metrics=["far"])


def test_designs_fill_the_ranges() -> None:
    vary = {"a.x": cordon.Range(8.0, 14.0), "a.y": cordon.Range(0.01, 100.0, logarithmic=True), "a.z": ["p", "q"]}
    for sampling, per_half in (("lhs", 8), ("sobol", 8)):
        drawn = [values for _, values in drawn_values(vary, sampling, 16, 1)]
        shares = [(each["a.x"] - 8.0) / 6.0 for each in drawn]
        decades = [(np.log10(each["a.y"]) + 2.0) / 4.0 for each in drawn]
        for column in (shares, decades):
            assert sorted(int(16 * share) for share in column) == list(range(16)), "one in each stratum"
        assert sum(each["a.z"] == "p" for each in drawn) == per_half
    at_random = [values["a.x"] for _, values in drawn_values(vary, "random", 400, 1)]
    assert np.mean(at_random) == pytest.approx(11.0, abs=4.0 * 6.0 / np.sqrt(12.0 * 400.0))
    assert at_random != [values["a.x"] for _, values in drawn_values(vary, "random", 400, 2)]
    grid = drawn_values({"a.x": [1, 2], "a.y": np.array([3.5, 4.5])}, "grid", 2, 1)
    assert grid == [(k, {"a.x": x, "a.y": y}) for x in (1, 2) for y in (3.5, 4.5) for k in (0, 1)]
    assert {type(values["a.y"]) for _, values in grid} == {float}


def test_given_draws_share_seeds_and_random_numbers() -> None:
    found = cordon.sweep(
        "case1",
        vary=[{GUST: 0.2}, {GUST: 0.4}, {GUST: 0.2}],
        runs=2,
        duration_s=3.0,
        events=random_wind,
        metrics={"off_m": lambda flight: flight.vehicles[2].position_m[-1, 1]},
        jobs=1,
    )
    assert found.table[GUST].tolist() == [0.2, 0.2, 0.4, 0.4, 0.2, 0.2]
    seeds, off_m = found.table["seed"].tolist(), found.table["off_m"].tolist()
    assert seeds[:2] == seeds[2:4] == seeds[4:]
    assert seeds[0] != seeds[1]
    assert off_m[:2] == off_m[4:] != off_m[2:4]
    assert off_m[0] != off_m[1], "missions without noise differ by what is drawn alone"
    one, same, later, plants = (random_of(*key).random() for key in ((1, 0, 1), (1, 0, 1), (1, 1, 1), (1, 0, 0)))
    assert one == same
    assert len({one, later, plants}) == 3


def test_a_given_metric_without_a_value_is_a_column_of_nan() -> None:
    found = cordon.sweep("case1", duration_s=1.0, metrics={"never_s": lambda _: np.nan}, jobs=1)
    assert np.isnan(found.table["never_s"]).all()
    assert found.summary().splitlines()[1].endswith("–")


def test_a_run_that_fails_is_a_row_with_its_error() -> None:
    with pytest.warns(UserWarning, match=r"1 run failed: .*radius"):
        found = cordon.sweep("case1", vary={RADIUS: [10.0, -3.0]}, sampling="grid", duration_s=1.0, jobs=1)
    assert found.table["error"][0] == ""
    assert RADIUS in found.table["error"][1]
    assert np.isfinite(found.table["closest_approach_m"]).tolist() == [True, False]
    assert repr(found).endswith("1 without a result>")
    with pytest.warns(UserWarning, match="'bad' raised ZeroDivisionError"):
        broken = cordon.sweep("case1", duration_s=1.0, metrics={"bad": lambda _: 1 / 0}, jobs=1)
    assert "closest_approach_m" not in broken.table
    with pytest.warns(UserWarning, match="1 run failed: KeyError: 'draw.absent'"):
        half = cordon.sweep(
            "case1",
            vary=[{GUST: 0.0}, {GUST: 0.1}],
            duration_s=1.0,
            events=lambda draw: [draw.values["draw.absent"]] if draw.values[GUST] else [],
            jobs=1,
        )
    assert [bool(error) for error in half.table["error"]] == [False, True]


SCRIPT = """
import cordon

own = 2.0


def count(flight):
    with open("flown", "a") as file:
        file.write(".")
    return own


found = cordon.sweep("case1", runs=2000, duration_s=20.0, jobs=2, metrics={"own": count})
print(len(found), found.table["own"].min(), found.table["own"].max(), *set(found.table["error"].tolist()))
"""


def test_a_script_needs_no_guard_and_ctrl_c_keeps_what_is_finished(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(SCRIPT)
    flown = tmp_path / "flown"
    with subprocess.Popen(
        [sys.executable, "study.py"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    ) as process:
        until_s = time.monotonic() + PATIENCE_S
        while not (flown.exists() and flown.stat().st_size >= 8) and time.monotonic() < until_s:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    count, *rest = out.split()
    assert 4 <= int(count) <= flown.stat().st_size < 2000
    assert rest == ["2.0", "2.0"]
    assert "UserWarning: interrupted: " in err


@pytest.mark.parametrize(
    ("arguments", "facts"),
    [
        ({"runs": 0}, ("runs", "0")),
        ({"seed": -1}, ("seed", "-1")),
        ({"sampling": "halton"}, ("sampling", "'halton'", "sobol")),
        ({"vary": {RADIUS: 3.0}}, (RADIUS, "3.0", "cordon.Range")),
        ({"vary": {RADIUS: cordon.Range(9.0, 8.0)}}, (RADIUS, "low")),
        ({"vary": {RADIUS: cordon.Range(0.0, 8.0, logarithmic=True)}}, (RADIUS, "above 0")),
        ({"vary": {RADIUS: cordon.Range(7.0, 8.0)}, "sampling": "grid"}, (RADIUS, "lists")),
        ({"vary": {"encirclement.radius": [3.0]}}, ("encirclement.radius", "radius_m")),
        ({"vary": [{RADIUS: 9.0}, {GUST: 9.0}]}, ("vary", "same keys")),
        ({"planners": {}}, ("planners",)),
        ({"planners": {"mine": 3}}, ("planners", "'mine'", "3")),
        ({"metrics": {"holds": far_m}}, ("metrics", "'holds'")),
        ({"metrics": {"mine": 3}}, ("metrics", "'mine'", "3")),
        ({"metrics": {"mine": threading.Lock().acquire}}, ("processes", "cannot be")),
        ({"jobs": 0}, ("jobs", "0")),
        ({"series": __file__}, ("series",)),
        ({"series": Path(__file__).parent}, ("series", "new folder")),
    ],
)
def test_bad_input_is_named(arguments: dict[str, object], facts: tuple[str, ...]) -> None:
    with pytest.raises(cordon.InputError) as raised:
        cordon.sweep("case1", duration_s=1.0, **arguments)  # type: ignore[arg-type]
    for fact in facts:
        assert fact in str(raised.value)


def test_missions_have_names_of_their_own() -> None:
    with pytest.raises(cordon.InputError, match="same name"):
        cordon.sweep(["case1", "case1"])
    with pytest.raises(cordon.InputError, match="at least one"):
        cordon.sweep([])


def test_without_cloudpickle_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cloudpickle", None)
    with pytest.raises(cordon.InputError, match=r"pip install 'cordon-gcs\[sweep\]'"):
        cordon.sweep("case1")
