"""Charts of a report: rows are full, levels can be read, the timeline holds all, and dark pages have their colours."""

import re
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gcs.metrics.record import injected_faults
from gcs.report.charts.chart import Chart, chart, levels, logarithmic, rows_of_two
from gcs.report.charts.lanes import draw_lanes
from gcs.report.charts.onboard import draw_ticks, intervals_ms
from gcs.report.charts.panels import mark_empty
from gcs.report.evidence.flight import Reception
from gcs.report.flight_page import report_html
from gcs.report.sections import _in_wall_time, flight_of
from gcs.style import DARK
from tests.support.page.station_pictures import ring_flight
from tests.support.report_evidence import flown


def test_a_row_of_charts_is_never_half_empty() -> None:
    def drawn(*, width_in: float, missing: str = "") -> Chart:
        return chart("x", lambda axes: mark_empty(axes, missing) if missing else None, "alt", width_in=width_in)

    without = partial(drawn, missing="no data")
    for draws, beside, wide in (
        ((drawn, drawn), 0, []),
        ((drawn, drawn, drawn), 0, [0]),
        ((drawn, drawn), 1, [0]),
        ((without, drawn), 0, [1]),
    ):
        assert [index for index, each in enumerate(rows_of_two(draws, beside)) if each.is_wide] == wide


@pytest.mark.parametrize("values", [(1.0, 1.01, 1.02), (1.0, 9.5, 9.8), (0.11, 0.12, 9.0)])
def test_labels_of_levels_never_cover_each_other_and_stay_inside(values: tuple[float, ...]) -> None:
    figure = Figure(figsize=(5.0, 2.9))
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    logarithmic(axes, np.array([0.1, 6.2]), 0.1)
    levels(axes, {f"level {value:g}": value for value in values})
    figure.canvas.draw()
    boxes = sorted((text.get_window_extent() for text in axes.texts), key=lambda box: box.y0)
    assert len(boxes) == len(values)
    assert all(lower.y1 <= upper.y0 for lower, upper in pairwise(boxes))
    assert boxes[0].y0 >= axes.bbox.y0 - 1.0
    assert boxes[-1].y1 <= axes.bbox.y1 + 1.0


def test_the_timeline_holds_engagements_faults_commands_and_failsafes() -> None:
    evidence, result, criteria = flown(3, duration_s=120.0, rate_hz=5.0)
    record = replace(evidence.record, faults=injected_faults(("link-cut@70:3", "latency@75.5")))
    flight = flight_of(replace(evidence, record=record), result, criteria)
    axes = Figure().subplots()
    draw_lanes(axes, flight.sheet, flight.evidence)
    marks = {
        (float(x), round(float(y)))
        for line in axes.lines
        if line.get_marker() not in ("None", "")
        for x, y in zip(np.atleast_1d(line.get_xdata()), np.atleast_1d(line.get_ydata()), strict=True)
    }
    engaged = {(vehicle.engaged_at_s, row) for row, vehicle in enumerate(result.vehicles)}
    assert engaged | {(70.0, -1), (75.5, -1)} | {(event.time_s, 0) for event in record.events} == marks
    assert [label.get_text() for label in axes.get_yticklabels()] == ["faults", "1", "2", "3"]
    assert {"link-cut: 3", "latency"} <= {text.get_text() for text in axes.texts}


def test_the_period_and_the_intervals_of_a_fast_flight_are_wall_time() -> None:
    evidence, result, criteria = flown(2, duration_s=60.0, rate_hz=5.0)
    flight = flight_of(replace(evidence, speed=10.0), result, criteria)
    axes = Figure().subplots()
    draw_ticks(axes, flight.sheet, flight.evidence)
    drawn_us = [np.asarray(line.get_ydata(), dtype=float) for line in axes.lines]
    assert max(float(each[0]) for each in drawn_us if each.size == 2) == pytest.approx(1e6 / 5.0 / 10.0)
    assert any("20 ms" in text.get_text() for text in axes.texts)
    _, interval_ms = intervals_ms(Reception(np.array([0.0, 1.0, 3.0]), np.zeros(3)), 10.0)
    assert interval_ms == pytest.approx([100.0, 200.0])
    assert "10 times as fast as real time" in _in_wall_time(flight)
    assert _in_wall_time(flight_of(evidence, result, criteria)) == ""


def test_every_colour_of_a_chart_has_one_for_dark_pages() -> None:
    evidence, result, criteria = flown(8, duration_s=60.0, rate_hz=2.0)
    record = replace(evidence.record, faults=injected_faults(("link-cut@70:3",)))
    html = report_html(replace(evidence, record=record), result, criteria, ring_flight())
    page = html[html.index("<main>") : html.index("</main>")]
    used = {colour.upper() for colour in re.findall(r"var\(--c[0-9a-f]{6}, (#\w+)\)", page)}
    assert len(used) > 12
    assert used <= set(DARK)
    assert not re.findall(r'style="[^"]*: #', page)
