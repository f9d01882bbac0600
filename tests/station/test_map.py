"""Places on the map: the menu by mouse, finger and keyboard, reports of the target, and measuring."""

import re
from collections.abc import Iterator
from io import BytesIO
from math import atan2, cos, degrees, hypot, radians
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from gcs.station.picture import AnswerPicture, CommandRequest, OperatorRights, SightingRequest, ZonePicture
from tests.station.conftest import OpenPage
from tests.station.test_accessibility import findings
from tests.support.page.canned_station import CannedStation
from tests.support.page.station_pictures import ring_mission, ring_team, rings_mission, rings_team
from tests.support.wire import until_now

pytestmark = pytest.mark.browser

MISSION = replace(ring_mission(), operator=OperatorRights("anna", ring_mission().operator.may, sights=True))
TARGET_M = (35.0, -5.0)
NEAR_M = 0.5
"""How exactly a place can be chosen and read: whole pixels, and a scale bar of whole pixels."""
METRE_PX = """() => {
  const bar = document.querySelector(".maplibregl-ctrl-scale");
  return bar.getBoundingClientRect().width / parseFloat(bar.textContent);
}"""
WGS84_A_M, WGS84_E2 = 6378137.0, 6.69437999014e-3


class Map(NamedTuple):
    """A page with a map whose target stands still, seen from above: x points east, as on the screen."""

    page: Page
    station: CannedStation

    def pixel(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return the place on the screen of a point in metres, from the target's symbol and the scale bar."""
        box = self.page.locator(".symbol.target").bounding_box()
        assert box is not None
        metre_px = self.page.evaluate(METRE_PX)
        return (
            box["x"] + box["width"] / 2.0 + (x_m - TARGET_M[0]) * metre_px,
            box["y"] + box["height"] / 2.0 - (y_m - TARGET_M[1]) * metre_px,
        )

    def report(self) -> SightingRequest:
        """Return the report that the page has sent, and forget it."""
        until_now(lambda: bool(self.station.sightings))
        return self.station.sightings.pop()


@pytest.fixture
def shown(open_page: OpenPage) -> Iterator[Map]:
    still = replace(ring_team(MISSION, 0.0))
    with CannedStation(MISSION, lambda _time_s: still) as station:
        yield opened(open_page(station.url, viewport={"width": 1024, "height": 768}, has_touch=True), station)


def opened(page: Page, station: CannedStation) -> Map:
    expect(page.locator(".symbol[data-vehicle]")).to_have_count(3)
    page.locator("#follow").click()
    page.wait_for_timeout(600)  # the camera comes to rest
    return Map(page, station)


def item(page: Page, name: str) -> Locator:
    return page.get_by_role("menuitem", name=name)


def geodetic_deg(x_m: float, y_m: float) -> tuple[float, float]:
    """Return latitude and longitude of a place, by the ellipsoid's radii; x points east, y north."""
    latitude, longitude = MISSION.origin_deg or (0.0, 0.0)
    flat = 1.0 - WGS84_E2 * (1.0 - cos(radians(latitude)) ** 2)
    north_m, east_m = WGS84_A_M * (1.0 - WGS84_E2) / flat**1.5, WGS84_A_M / flat**0.5 * cos(radians(latitude))
    return latitude + degrees(y_m / north_m), longitude + degrees(x_m / east_m)


def numbers(text: str) -> list[float]:
    return [float(each) for each in re.findall(r"-?\d+\.\d+", text)]


def test_the_target_is_reported_where_the_map_is_clicked_or_pressed(shown: Map, subtests: pytest.Subtests) -> None:
    page = shown.page
    with subtests.test("right click"):
        page.mouse.click(*shown.pixel(28.0, 4.0), button="right")
        place = page.locator("#map-menu-place")
        x_m, y_m, latitude, longitude = numbers(place.inner_text())
        assert hypot(x_m - 28.0, y_m - 4.0) < NEAR_M
        assert (latitude, longitude) == pytest.approx(geodetic_deg(x_m, y_m), abs=2e-6)  # of 0.1 m
        assert findings(page) == []
        item(page, "The target is here").click()
        dialog = page.get_by_role("dialog")
        expect(dialog).to_contain_text(f"x {x_m} m, y {y_m} m; {latitude:.6f}, {longitude:.6f}")
        assert findings(page) == []
        page.get_by_label("Standard deviation").fill("5.5")
        page.get_by_label("Send it").select_option("for 10 s")
        assert not shown.station.sightings  # before it is confirmed
        page.get_by_role("button", name="Report the target").click()
        report = shown.report()
        assert hypot(report.position_m[0] - 28.0, report.position_m[1] - 4.0) < NEAR_M
        assert (report.sigma_m, report.lasting_s, report.target) == (5.5, 10.0, None)
        answers = page.locator("#answers > li").first
        expect(answers).to_contain_text("Waiting for the station")
        did = "sent to vehicles 1, 2, 3"
        shown.station.send(AnswerPicture(report.request, "target", None, did, 0.4, is_obeyed=True, is_final=True))
        expect(answers).to_contain_text("✓ Station: sent to vehicles 1, 2, 3, after 0.4")
    with subtests.test("a sigma that is none"):
        page.mouse.click(*shown.pixel(28.0, 4.0), button="right")
        item(page, "The target is here").click()
        page.get_by_label("Standard deviation").fill("-1")
        page.get_by_role("button", name="Report the target").click()
        expect(page.get_by_role("dialog")).to_be_visible()
        page.get_by_role("button", name="Cancel").click()
        assert not shown.station.sightings
    with subtests.test("long press"):
        x, y = shown.pixel(40.0, 6.0)
        touch = page.context.new_cdp_session(page)
        touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
        expect(item(page, "The target is here")).to_be_visible()
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        assert hypot(*(a - b for a, b in zip(numbers(place.inner_text()), (40.0, 6.0), strict=False))) < NEAR_M
        page.mouse.click(*shown.pixel(20.0, 6.0))  # elsewhere: it closes
        expect(item(page, "The target is here")).to_have_count(0)


def test_the_keyboard_alone_reports_and_measures(shown: Map) -> None:
    page = shown.page
    page.locator("#crosshair").focus()
    first = numbers(page.locator("#cursor-place").inner_text())
    for _ in range(3):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("ArrowUp")
    moved_px = (180.0, 10.0)
    page.keyboard.press("Enter")
    expect(item(page, "The target is here")).to_be_focused()
    x_m, y_m = numbers(page.locator("#map-menu-place").inner_text())[:2]
    assert numbers(page.locator("#cursor-place").inner_text()) != first
    page.keyboard.press("ArrowUp")  # from the first to the last
    expect(item(page, "Copy the place")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.locator("#crosshair")).to_be_focused()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Enter")
    report = shown.report()
    assert report.position_m == pytest.approx((x_m, y_m), abs=0.06)
    assert report.sigma_m == 2.0
    page.locator("#crosshair").focus()
    page.keyboard.press("Enter")
    item(page, "Measure from here").press("Enter")
    for _ in range(3):
        page.keyboard.press("Shift+ArrowLeft")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    distance_m, bearing_deg = numbers(page.locator("#measured").inner_text())
    metre_px = page.evaluate(METRE_PX)
    assert distance_m == pytest.approx(hypot(*moved_px) / metre_px, rel=0.02)
    assert bearing_deg == pytest.approx(270.0 - degrees(atan2(moved_px[1], moved_px[0])), abs=0.2)  # west and south
    page.keyboard.press("Escape")
    expect(page.locator("#measured")).to_be_hidden()


def test_a_vehicle_is_sent_to_a_place(shown: Map, subtests: pytest.Subtests) -> None:
    page = shown.page
    for choice, lands, selected, vehicle in (("Hold there", False, None, 1), ("Land there", True, 3, 3)):
        with subtests.test(choice):
            if selected:
                page.get_by_label(f"Select vehicle {selected}").check()
            page.mouse.click(*shown.pixel(51.0, -3.0), button="right")  # vehicle 1 is the nearest
            item(page, choice).click()
            dialog = page.get_by_role("dialog")
            expect(page.get_by_label("Vehicle", exact=True)).to_have_value(str(vehicle))
            assert findings(page) == []
            assert not shown.station.requests  # before it is confirmed
            dialog.get_by_role("button", name=choice).click()
            until_now(lambda: bool(shown.station.requests))
            request = shown.station.requests.pop()
            assert (request.verb, request.vehicles) == ("goto", (vehicle,))
            assert request.place is not None
            assert request.place.lands is lands
            assert hypot(request.place.x_m - 51.0, request.place.y_m + 3.0) < NEAR_M
            expect(page.locator("#answers > li").first).to_contain_text(f"vehicle {vehicle}")
    with subtests.test("without the right"):
        shown.station.send(ring_mission(may=("hold",)))
        shown.station.await_pictures(page)
        page.mouse.click(*shown.pixel(51.0, -3.0), button="right")
        expect(item(page, "Hold there")).to_be_disabled()
        page.keyboard.press("h")
        until_now(lambda: [each.verb for each in shown.station.requests] == ["hold"])


def test_the_keyboard_alone_points_cameras_at_a_place_and_back_at_the_target(shown: Map) -> None:
    page = shown.page
    page.locator("#crosshair").focus()
    page.keyboard.press("Enter")
    expect(item(page, "Hold there")).to_be_visible()
    expect(item(page, "Look here")).to_have_count(0)  # no vehicle has a gimbal
    page.keyboard.press("Escape")
    with_gimbals = [replace(each, has_gimbal=each.vehicle_id != 2) for each in MISSION.vehicles]
    shown.station.send(replace(MISSION, vehicles=tuple(with_gimbals)))
    shown.station.await_pictures(page)
    page.locator("#crosshair").focus()
    page.keyboard.press("Enter")
    x_m, y_m = numbers(page.locator("#map-menu-place").inner_text())[:2]
    item(page, "Look here").press("Enter")
    choice = page.get_by_label("Vehicle", exact=True)
    expect(choice).to_be_focused()
    expect(choice.locator("option")).to_have_text(["all cameras", "vehicle 1", "vehicle 3"])
    assert findings(page) == []
    confirm(page, "Look here")
    request = sent(shown)
    assert (request.verb, request.vehicles) == ("look", (1, 3))
    assert request.place is not None
    assert (request.place.x_m, request.place.y_m) == pytest.approx((x_m, y_m), abs=0.06)
    expect(page.locator("#answers > li").first).to_contain_text("Look at x")
    page.get_by_label("Select vehicle 3").check()
    page.locator("#crosshair").focus()
    page.keyboard.press("Enter")
    item(page, "Look at the target again").press("Enter")
    expect(choice).to_have_value("3")
    confirm(page, "Look at the target again")
    request = sent(shown)
    assert (request.verb, request.vehicles, request.place) == ("look", (3,), None)


def confirm(page: Page, action: str) -> None:
    """Confirm the dialog from its choice of a vehicle, by the keyboard."""
    for _ in range(2):
        page.keyboard.press("Tab")
    expect(page.get_by_role("button", name=action)).to_be_focused()
    page.keyboard.press("Enter")


def sent(shown: Map) -> CommandRequest:
    """Return the command that the page has sent, and forget it."""
    until_now(lambda: bool(shown.station.requests))
    return shown.station.requests.pop()


def test_two_clicks_measure_and_copy_nothing(shown: Map, subtests: pytest.Subtests) -> None:
    page = shown.page
    with subtests.test("with an origin"):
        page.get_by_role("button", name="Measure").click()
        expect(page.locator("#measured")).to_have_text("Choose the first place")
        page.mouse.click(*shown.pixel(30.0, 0.0))
        page.mouse.click(*shown.pixel(30.0, -12.0))
        distance_m, bearing_deg = numbers(page.locator("#measured").inner_text())
        assert distance_m == pytest.approx(12.0, abs=NEAR_M)
        assert bearing_deg == pytest.approx(180.0, abs=1.0)  # y is north
        expect(page.locator("#cursor-place")).not_to_have_class("copies copied")
        assert findings(page) == []
        page.get_by_role("button", name="Measure").click()
        expect(page.locator("#measured")).to_be_hidden()
    with subtests.test("in a local frame"):
        shown.station.send(replace(MISSION, origin_deg=None))
        shown.station.await_pictures(page)
        page.get_by_role("button", name="Measure").click()
        box: Any = page.locator("#map").bounding_box()
        for x, y in ((300, 200), (300, 100)):
            page.mouse.click(box["x"] + x, box["y"] + y)
        expect(page.locator("#measured")).to_contain_text(re.compile(r"m, 90\.0° from x"))


def test_no_fly_zones_are_drawn_with_their_heights_and_names_that_no_label_covers(open_page: OpenPage) -> None:
    zones = (
        ZonePicture("school", ((20.0, 0.0), (30.0, 0.0), (30.0, 10.0), (20.0, 10.0)), ceiling_m=120.0),
        ZonePicture("mast", center_m=(41.0, -5.0), radius_m=4.0, floor_m=10.0),
    )
    still = ring_team(MISSION, 0.0)
    with CannedStation(replace(MISSION, zones=zones), lambda _time_s: still) as station:
        shown = opened(open_page(station.url, viewport={"width": 1024, "height": 768}), station)
        names = shown.page.locator(".zone-name")
        expect(names).to_have_text(["✕ school to 120 m", "✕ mast from 10 m"])
        for name, middle in zip(names.all(), ((25.0, 5.0), (41.0, -5.0)), strict=True):
            box: Any = name.bounding_box()
            x, y = shown.pixel(*middle)
            assert hypot(box["x"] + box["width"] / 2.0 - x, box["y"] + box["height"] / 2.0 - y) < 4.0
            expect(shown.page.locator(".symbol.target")).not_to_have_attribute("data-place", "none")
            label: Any = shown.page.locator(".symbol.target .label").bounding_box()
            assert any(
                low[way] + low[size] <= high[way]
                for low, high in ((box, label), (label, box))
                for way, size in (("x", "width"), ("y", "height"))
            )
        inside, outside = (colour(shown, *at) for at in ((21.0, 2.0), (18.0, 2.0)))
        assert inside != outside
        shown.page.locator("#layers summary").click()
        shown.page.get_by_role("checkbox", name="No-fly zones").uncheck()
        shown.page.locator("#layers summary").click()
        shown.page.wait_for_timeout(500)
        assert colour(shown, 21.0, 2.0) == outside
        expect(names.first).to_be_hidden()


DRAWS = """
window.draws = 0;
for (const name of ["drawElements", "drawArrays"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) { window.draws += 1; return draw.apply(this, given); };
}
"""


def test_marks_are_where_symbols_are_and_need_no_webgl(open_page: OpenPage, subtests: pytest.Subtests) -> None:
    """Separation circles, drawn in metres, are about the vehicles' symbols, which MapLibre places by their degrees."""
    with CannedStation(MISSION, lambda time_s: ring_team(MISSION, time_s)) as station:
        shown = opened(open_page(station.url, script=DRAWS), station)
        page = shown.page
        with subtests.test("the camera rests"):
            before = page.evaluate("draws")
            page.wait_for_timeout(1000)
            assert page.evaluate("draws") == before
        station.team = lambda _time_s: ring_team(MISSION, 0.0)
        page.wait_for_timeout(500)
        box: Any = page.locator("#map").bounding_box()
        x, y = box["x"] + 0.8 * box["width"], box["y"] + 0.2 * box["height"]
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x - 30.0, y + 21.0, steps=5)
        for moved in ("dragged", "zoomed", "turned"):
            with subtests.test(moved):
                if moved == "zoomed":
                    page.mouse.up()
                    page.mouse.wheel(0.0, -240.0)
                elif moved == "turned":
                    page.locator("#mission-up").click()
                page.wait_for_timeout(600)
                assert distances_px(page).max() < 1.0
        with subtests.test("the scale is the map's"):
            assert page.evaluate(CIRCLE_PX) == pytest.approx(MISSION.separation_m * page.evaluate(METRE_PX), rel=0.02)


