"""A report, opened from a file: nothing is fetched, and its replay and its charts show what the simulator knows."""

import json
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from playwright.sync_api import FrameLocator, Locator, Page, expect

from gcs.cli.report import ReportOptions, report
from gcs.flightlog.reader import read_log
from gcs.metrics.record import FlightRecord
from gcs.report.evidence.reading import read_flight
from tests.station.conftest import NO_WEBGL, OpenPage
from tests.support.flight_logs import engaging, record_simulation
from tests.support.wire import repeated_now

pytestmark = pytest.mark.browser
DURATION_S, RATE_HZ = 60.0, 5.0
OFF_MAX_M = 0.5
"""The page shows estimates, in steps of 0.2 s: noise, and 0.2 m of way."""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[FlightRecord, Path]:
    """The truth of a simulated flight, and its report."""
    log = tmp_path_factory.mktemp("report") / "flight.mcap"
    html = log.with_suffix(".html")
    mission = engaging("case2", (("target", "start_m"), [13.0, -5.0]), (("safety", "keep_out_m"), 4.0))
    record_simulation(mission, log, duration_s=DURATION_S)
    report([log], options=ReportOptions(html=html))
    record = read_flight([read_log(log)]).evidence.record
    assert record.reference == "truth"
    return record, html


OpenReport = Callable[[str], Page]


