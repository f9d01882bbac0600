"""A recorded flight on the page: the slider, play, speed, and jumps to events."""

from collections.abc import Iterator

import pytest
from msgspec.structs import replace
from playwright.sync_api import Page, expect

from tests.station.conftest import NO_WEBGL, OpenPage, pass_time
from tests.support.page.canned_station import CannedStation
from tests.support.page.station_pictures import ring_flight, ring_mission, ring_team
from tests.support.wire import repeated_now

pytestmark = pytest.mark.browser


@pytest.fixture
def page(open_page: OpenPage) -> Iterator[Page]:
    with CannedStation(flight=ring_flight(60.0)) as station:
        page = open_page(station.url, script=NO_WEBGL, simulated=True)
        expect(page.locator("#seek-time")).to_have_text("0:00 of 1:00")
        yield page
        page.clock.resume()


FIRST_REQUEST_FAILS = """{
    const sent = window.fetch;
    window.requests = 0;
    window.fetch = (url, options) =>
        sent(url, ++window.requests === 1 ? { ...options, signal: AbortSignal.abort() } : options);
}"""


def seek(page: Page, picture: int) -> None:
    slider = "node => { node.value = %d; node.dispatchEvent(new Event('input')); }"
    page.locator("#seek").evaluate(slider % picture)


def test_slider_shows_the_picture_of_that_time(open_page: OpenPage) -> None:
    with CannedStation(flight=ring_flight(60.0)) as station:
        page = open_page(station.url)
        expect(page.locator("#seek-time")).to_have_text("0:00 of 1:00")
        expect(page.locator("#commands")).to_be_hidden()
        # The log is below the view and as wide as the cards' column leaves, down to the bottom: nothing is empty.
        parts = [page.locator(name).bounding_box() for name in ("main", "#view", "#vehicles", "#log")]
        whole_px2, *areas_px2 = (part["width"] * part["height"] for part in parts if part)
        assert len(areas_px2) == 3
        assert sum(areas_px2) > 0.93 * whole_px2
        expect(page.locator("#rights")).to_have_text("recorded")
        expect(page.locator("#elapsed")).to_have_text("T+ 0:00")
        expect(page.locator("#events li")).to_have_count(1)
        seek(page, 5 * 42)
        expect(page.locator("#elapsed")).to_have_text("T+ 0:42")
        expect(page.locator("#seek")).to_have_attribute("aria-valuetext", "0:42 of 1:00")
        expect(page.locator("#events li")).to_have_count(3)
        expect(page.locator("#alarms")).to_contain_text("Vehicle 2: link lost")
        expect(page.locator(".symbol[data-vehicle='2']")).to_have_attribute("data-current", "false")
        expect(page.locator(".card").first).to_have_attribute("data-vehicle", "2")
        # 42 s of 0.0003 a second from 82 %
        expect(page.locator(".card[data-vehicle='1'] [data-quantity='battery']")).to_have_text("80\u00a0%")
        seek(page, 5 * 20)
        expect(page.locator("#alarm-bar")).to_be_hidden()
        expect(page.locator("#events li")).to_have_count(2)
        expect(page.locator(".symbol[data-vehicle='2']")).to_have_attribute("data-current", "true")


def test_jumps_to_events_and_alarms_by_button_and_key(page: Page) -> None:
    def elapsed() -> str:
        return page.locator("#elapsed").inner_text().removeprefix("T+ ")

    following, previous = (page.get_by_role("button", name=f"To the {which} event") for which in ("next", "previous"))
    shown = []
    for button in (following, following, following, previous, previous, previous, previous):
        button.click()
        shown.append(elapsed())
    assert shown == ["0:10", "0:30", "1:00", "0:30", "0:10", "0:00", "0:00"]
    slider, mark = page.locator("#seek").bounding_box(), page.locator("#seek-alarms span").bounding_box()
    assert page.locator("#seek-alarms span").count() == 1
    assert slider is not None
    assert mark is not None
    assert (mark["x"] + mark["width"] / 2.0 - slider["x"]) / slider["width"] == pytest.approx(0.5, abs=0.02)
    for _ in range(2):  # there is no other one
        page.locator("#next-alarm").click()
        assert elapsed() == "0:30"
    page.locator("#seek").focus()
    for key, time in (("End", "1:00"), ("Home", "0:00"), ("n", "0:30")):
        page.keyboard.press(key)
        expect(page.locator("#elapsed")).to_have_text(f"T+ {time}")