CIRCLE_PX = "document.querySelector('[data-layer=separation] path').getBoundingClientRect().width"


def distances_px(page: Page) -> NDArray[np.float64]:
    """Return how far the middles of circles and symbols are apart."""
    middles = [
        page.eval_on_selector_all(
            selector,
            """all => all.map((each) => {
              const { left, right, top, bottom } = each.getBoundingClientRect();
              return [(left + right) / 2, (top + bottom) / 2];
            })""",
        )
        for selector in ("[data-layer=separation] path", ".symbol[data-vehicle]")
    ]
    circles, symbols = (np.array(sorted(each)) for each in middles)
    assert circles.shape == symbols.shape == (3, 2)
    return np.asarray(np.hypot(*(circles - symbols).T))


def colour(shown: Map, x_m: float, y_m: float) -> tuple[int, ...]:
    """Return the colour of a place of the map."""
    x, y = shown.pixel(x_m, y_m)
    image = shown.page.screenshot(clip={"x": x, "y": y, "width": 1, "height": 1})
    return tuple(np.asarray(Image.open(BytesIO(image)).convert("RGB"))[0, 0].tolist())


def test_the_menu_offers_what_the_page_can_send(open_page: OpenPage, subtests: pytest.Subtests) -> None:
    with CannedStation(replace(rings_mission(), operator=OperatorRights(sights=True)), rings_team) as station:
        shown = opened(open_page(station.url), station)
        page = shown.page
        middle: Any = page.locator("#map").bounding_box()
        at = middle["x"] + middle["width"] / 2.0, middle["y"] + middle["height"] / 2.0
        with subtests.test("several targets"):
            page.mouse.click(*at, button="right")
            item(page, "The target is here").click()
            page.get_by_label("Target", exact=True).select_option("buoy")
            page.get_by_role("button", name="Report the target").click()
            assert shown.report().target == 1
        with subtests.test("without keys"):
            station.send(replace(rings_mission(), operator=OperatorRights()))
            station.await_pictures(page)
            page.mouse.click(*at, button="right")
            expect(item(page, "The target is here")).to_be_disabled()
            expect(item(page, "Measure from here")).to_be_focused()