@pytest.fixture
def open_report(flown: tuple[FlightRecord, Path], open_page: OpenPage) -> Iterator[OpenReport]:
    """Return what opens the report from its file, beside a script; it asks for nothing else."""
    url, asked = flown[1].as_uri(), list[str]()

    def open_it(script: str) -> Page:
        page = open_page("about:blank", script=script, viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
        page.on("request", lambda request: asked.append(request.url))
        page.on("websocket", lambda socket: asked.append(socket.url))
        page.goto(url)
        return page

    yield open_it
    assert [each for each in asked if not each.startswith(("blob:", "data:", "about:"))] == [url]


def replay_of(page: Page) -> FrameLocator:
    frame = page.frame_locator("#replay iframe")
    expect(frame.locator("#seek-time")).to_have_text("0:00 of 1:00")
    return frame


def seek(replay: FrameLocator, time_s: float) -> None:
    slider = "(node, place) => { node.value = place; node.dispatchEvent(new Event('input')); }"
    replay.locator("#seek").evaluate(slider, round(time_s * RATE_HZ))


def shown(replay: FrameLocator) -> dict[int, tuple[str, float, float]]:
    """Return tactic and place of every vehicle, as the table shows them."""
    rows = [row.locator("th, td").all_inner_texts() for row in replay.locator("#table tbody tr").all()]
    metres = [[float(cell.removesuffix("m").strip().replace("−", "-")) for cell in cells[2:4]] for cells in rows]
    return {int(cells[0]): (cells[1], x, y) for cells, (x, y) in zip(rows, metres, strict=True)}


def test_without_webgl_the_table_shows_where_the_vehicles_were_and_the_charts_their_values(
    open_report: OpenReport, flown: tuple[FlightRecord, Path]
) -> None:
    record, _ = flown
    page = open_report(NO_WEBGL)
    replay = replay_of(page)
    expect(replay.locator("#table")).to_be_visible()
    expect(replay.locator("#rate")).to_have_text("5 pictures a second")
    tactics = set()
    for time_s in (2.0, 15.0, 50.0):
        seek(replay, time_s)
        at = int(np.searchsorted(record.time_s, time_s - 1e-6))
        for track in record.vehicles:
            tactic, *place_m = shown(replay)[track.vehicle_id]
            near = slice(at - 2, at + 3)
            assert tactic in track.tactic[near]
            assert np.hypot(*(np.array(place_m) - track.position_m[near]).T).min() < OFF_MAX_M
            tactics.add(tactic)
    assert tactics >= {"formation", "encircle"}
    seek(replay, 0.0)
    events = [event for event in record.events if event.time_s > 0.0]
    assert len(events) >= 2
    for event in events:
        replay.get_by_role("button", name="To the next event").click()
        after_s = float(replay.locator("#seek").input_value()) / RATE_HZ
        assert event.time_s - 0.01 <= after_s <= event.time_s + 1.0 / RATE_HZ + 0.01
        expect(replay.locator("#events li .text").first).to_have_text(f"Vehicle {event.vehicle}: {event.text}")
    assert_charts_show_values(page, record)


def test_it_plays_on_the_map_and_is_not_printed(open_report: OpenReport) -> None:
    """The report is dark where the system is, but not on paper, and fits a phone."""
    page = open_report("")
    replay = replay_of(page)
    expect(replay.locator(".symbol[data-vehicle]")).to_have_count(3)
    seek(replay, 50.0)
    # The keep-out area, of the target alone: 12 % of #a3160c on #f6f7f8.
    area = np.array([236.0, 220.0, 220.0]) / 255.0

    def attempt() -> None:
        drawn = imread(BytesIO(replay.locator("#map").screenshot()))[:, :, :3]
        assert (np.abs(drawn - area).max(axis=2) < 3.0 / 255.0).sum() > 500

    def ground() -> str:
        return str(page.evaluate("getComputedStyle(document.body).backgroundColor"))

    repeated_now(attempt)
    replay.locator("#speed").select_option("20")
    replay.get_by_role("button", name="Play").click()
    expect(replay.locator("#seek-time")).to_have_text("1:00 of 1:00")
    expect(replay.locator("#ending")).to_have_text("Flight over: Flown to the end of the simulation")
    page.emulate_media(color_scheme="dark")
    assert ground() == "rgb(20, 24, 29)"
    page.emulate_media(color_scheme="dark", media="print")
    assert ground() == "rgb(255, 255, 255)"
    expect(page.locator("#replay")).to_be_hidden()
    expect(page.locator("#verdicts")).to_be_visible()
    page.emulate_media(media="screen")
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_without_scripts_the_report_is_whole_and_says_so(flown: tuple[FlightRecord, Path], open_page: OpenPage) -> None:
    page = open_page(flown[1].as_uri(), java_script_enabled=False)
    expect(page.locator("#replay")).to_have_text("The replay is missing: this browser runs no scripts here.")
    expect(page.locator("#replay iframe")).to_be_hidden()
    assert page.locator("main > section").count() == 15
    expect(page.locator("#paper figure").first).to_be_visible()


def test_a_browser_that_cannot_unpack_it_says_so(flown: tuple[FlightRecord, Path], open_page: OpenPage) -> None:
    page = open_page(flown[1].as_uri(), script="delete globalThis.DecompressionStream;")
    expect(page.locator("#replay")).to_contain_text("The replay is missing: this browser cannot open it")
    expect(page.locator("#verdicts")).to_be_visible()


RADII = "Radius about the target (figure 3, 5)"


def pointing(figure: Locator) -> Callable[[float], tuple[float, float]]:
    """Return where on the screen a time is, in the middle of a chart's axes."""
    svg = figure.locator("svg")
    screen, view = svg.bounding_box(), (svg.get_attribute("viewBox") or "").split()
    scale = json.loads(svg.locator("[data-axes]").get_attribute("data-axes") or "")
    assert screen is not None
    pixels = screen["width"] / float(view[2])
    left, top, right, bottom = scale["box"]
    begin_s, end_s = scale["time_s"]

    def at(time_s: float) -> tuple[float, float]:
        x = left + (time_s - begin_s) / (end_s - begin_s) * (right - left)
        return screen["x"] + pixels * x, screen["y"] + pixels * (top + bottom) / 2.0

    return at


def assert_true_radii(figure: Locator, record: FlightRecord, time_s: float) -> None:
    """Fail unless the values under the pointer are those at a time."""
    first, *lines = figure.locator("output").inner_text().splitlines()
    assert float(first.removesuffix(" s")) == pytest.approx(time_s, abs=0.11)
    sample = int(np.argmin(np.abs(record.time_s - time_s)))
    shown = {name: float(value) for name, value in (line.split(": ") for line in lines)}
    assert shown
    for track in record.vehicles:
        if (name := f"vehicle {track.vehicle_id}") in shown:
            relative_m, _ = record.relative(track)
            assert shown[name] == pytest.approx(float(np.hypot(*relative_m[sample])), abs=0.02)


def ticks_s(figure: Locator) -> list[float]:
    return [float(text) for text in figure.locator(".xtick:visible text").all_text_contents()]


def assert_charts_show_values(page: Page, record: FlightRecord) -> None:
    """Fail unless the chart of the radii shows the values under the pointer, also when zoomed."""
    radii = page.locator("figure", has=page.get_by_role("heading", name=RADII, exact=True))
    radii.scroll_into_view_if_needed()
    at, whole_s = pointing(radii), ticks_s(radii)
    for time_s in (45.0, 55.0):
        page.mouse.move(*at(time_s))
        assert_true_radii(radii, record, time_s)
    page.mouse.move(*at(50.0))
    page.mouse.down()
    page.mouse.move(*at(54.0), steps=3)
    page.mouse.up()
    zoomed_s = ticks_s(radii)
    assert len(zoomed_s) >= 3
    assert all(49.9 <= tick_s <= 54.1 for tick_s in zoomed_s)
    begin_s, end_s = json.loads(radii.locator("[data-axes]").get_attribute("data-axes") or "")["time_s"]
    page.mouse.move(*at(begin_s + 0.5 * (end_s - begin_s)))
    assert_true_radii(radii, record, 52.0)
    radii.get_by_role("button", name="Whole time").click()
    assert ticks_s(radii) == whole_s
