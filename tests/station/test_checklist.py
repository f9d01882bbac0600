"""The mission's checklist on the page: ticks by mouse and keyboard, who has ticked, and until when it is shown."""

import pytest
from msgspec.structs import replace
from playwright.sync_api import Page, expect

from gcs.station.picture import ChecklistItemPicture, ChecklistPicture
from tests.station.conftest import NO_WEBGL
from tests.station.test_accessibility import findings
from tests.support.page.canned_station import CannedStation
from tests.support.page.station_pictures import ring_mission, ring_team
from tests.support.wire import until_now

pytestmark = pytest.mark.browser
SCRIPT = NO_WEBGL

PROPELLERS = ChecklistItemPicture("Propellers tight", required=True)
AREA = ChecklistItemPicture("Area clear of people", required=True)
FLAG = ChecklistItemPicture("Flag up", required=False)


def test_items_are_ticked_before_take_off(page: Page, served: CannedStation, subtests: pytest.Subtests) -> None:
    team = ring_team(ring_mission(), 0.0)
    served.team = lambda _time_s: replace(team, time_s=None)
    checklist, state = page.locator("#checklist"), page.locator("#checklist-state")
    with subtests.test("open"):
        served.send(ChecklistPicture((PROPELLERS, AREA, FLAG), may_tick=True))
        expect(state).to_have_text("2 of 3 open: nothing is armed")
        expect(checklist.locator("li")).to_have_text(["Propellers tight", "Area clear of people", "Flag up (optional)"])
        assert findings(page) == []
    with subtests.test("ticks"):
        page.get_by_label("Propellers tight").check()
        page.get_by_label("Area clear of people").focus()
        page.keyboard.press("Space")
        until_now(lambda: len(served.ticks) == 2)
        assert [(each.item, each.ticked) for each in served.ticks] == [(0, True), (1, True)]
    with subtests.test("by whom"):
        ticked = (replace(PROPELLERS, by="anna", wall_s=1.7e9), replace(AREA, by="ben", wall_s=1.7e9 + 60.0))
        served.send(ChecklistPicture((*ticked, FLAG), may_tick=True))
        expect(state).to_have_text("complete")
        clock = page.evaluate("new Date(1.7e12).toLocaleTimeString([], { hour12: false })")
        expect(checklist.locator("li").first).to_contain_text(f"anna, {clock}")
        expect(page.get_by_label("Area clear of people")).to_be_checked()
    with subtests.test("read-only"):
        served.send(ChecklistPicture((*ticked, FLAG), may_tick=False))
        expect(page.get_by_label("Flag up")).to_be_disabled()
    with subtests.test("a fault"):
        served.send(ChecklistPicture((*ticked, FLAG), "the file is another user's"))
        expect(state).to_have_text("the file is another user's")
    with subtests.test("used"):
        served.send(ChecklistPicture(tuple(replace(each, used=True) for each in ticked)))
        expect(state).to_contain_text("tick it again for the next")
        expect(page.get_by_label("Area clear of people")).not_to_be_checked()
    with subtests.test("in flight"):
        served.team = lambda _time_s: team
        expect(checklist).to_be_hidden()
