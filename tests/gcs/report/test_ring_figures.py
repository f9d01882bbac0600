"""Summaries, figures and report sections of flights over several rings: each ring by its name."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.patches import Polygon
from rich.console import Console

from gcs.console.summary import summary
from gcs.metrics.metrics import evaluated
from gcs.metrics.references import ring_references
from gcs.report.charts.panels import landmarks_m, sheet_of
from gcs.report.evidence.criteria import criteria_of
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.figure import drawn_figure
from gcs.report.sections import flight_of, sections
from gcs.report.summary import ring_paragraph, verdicts
from gcs.style import COLOURS
from tests.support.ring_flights import RADII_M, five_vehicles, one_changes, target_path, two_rings

MISSION = two_rings()


def test_the_terminal_names_each_ring_with_its_vehicles_and_its_worst_figures() -> None:
    console = Console(width=200)
    with console.capture() as shown:
        console.print(summary(evaluated(MISSION, five_vehicles())))
    text = shown.get()
    assert "east about car: vehicles 1, 2 and 3; ring judged over 500.0 s" in text
    assert "north about boat: vehicles 4 and 5; ring judged over 500.0 s" in text
    assert "east error 0.060 m rms; north error 0.100 m rms" in text


def test_the_page_draws_every_target_every_ring_and_its_vehicles_in_their_colours() -> None:
    record = five_vehicles()
    result, rings = evaluated(MISSION, record), ring_references(MISSION, record)
    figure = drawn_figure(record, result, rings)
    titled = {axes.get_title(loc="left"): axes for axes in figure.axes}
    paths = titled["case2: paths"]
    assert {"east", "north", "car", "boat"} <= {text.get_text() for text in paths.texts}
    ends_m = [target_path(number).position_m[-1].round(6).tolist() for number in (0, 1)]
    drawn = [each for each in paths.patches if isinstance(each, Polygon)]
    for ring, end_m, radius_m in zip(drawn, ends_m, RADII_M, strict=True):
        assert np.hypot(*(ring.get_xy() - end_m).T) == pytest.approx(radius_m)
    lines = {line.get_label(): line for line in titled["north: radius"].lines}
    assert {label for label in lines if str(label).startswith("vehicle")} == {"vehicle 4", "vehicle 5"}
    assert lines["vehicle 5"].get_color() == COLOURS[4]
    np.testing.assert_allclose(np.asarray(lines["vehicle 5"].get_ydata())[-1], RADII_M[1] + 0.1)
    for end_m, radius_m in zip(ends_m, RADII_M, strict=True):
        for landmark_m in (np.subtract(end_m, radius_m), np.add(end_m, radius_m)):
            shown_m = landmarks_m(sheet_of(record, result, rings))
            assert np.isclose(shown_m, landmark_m).all(axis=1).any()


def test_a_ring_named_as_its_target_has_one_label_which_is_above_it_and_inside_the_map() -> None:
    record, mission = five_vehicles(), two_rings()
    named = replace(
        mission, rings=tuple(replace(each, name=n) for each, n in zip(mission.rings, ("car", "boat"), strict=True))
    )
    result, rings = evaluated(named, record), ring_references(named, record)
    figure = drawn_figure(record, result, rings, number=4)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    labels = [text for text in axes.texts if text.get_text() in ("car", "boat")]
    assert sorted(label.get_text() for label in labels) == ["boat", "car"]
    for label, number in zip(labels, (0, 1), strict=True):
        box, top_m = label.get_window_extent(), target_path(number).position_m[-1] + (0.0, RADII_M[number])
        # A vehicle at the ring's top is drawn as a diamond, 12 points wide from edge to edge.
        assert box.y0 >= axes.transData.transform(top_m)[1] + 6.0 * 2.0**0.5 * figure.dpi / 72.0 - 0.5
        assert box.y1 <= axes.bbox.y1
    assert "car about car" not in ring_paragraph(result.rings[0], criteria_of(named, record).of_ring(0))


def test_the_formation_marks_no_engagement_of_a_vehicle_that_left_it_before() -> None:
    record = one_changes()
    in_transit = replace(record.vehicles[4], tactic=record.vehicles[4].tactic.copy())
    engaged = in_transit.tactic == "encircle"
    in_transit.tactic[np.flatnonzero(engaged)[0] - 50 : np.flatnonzero(engaged)[0]] = "transit"
    flight = replace(record, vehicles=(*record.vehicles[:4], in_transit))
    figure = drawn_figure(flight, evaluated(MISSION, flight), ring_references(MISSION, flight))
    speeds = next(each for each in figure.axes if each.get_title(loc="left") == "Speed in formation")
    marks = [line for line in speeds.lines if line.get_marker() == "o"]
    assert [mark.get_color() for mark in marks] == list(COLOURS[:4])


@pytest.mark.parametrize(("number", "panels"), [(1, 1), (2, 1), (3, 4), (6, 2)])
def test_a_figure_of_the_paper_has_its_panels_for_each_ring(number: int, panels: int) -> None:
    record = five_vehicles()
    figure = drawn_figure(record, evaluated(MISSION, record), ring_references(MISSION, record), None, number)
    assert len(figure.axes) == panels


def test_the_report_has_a_section_for_each_ring_and_its_verdicts_by_ring() -> None:
    record = one_changes()
    result, criteria = evaluated(MISSION, record), criteria_of(MISSION, record)
    shown = {each.title: each for each in sections(flight_of(FlightEvidence(record, (), {}), result, criteria))}
    assert [title for title in shown if title.startswith("Ring")] == ["Ring east", "Ring north"]
    assert "Lyapunov function" not in shown
    titles = [each.title for each in shown["Ring north"].drawn]
    assert {"north: radius", "north: spacing", "north: radius error", "north: Lyapunov function"} <= set(titles)
    assert [row[0] for row in shown["Ring north"].tables[0].rows] == ["3", "4", "5"]
    radius = verdicts(result, criteria)[0]
    assert [measured.partition(":")[0] for measured, _ in radius.evidence] == ["east", "east", "north", "north"]


def test_a_ring_that_was_not_flown_says_so() -> None:
    record = five_vehicles()
    east = replace(record, vehicles=record.vehicles[:3])
    result, criteria = evaluated(MISSION, east), criteria_of(MISSION, east)
    shown = sections(flight_of(FlightEvidence(east, (), {}), result, criteria))
    assert next(each for each in shown if each.title == "Ring north").missing == ("No vehicle was on this ring.",)
    assert landmarks_m(sheet_of(east, result, criteria.rings)).shape[1] == 2
