"""Two flights side by side: what differs, who is better, and that nothing is said of what one of them lacks."""

from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console

from gcs.report.compare import ComparedFlight, Comparison, comparison_html, comparison_table, comparisons
from tests.gcs.report.test_page import Page
from tests.support.report_evidence import flown


@pytest.fixture(scope="module")
def flights() -> tuple[ComparedFlight, ComparedFlight]:
    evidence, result, asked = flown(3, duration_s=120.0, rate_hz=5.0)
    worse, *others = result.vehicles
    changed = replace(
        result,
        closest_approach_m=(result.closest_approach_m or 0.0) + 1.5,
        vehicles=(replace(worse, radius_error_rms_m=0.5, engaged_at_s=None), *others),
        verdicts=replace(result.verdicts, c1=False),
    )
    first = ComparedFlight("<i>calm</i>", result, evidence.record, asked.ring)
    return first, ComparedFlight("windy", changed, evidence.record, asked.ring)


def by_metric(first: ComparedFlight, second: ComparedFlight) -> dict[str, Comparison]:
    return {each.metric: each for each in comparisons(first, second)}


def test_differences_and_which_is_better(flights: tuple[ComparedFlight, ComparedFlight]) -> None:
    first, _ = flights
    found = by_metric(*flights)
    assert (found["closest approach [m]"].difference, found["closest approach [m]"].better) == ("+1.500", "windy")
    radius = found["vehicle 1: radius error rms [m]"]
    assert (radius.second, radius.better) == ("0.500", "<i>calm</i>")
    assert float(radius.difference) == pytest.approx(0.5 - float(radius.first))
    same = found["vehicle 2: radius error rms [m]"]
    assert (same.difference, same.better) == ("0", "")
    assert found["duration [s]"].better == ""
    apart = found["ring: nearest other, mean [m]"]
    assert apart.first == f"{first.result.reynolds.ring.separation_mean_m:.2f}"
    assert (apart.difference, apart.better) == ("0", "")


def test_swapping_the_flights_turns_the_signs_around(flights: tuple[ComparedFlight, ComparedFlight]) -> None:
    there, back = by_metric(*flights), by_metric(*reversed(flights))
    assert back["closest approach [m]"].difference == "-1.500"
    assert {name: each.better for name, each in there.items()} == {name: each.better for name, each in back.items()}


def test_a_metric_that_one_lacks_has_no_difference(flights: tuple[ComparedFlight, ComparedFlight]) -> None:
    engaged = by_metric(*flights)["vehicle 1: engaged [s]"]
    assert (engaged.first, engaged.second, engaged.difference, engaged.better) == ("45.0", "–", "–", "")


def test_the_page_is_whole_and_safe(flights: tuple[ComparedFlight, ComparedFlight]) -> None:
    page = Page(comparison_html(*flights))
    assert "http" not in page.html
    assert not page.all("i")
    assert "<i>calm</i>" in page.text
    assert page.text.count("✗ does not hold") == 1
    assert len(page.all("figure")) == 3
    assert [each["aria-label"] for each in page.all("svg") if each.get("role") == "img"] == [
        "Largest radius error of both flights over time.",
        "Largest spacing error of both flights over time.",
        "Lyapunov function of both flights over time.",
    ]


def test_flights_without_a_ring_say_so() -> None:
    evidence, result, asked = flown(3, duration_s=60.0, rate_hz=5.0, engaging=False)
    both = (ComparedFlight(name, result, evidence.record, asked.ring) for name in ("a", "b"))
    page = Page(comparison_html(*both))
    assert not page.all("figure")
    assert "Largest radius error, Largest spacing error, Lyapunov function: " in page.text


def test_the_terminal_gets_verdicts_and_metrics(flights: tuple[ComparedFlight, ComparedFlight]) -> None:
    out = StringIO()
    Console(file=out, width=140).print(comparison_table(*flights))
    lines = {line.split("  ")[0]: line.split() for line in out.getvalue().splitlines()}
    assert lines["C1"] == ["C1", "✓", "✗"]
    assert lines["closest approach [m]"][-2:] == ["+1.500", "windy"]
