"""Keyboard, contrast, names and sizes: axe-core finds nothing serious, wide and phone-sized, light and dark."""

from pathlib import Path
from typing import Any, Literal

import pytest
from playwright.sync_api import Page, expect

from agents.team.messages import AutopilotReport
from gcs.station.picture import EventPicture, TeamPicture
from tests.station.conftest import NO_WEBGL, OpenPage
from tests.support.page.canned_station import CannedStation
from tests.support.page.station_pictures import changed, ring_flight, ring_mission, ring_team

pytestmark = pytest.mark.browser
AXE = (Path(__file__).parent / "vendor" / "axe.min.js").read_text(encoding="utf-8")
WIDE: Any = {"width": 1920, "height": 1080}
PHONE: Any = {"width": 390, "height": 844}
MISSION = ring_mission()
TARGET_PX = 44
MAP_HEIGHTS_PX: tuple[tuple[Any, float], ...] = ((PHONE, 140.0), ({"width": 1024, "height": 768}, 200.0))
"""The least height of the map that is seen during two alarms, by the page's size."""
MAP_PX = """() => {
  const [map, sheet] = ["map", "commands"].map((id) => document.getElementById(id).getBoundingClientRect());
  return Math.min(map.bottom, sheet.top) - map.top;
}"""
VEHICLES_IN_VIEW = """() => {
  const [map, sheet] = ["map", "commands"].map((id) => document.getElementById(id).getBoundingClientRect());
  const vehicles = [...document.querySelectorAll(".symbol[data-vehicle]")].map((each) => each.getBoundingClientRect());
  return vehicles.every(({ top, bottom }) => top >= map.top && bottom <= Math.min(map.bottom, sheet.top));
}"""


def every_state(time_s: float) -> TeamPicture:
    """Return a team with an alarm, a warning and a stale vehicle."""
    team = ring_team(MISSION, 100.0 + time_s)
    team = changed(team, 1, alert="GPS jammed", advice="Take over.", severity="alarm")
    return changed(changed(team, 2, autopilot=AutopilotReport(0.2)), 3, is_stale=True, age_s=9.0)


def two_alarms(time_s: float) -> TeamPicture:
    """Return the same with a second alarm; both have long words."""
    also = ("link degraded", "peer doubtful", "vehicle 3 not following")
    alarm = {"severity": "alarm", "also": also, "advice": "not following is over: resume continues its mission"}
    return changed(
        changed(every_state(time_s), 1, alert="waits for resume", **alarm), 2, alert="not following", **alarm
    )


def findings(page: Page, rules: str = "") -> list[str]:
    """Return what axe-core finds that is serious or critical, by all rules or those named."""
    if page.evaluate("typeof axe") == "undefined":
        page.evaluate(AXE)
    options = {"resultTypes": ["violations"], **({"runOnly": rules.split()} if rules else {})}
    found = page.evaluate("(options) => axe.run(options).then(result => result.violations)", options)
    grave = [each for each in found if each["impact"] in ("serious", "critical")]
    return [f"{each['id']}: {node['target']} {node['failureSummary']}" for each in grave for node in each["nodes"]]


COLOUR_RULES = "color-contrast"
"""What the dark scheme can break: it changes colours alone."""
SCREENS: tuple[tuple[Any, Literal["light", "dark"], str], ...] = (
    (WIDE, "light", ""),
    (WIDE, "dark", COLOUR_RULES),
    (PHONE, "dark", ""),
)
"""Their sizes, colour schemes and rules."""


def test_axe_finds_nothing_serious(open_page: OpenPage, subtests: pytest.Subtests) -> None:
    with CannedStation(MISSION, every_state) as served:
        page = open_page(served.url, viewport=WIDE, color_scheme="light")
        expect(page.locator("#alarms li")).to_have_count(1)
        for size, scheme, rules in SCREENS:
            with subtests.test(width=size["width"], scheme=scheme):
                page.set_viewport_size(size)
                page.emulate_media(color_scheme=scheme)
                page.get_by_role("tab", name="Map").click()
                expect(page.locator(".symbol[data-vehicle]")).to_have_count(3)
                assert findings(page, rules) == []
                page.get_by_role("tab", name="Table").click()
                assert findings(page, rules) == []
                page.locator("[data-verb='kill']").click()
                assert findings(page, rules) == []
                page.keyboard.press("Escape")


