"""Map tiles under the scene: they lie where their coordinates say, and leave the marks readable."""

import asyncio
import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from math import cos, radians, sin
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from msgspec.structs import replace
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from gcs.station.access import Access, checked_access
from gcs.station.picture import FlightPicture
from gcs.station.server import listen, recorded_app, serve
from gcs.station.tiles import opened_tiles
from gcs.style import COLOURS
from gcs.viewer.origin_gate import Address
from tests.station.conftest import OpenPage
from tests.support.page.map_tiles import corner_deg, east_north_m, mbtiles, png
from tests.support.page.station_pictures import changed, ring_flight
from tests.support.wire import LOOPBACK, PATIENCE_S, free_port, repeated_now

pytestmark = pytest.mark.browser
BLACK, WHITE = (0, 0, 0), (255, 255, 255)
ORIGIN = (47.397742, 8.545594)
LEVEL, COLUMN, ROW = 18, 137299, 91775
"""Where a corner of four tiles lies some hundred metres east and north of the origin."""
X_BEARING_DEG = 30.0
CORNER_M = east_north_m(corner_deg(LEVEL, COLUMN, ROW), ORIGIN)
QUARTER_PX = 25
HIDE = "nodes => { for (const node of nodes) node.style.visibility = 'hidden'; }"


@contextmanager
def served(flight: FlightPicture, tiles: Path) -> Iterator[Access]:
    """Serve a recorded flight over tiles by the station's own server, until this context ends."""
    access = checked_access(Address(LOOPBACK, free_port()), None, None)
    app = recorded_app(flight, tiles=opened_tiles(tiles, flight.mission.origin_deg))
    listening, stop = listen(access), asyncio.Event()
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_until_complete, args=(serve(app, access, listening, stop),))
    thread.start()
    try:
        yield access
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join(PATIENCE_S)
        loop.close()


def chessboard(path: Path, **metadata: str) -> Path:
    """Write black and white tiles of one level, ten by ten about the corner."""
    images = [png(colour) for colour in (BLACK, WHITE)]
    around = [(COLUMN + i, ROW + j) for i in range(-5, 5) for j in range(-5, 5)]
    rows = [(LEVEL, x, 2**LEVEL - 1 - y, images[(x + y) % 2]) for x, y in around]
    return mbtiles(path, rows, **metadata)


def flight_about(east_m: float, north_m: float) -> FlightPicture:
    """Return a flight whose first vehicle hovers over a place, the others some metres from it."""
    flight = ring_flight(1.0)
    bearing = radians(X_BEARING_DEG)
    x_m, y_m = cos(bearing) * north_m + sin(bearing) * east_m, sin(bearing) * north_m - cos(bearing) * east_m
    team = replace(flight.teams[0], target=None)
    for number, (dx, dy) in {1: (0.0, 0.0), 2: (12.0, 9.0), 3: (-12.0, -9.0)}.items():
        team = changed(team, number, position_m=(x_m + dx, y_m + dy, 8.0), aim_m=None)
    mission = replace(flight.mission, origin_deg=ORIGIN, x_bearing_deg=X_BEARING_DEG)
    return replace(flight, mission=mission, teams=(team, team))


def middle(page: Page, vehicle: int) -> NDArray[np.float64]:
    """Return where the middle of a vehicle's symbol is in the window [px]."""
    box = page.locator(f".symbol[data-vehicle='{vehicle}']").bounding_box()
    assert box is not None
    return np.array([box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0])


def picture(page: Page) -> NDArray[np.float64]:
    """Return the window without symbols: rows, columns, and red, green and blue from 0 to 1."""
    page.eval_on_selector_all(".symbol, .maplibregl-ctrl", HIDE)
    shown = imread(io.BytesIO(page.screenshot()), format="png")
    return np.asarray(shown, dtype=np.float64)[..., :3]


def nearest_corner(shown: NDArray[np.float64], near: NDArray[np.float64], within: int) -> NDArray[np.float64]:
    """Return where four squares of a chessboard meet near a place [px]: most pixels change across its two lines."""
    x, y = near.round().astype(int)
    part = shown[y - within : y + within, x - within : x + within].mean(axis=2)
    across, down = np.abs(np.diff(part, axis=1)).mean(axis=0), np.abs(np.diff(part, axis=0)).mean(axis=1)
    assert min(across.max(), down.max()) > 0.1, "no corner of tiles is near"
    return np.array([x - within + 1 + across.argmax(), y - within + 1 + down.argmax()])