def test_plays_at_its_speed_pauses_and_ends(page: Page) -> None:
    page.locator("#speed").select_option("5")
    page.clock.pause_at(page.evaluate("(Date.now() + 60_000) / 1000"))
    page.get_by_role("button", name="Play").click()
    pass_time(page, 2000)
    page.get_by_role("button", name="Pause").click()
    place = float(page.locator("#seek").input_value()) / 5.0
    assert place == pytest.approx(10.0, abs=1.0)
    pass_time(page, 500)
    assert float(page.locator("#seek").input_value()) / 5.0 == place
    page.locator("#speed").select_option("20")
    seek(page, 5 * 55)
    page.get_by_role("button", name="Play").click()
    pass_time(page, 500)
    expect(page.locator("#elapsed")).to_have_text("T+ 1:00")
    expect(page.get_by_role("button", name="Play")).to_be_visible()


def test_the_page_says_at_what_rate_it_shows_the_flight_from_its_start(open_page: OpenPage) -> None:
    """Pictures before the mission's start have no time. A flight that did not arrive is requested again."""
    flight = ring_flight(60.0)
    waiting = tuple(replace(team, time_s=None) for team in flight.teams[:100])
    with CannedStation(flight=flight) as station:
        page = open_page(station.url, script=NO_WEBGL + FIRST_REQUEST_FAILS)
        for teams, words, first in (
            (waiting + flight.teams, "5 pictures a second", "100"),
            (flight.teams[::12], "a picture every 2.4 s", "0"),
            (waiting, "", "0"),
        ):
            station.flight = replace(flight, teams=teams)
            page.reload()
            expect(page.locator("#rights")).to_have_text("recorded")
            expect(page.locator("#rate")).to_have_text(words)
            expect(page.locator("#seek")).to_have_value(first)
            assert page.evaluate("requests") == 2
        # Of events a little before a picture and a little after it, the second is seen in the picture after that.
        event = flight.events[0]
        events = tuple(replace(event, number=number, time_s=time_s) for number, time_s in enumerate((29.97, 30.03)))
        station.flight = replace(flight, events=events)
        page.reload()
        for place in (5 * 30, 5 * 30 + 1, 5 * 60):
            page.get_by_role("button", name="To the next event").click()
            expect(page.locator("#seek")).to_have_value(str(place))


def test_the_map_follows_a_slider_that_moves_faster_than_the_map(open_page: OpenPage) -> None:
    """The target is 30 m on in each picture; two pictures come while the map still moves to the first."""
    flight = replace(ring_flight(), teams=tuple(ring_team(ring_mission(), 300.0 * number) for number in range(4)))
    with CannedStation(flight=flight) as station:
        page = open_page(station.url)
        expect(page.locator(".symbol[data-vehicle]")).to_have_count(3)
        page.wait_for_timeout(1000)
        page.locator("#seek").evaluate(
            """async node => { for (const place of [1, 2, 3]) {
                node.value = place; node.dispatchEvent(new Event('input'));
                await new Promise(done => setTimeout(done, 80)); } }"""
        )
        repeated_now(lambda: all_on_the_map(page))


def all_on_the_map(page: Page) -> None:
    area = page.locator("#map").bounding_box()
    assert area
    for symbol in page.locator(".symbol[data-vehicle]").all():
        box = symbol.bounding_box()
        assert box
        assert area["x"] < box["x"] < area["x"] + area["width"]
        assert area["y"] < box["y"] < area["y"] + area["height"]