def test_axe_finds_nothing_serious_in_a_replay(open_page: OpenPage) -> None:
    with CannedStation(flight=ring_flight(40.0)) as served:
        page = open_page(served.url, script=NO_WEBGL, color_scheme="light")
        expect(page.locator("#seek-time")).to_have_text("0:00 of 0:40")
        page.locator("#seek").press("End")
        page.get_by_role("tab", name="Strips").click()
        assert findings(page) == []
        page.emulate_media(color_scheme="dark")
        assert findings(page, COLOUR_RULES) == []


def test_what_is_touched_is_large_enough_and_neither_alarms_nor_events_take_the_maps_room(
    open_page: OpenPage, subtests: pytest.Subtests
) -> None:
    with CannedStation(MISSION, two_alarms) as served:
        page = open_page(served.url, viewport=WIDE)
        expect(page.locator("#verbs button")).to_have_count(8)
        expect(page.locator("#alarms li")).to_have_count(2)
        for size in (PHONE, WIDE):
            with subtests.test(width=size["width"]):
                page.set_viewport_size(size)
                assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
                small = []
                for control in page.locator(
                    "button:visible, summary:visible, select:visible, label.select:visible"
                ).all():
                    box = control.bounding_box()
                    assert box is not None
                    if min(box["width"], box["height"]) < TARGET_PX - 0.5:
                        small.append((control.inner_text(), box))
                assert small == []
        for size, height_px in MAP_HEIGHTS_PX:
            with subtests.test("map", width=size["width"]):
                page.set_viewport_size(size)
                assert page.evaluate(MAP_PX) >= height_px
                page.wait_for_function(VEHICLES_IN_VIEW)
                assert findings(page) == []
        events = [EventPicture(i, float(i), 1.7e9, "information", "something happened") for i in range(1, 101)]
        served.send(events[0])
        expect(page.locator("#events li")).to_have_count(1)  # after the team, whose figures take room in the top bar
        expect(page.locator(".card .tactic").first).to_be_visible()
        before = page.locator("#map-panel").bounding_box()
        for event in events[1:]:
            served.send(event)
        expect(page.locator("#events li")).to_have_count(100)
        assert page.locator("#map-panel").bounding_box() == before
        assert page.locator("[data-verb='kill']").is_visible()


def test_commands_by_keyboard_alone_and_the_theme_is_switched_and_kept(open_page: OpenPage) -> None:
    with CannedStation(MISSION, every_state) as served:
        page = open_page(served.url, color_scheme="light", script=NO_WEBGL)
        expect(page.locator("#verbs button")).to_have_count(8)
        page.keyboard.press("Tab")
        expect(page.get_by_role("link", name="To the commands")).to_be_focused()
        page.keyboard.press("Enter")
        for place, verb in (("#hold-all", "hold"), ("[data-verb='hold']", "hold"), ("[data-verb='resume']", "resume")):
            page.keyboard.press("Tab")
            expect(page.locator(place)).to_be_focused()
            page.keyboard.press("Space")
            served.await_requests(page)
            assert [request.verb for request in served.requests] == [verb]
            served.requests.clear()
        page.get_by_role("tab", name="Map").focus()
        for name in ("Table", "Strips"):
            page.keyboard.press("ArrowRight")
            expect(page.locator(f"#{name.lower()}")).to_be_visible()
            expect(page.get_by_role("tab", name=name)).to_be_focused()
        colour = "() => getComputedStyle(document.body).backgroundColor"
        light = page.evaluate(colour)
        page.get_by_role("button", name="Theme: ◐ Auto").click()
        page.get_by_role("button", name="Theme: ○ Light").click()
        assert page.evaluate(colour) != light
        page.reload()
        expect(page.get_by_role("button", name="Theme: ● Dark")).to_be_visible()
        assert page.evaluate(colour) != light
