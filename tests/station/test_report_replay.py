"""The replay in a report, opened from a file: nothing is fetched, and it shows what the simulator knows."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from playwright.sync_api import FrameLocator, Page, expect

from gcs.cli.report import ReportOptions, report
from gcs.flightlog.reader import read_log
from gcs.metrics.record import FlightRecord
from gcs.report.evidence.reading import read_flight
from tests.station.conftest import NO_WEBGL, OpenPage
from tests.support.flight_logs import engaging, record_simulation

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


@pytest.fixture
def page(flown: tuple[FlightRecord, Path], open_page: OpenPage) -> Iterator[Page]:
    """The report, from its file; it asks for nothing else."""
    page = open_page("about:blank", viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda socket: asked.append(socket.url))
    page.goto(flown[1].as_uri())
    yield page
    elsewhere = [url for url in asked if not url.startswith(("blob:", "data:", "about:"))]
    assert elsewhere == [flown[1].as_uri()]


@pytest.fixture
def replay(page: Page) -> FrameLocator:
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


def test_the_slider_shows_where_the_vehicles_were(replay: FrameLocator, flown: tuple[FlightRecord, Path]) -> None:
    record, _ = flown
    replay.get_by_role("tab", name="Table").click()
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


def test_jumps_to_the_next_event(replay: FrameLocator, flown: tuple[FlightRecord, Path]) -> None:
    events = [event for event in flown[0].events if event.time_s > 0.0]
    assert len(events) >= 2
    following = replay.get_by_role("button", name="To the next event")
    for event in events:
        following.click()
        after_s = float(replay.locator("#seek").input_value()) / RATE_HZ
        assert event.time_s - 0.01 <= after_s <= event.time_s + 1.0 / RATE_HZ + 0.01
        expect(replay.locator("#events li .text").first).to_have_text(f"Vehicle {event.vehicle}: {event.text}")


def test_it_plays_on_the_map(page: Page, replay: FrameLocator) -> None:
    expect(replay.locator(".symbol[data-vehicle]")).to_have_count(3)
    seek(replay, 50.0)
    # The keep-out area, of the target alone: it is drawn by MapLibre's worker. 12 % of #a3160c on #f6f7f8.
    area = np.array([236.0, 220.0, 220.0]) / 255.0
    for _ in range(20):
        drawn = imread(BytesIO(replay.locator("#map canvas").screenshot()))[:, :, :3]
        found = int((np.abs(drawn - area).max(axis=2) < 3.0 / 255.0).sum())
        if found > 500:
            break
        page.wait_for_timeout(250)
    assert found > 500
    replay.locator("#speed").select_option("20")
    replay.get_by_role("button", name="Play").click()
    expect(replay.locator("#seek-time")).to_have_text("1:00 of 1:00")
    expect(replay.locator("#ending")).to_have_text("Ended: Flown to the end of the simulation")


def test_it_is_not_printed(page: Page, replay: FrameLocator) -> None:
    expect(page.locator("#replay")).to_be_visible()
    page.emulate_media(media="print")
    expect(page.locator("#replay")).to_be_hidden()
    expect(page.locator("#verdicts")).to_be_visible()


def test_without_webgl_it_shows_the_table_and_says_so(flown: tuple[FlightRecord, Path], open_page: OpenPage) -> None:
    page = open_page(flown[1].as_uri(), script=NO_WEBGL)
    replay = page.frame_locator("#replay iframe")
    expect(replay.locator("#table tbody tr")).to_have_count(3)
    expect(replay.locator("#table")).to_be_visible()
    replay.get_by_role("tab", name="Map").click()
    expect(replay.locator("#no-webgl")).to_contain_text("WebGL is missing")


def test_without_scripts_the_report_is_whole_and_says_so(flown: tuple[FlightRecord, Path], open_page: OpenPage) -> None:
    page = open_page(flown[1].as_uri(), java_script_enabled=False)
    expect(page.locator("#replay")).to_have_text("The replay is missing: this browser runs no scripts here.")
    expect(page.locator("#replay iframe")).to_be_hidden()
    assert page.locator("main > section").count() == 12
    expect(page.locator("#paper figure").first).to_be_visible()


def test_a_browser_that_cannot_unpack_it_says_so(flown: tuple[FlightRecord, Path], open_page: OpenPage) -> None:
    page = open_page(flown[1].as_uri(), script="delete globalThis.DecompressionStream;")
    expect(page.locator("#replay")).to_contain_text("The replay is missing: this browser cannot open it")
    expect(page.locator("#verdicts")).to_be_visible()