def open_settled(open_page: OpenPage, station: Access, **settings: str) -> Page:
    page = open_page(station.url, **settings)
    expect(page.locator(".symbol[data-vehicle='1']")).to_be_visible()
    page.wait_for_load_state("networkidle")
    settle(page)
    return page


def settle(page: Page) -> None:
    """Wait until the camera has arrived and all tiles are drawn: until nothing changes any more."""
    before = b""
    while (now := page.screenshot()) != before:
        before = now
        page.wait_for_timeout(700)


def luminance(colour: NDArray[np.float64]) -> float:
    """Return the relative luminance of an sRGB colour, as WCAG 2 defines it."""
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def contrast(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def quarters(page: Page) -> list[NDArray[np.float64]]:
    """Return the colours about the first vehicle: north-west, north-east, south-west, south-east."""
    x, y = middle(page, 1).round().astype(int)
    shown = picture(page)
    return [shown[y + down, x + right] for down in (-QUARTER_PX, QUARTER_PX) for right in (-QUARTER_PX, QUARTER_PX)]


def css_colour(page: Page, name: str) -> NDArray[np.float64]:
    text: str = page.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('{name}').trim()")
    return colour_of(text)


def colour_of(text: str) -> NDArray[np.float64]:
    """Return red, green and blue from 0 to 1 of #rrggbb."""
    return np.array([int(text[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])


def test_tiles_lie_at_their_metres_under_readable_ink_and_marks_until_they_are_hidden(
    open_page: OpenPage, tmp_path: Path
) -> None:
    """The first vehicle hovers over a corner, by the ellipsoid's plane: symbol and corner are less than 1 m apart.

    The circle about it has the vehicle's own colour on a white tile and on a black one.
    """
    assert 400.0 < np.hypot(*CORNER_M) < 500.0
    tiles = chessboard(tmp_path / "t.mbtiles", name="A &lt;b&gt;bold&lt;/b&gt; field")
    with served(flight_about(*CORNER_M), tiles) as station:
        page = open_settled(open_page, station, color_scheme="light")
        expect(page.locator(".tiles-source")).to_have_text("A <b>bold</b> field")
        expect(page.locator(".tiles-source b")).to_have_count(0)

        def lies_there() -> None:
            first, second = middle(page, 1), middle(page, 2)
            px_m = float(np.hypot(*(second - first))) / 15.0
            corner = nearest_corner(picture(page), first, round(4.0 * px_m))
            off_m = (corner - first) / px_m
            print(f"{CORNER_M} m east and north, {px_m:.1f} px/m: off by {off_m} m")
            assert np.hypot(*off_m) < 1.0

        def is_marked() -> None:
            x, y = middle(page, 1).round().astype(int)
            shown, colour = picture(page), colour_of(COLOURS[0])
            for part in (shown[y - 20 : y, x - 20 : x], shown[y - 20 : y, x : x + 20]):
                assert np.abs(part - colour).max(axis=2).min() < 0.1

        def is_readable() -> None:
            tones = quarters(page)
            assert np.ptp(tones, axis=0).max() > 0.2, "the tiles are to be seen"
            assert min(contrast(css_colour(page, "--ink"), tone) for tone in tones) > 4.5

        def is_hidden() -> None:
            assert np.ptp(quarters(page), axis=0).max() < 0.01

        for attempt in (lies_there, is_marked, is_readable):
            repeated_now(attempt)
        page.emulate_media(color_scheme="dark")
        settle(page)
        repeated_now(is_readable)
        page.locator("#layers summary").click()
        page.get_by_label("Map tiles").uncheck()
        page.locator("#layers summary").click()
        repeated_now(is_hidden)


def test_missing_tiles_show_the_ground(open_page: OpenPage, tmp_path: Path) -> None:
    one = mbtiles(tmp_path / "t.mbtiles", [(LEVEL, COLUMN, 2**LEVEL - 1 - ROW, png(BLACK))])
    with served(flight_about(*CORNER_M), one) as station:
        page = open_settled(open_page, station)

        def attempt() -> None:
            ground = css_colour(page, "--ground")
            drawn = [bool(np.abs(tone - ground).max() > 0.1) for tone in quarters(page)]
            assert drawn == [False, False, False, True], "the south-eastern quarter alone"

        repeated_now(attempt)
