"""Flights side by side: what differs, who is best, and that nothing is said of what one of them lacks."""

from dataclasses import replace

import pytest

from gcs.metrics.result import FlightResult
from gcs.metrics.ring import ring_motion
from gcs.mission.file import load_mission
from gcs.report.charts.panels import Sheet
from gcs.report.compare import (
    ComparedFlight,
    Comparison,
    comparison_dict,
    comparison_html,
    comparisons,
    draw_compared_error,
    mission_differences,
    remarks,
)
from tests.gcs.report.test_page import Page
from tests.support.report_evidence import flown


def compared(name: str, count: int = 3, *, mission: str = "case2", engaging: bool = True) -> ComparedFlight:
    evidence, result, asked = flown(count, duration_s=120.0, rate_hz=5.0, engaging=engaging)
    record = evidence.record
    return ComparedFlight(name, load_mission(mission), Sheet(record, result, asked.ring, None, ring_motion(record)))


def changed(flight: ComparedFlight, name: str, **changes: object) -> ComparedFlight:
    result: FlightResult = replace(flight.result, **changes)  # type: ignore[arg-type]
    return ComparedFlight(name, flight.mission, replace(flight.sheet, result=result))


@pytest.fixture(scope="module")
def flights() -> tuple[ComparedFlight, ...]:
    first = compared("<i>calm</i>")
    result, closest_m = first.result, first.result.closest_approach_m or 0.0
    worse, *others = result.vehicles
    off = replace(worse, radius_error_rms_m=0.5, engaged_at_s=None)
    failed = replace(result.verdicts, c1=False)
    windy = changed(
        first, "windy", closest_approach_m=closest_m + 1.5, vehicles=(off, *others), verdicts=failed, seed=8
    )
    return first, windy, changed(first, "dense", closest_approach_m=closest_m - 1.0)


def by_metric(flights: tuple[ComparedFlight, ...]) -> dict[str, Comparison]:
    return {each.metric: each for each in comparisons(flights)}


def test_spreads_and_which_is_best(flights: tuple[ComparedFlight, ...]) -> None:
    found, first = by_metric(flights), flights[0].result
    assert (found["closest approach [m]"].spread, found["closest approach [m]"].best) == ("2.500", "windy")
    radius = found["vehicle 1: radius error rms [m]"]
    assert radius.values[1] == "0.500"
    assert float(radius.spread) == pytest.approx(0.5 - float(radius.values[0]))
    assert radius.best == "<i>calm</i>, dense", "both are equally good"
    same = found["vehicle 2: radius error rms [m]"]
    assert (same.spread, same.best) == ("0", "")
    assert found["duration [s]"].best == ""
    assert found["ring: nearest other, mean [m]"].values[0] == f"{first.reynolds.ring.separation_mean_m:.2f}"


def test_a_metric_that_one_alone_has_is_not_compared(flights: tuple[ComparedFlight, ...]) -> None:
    engaged = by_metric(flights[:2])["vehicle 1: engaged [s]"]
    assert (engaged.values, engaged.spread, engaged.best) == (("45.0", "–"), "–", "")


def test_teams_of_other_sizes_have_their_own_rows_and_a_remark() -> None:
    flights = compared("three"), compared("two", 2)
    assert by_metric(flights)["vehicle 3: engaged [s]"].values[1] == "–"
    (remark,) = remarks(flights)
    assert "three: 1, 2, 3" in remark
    assert "two: 1, 2" in remark


def test_times_begin_at_the_first_engagement() -> None:
    from matplotlib.figure import Figure

    early, late = compared("early"), compared("late")
    shifted = replace(late.sheet.record, time_s=late.sheet.record.time_s + 7.0)
    vehicles = tuple(replace(each, engaged_at_s=(each.engaged_at_s or 0.0) + 7.0) for each in late.result.vehicles)
    result = replace(late.result, vehicles=vehicles)
    late = ComparedFlight("late", late.mission, replace(late.sheet, record=shifted, result=result))
    assert (early.engaged_at_s, late.engaged_at_s) == (45.0, 52.0)
    axes = Figure().subplots()
    draw_compared_error(axes, (early, late), "radius")
    one, other = (line.get_xydata() for line in axes.lines)
    assert one == pytest.approx(other, nan_ok=True), "the same flight, seven seconds later"


def test_missions_differ_where_their_values_do() -> None:
    plain = load_mission("case2")
    other = load_mission(
        "case2",
        {
            "encirclement.radius_m": 12.0,
            "tuning.encirclement.rate_weight": 21.0,
            "vehicles[1].start_m": [0.5, 0.0],
            "mission.seed": 0,
        },
    )
    places = {each.place: each.values for each in mission_differences([plain, other, plain])}
    assert places == {
        "encirclement.radius_m": (10.0, 12.0, 10.0),
        "tuning.encirclement.rate_weight": (plain.encirclement.rate_weight, 21.0, plain.encirclement.rate_weight),
        "vehicles[1].start_m": ([0.0, 0.0], [0.5, 0.0], [0.0, 0.0]),
    }, "a key set to its default is the same as one left out"


def test_json_holds_names_results_and_what_differs(flights: tuple[ComparedFlight, ...]) -> None:
    told = comparison_dict(flights)
    assert told["names"] == ["<i>calm</i>", "windy", "dense"]
    assert [each["seed"] for each in told["flights"]] == [7, 8, 7]
    assert told["differences"] == {"seed": [7, 8, 7]}
    assert told["engaged_at_s"] == [45.0, 50.0, 45.0], "of windy, vehicle 2 was the first"


def test_the_page_is_whole_and_safe(flights: tuple[ComparedFlight, ...]) -> None:
    page = Page(comparison_html(flights))
    assert "http" not in page.html
    assert not page.all("i")
    assert "<i>calm</i>" in page.text
    assert page.text.count("✗ fails") == 1
    assert [each["aria-label"] for each in page.all("svg") if each.get("role") == "img"] == [
        "Map of the paths of all flights.",
        "Largest radius error of all flights over the time since the first engagement.",
        "Largest spacing error of all flights over the time since the first engagement.",
        "Lyapunov function of all flights over the time since the first engagement.",
    ]


def test_flights_without_a_ring_say_so() -> None:
    both = compared("a", engaging=False), compared("b", engaging=False)
    page = Page(comparison_html(both))
    assert len(page.all("figure")) == 1, "the paths"
    assert "Largest radius error, Largest spacing error, Lyapunov function: no vehicle engaged" in page.text
    assert all(f"{name}: no vehicle engaged" in page.text for name in "ab")
    assert "The missions are the same." in page.text
