"""What the page sends: each press once, with its confirmation, and nothing by a slip."""

from collections.abc import Callable

import pytest
from msgspec.structs import replace
from playwright.sync_api import Page, expect

from agents.team.messages import RingValues
from gcs.station.picture import AnswerPicture, CommandRequest, LostPicture, OperatorRights, ReceiptPicture, TeamPicture
from tests.station.conftest import NO_WEBGL, pass_time, stopped
from tests.support.page.canned_station import CannedStation
from tests.support.page.station_pictures import changed, ring_mission, ring_team, rings_mission, rings_team

pytestmark = pytest.mark.browser
HOLD_MS = 1000
SCRIPT = NO_WEBGL


def sent(page: Page, served: CannedStation) -> list[CommandRequest]:
    """Return what has been sent since this was last asked, after a while in which more could come."""
    pass_time(page, 300)
    served.await_requests(page)
    requests, served.requests = served.requests, []
    return requests


def verb(page: Page, name: str) -> Callable[[], None]:
    return page.locator(f"#verbs [data-verb='{name}']").click


def press_for(page: Page, name: str, time_ms: float) -> None:
    page.locator(f"#verbs [data-verb='{name}']").hover()
    with stopped(page):
        page.mouse.down()
        pass_time(page, time_ms)
        page.mouse.up()


def held(page: Page, served: CannedStation) -> list[CommandRequest]:
    """Return what is sent while a button is held for longer than it needs."""
    pass_time(page, 1.5 * HOLD_MS)
    return sent(page, served)


def by_pilot(vehicle_id: int) -> Callable[[float], TeamPicture]:
    return lambda time_s: changed(ring_team(ring_mission(), 100.0 + time_s), vehicle_id, tactic="pilot override")


def test_a_press_sends_one_command_however_long_a_key_is_held(page: Page, served: CannedStation) -> None:
    numbers = set()
    for name in ("hold", "resume", "abort"):
        verb(page, name)()
        (request,) = sent(page, served)
        assert (request.verb, request.vehicles, request.confirmation) == (name, None, "")
        assert not request.overrides_pilot
        page.locator(f"#verbs [data-verb='{name}']").focus()
        for _ in range(5):  # what a keyboard repeats
            page.keyboard.down("Enter")
        page.keyboard.up("Enter")
        (again,) = sent(page, served)
        numbers |= {request.request, again.request}
    assert len(numbers) == 6


def test_a_selection_is_for_one_command_and_ends_after_ten_seconds_but_not_under_a_press(
    page: Page, served: CannedStation
) -> None:
    text = page.locator("#target-text")
    page.get_by_label("Select vehicle 1").check()
    page.get_by_label("Select vehicle 3").check()
    expect(text).to_have_text("To vehicles 1, 3")
    expect(page.get_by_role("button", name="Hold 1, 3")).to_be_visible()
    verb(page, "hold")()
    expect(text).to_have_text("To all 3 vehicles")
    page.get_by_label("Select vehicle 2").check()
    page.get_by_role("button", name="All", exact=True).click()
    expect(page.get_by_role("button", name="Land all 3, hold 1 s")).to_be_visible()
    verb(page, "hold")()
    assert [request.vehicles for request in sent(page, served)] == [(1, 3), None]
    select = "document.querySelector('.card[data-vehicle=\"2\"] input').click()"
    with stopped(page):
        page.locator("#verbs [data-verb='land']").hover()
        page.evaluate(select)
        expect(page.locator("#target-rest")).to_have_text("for 10 s")
        pass_time(page, 9_500)
        expect(text).to_have_text("To vehicle 2")
        page.mouse.down()
        pass_time(page, 1.5 * HOLD_MS)
        page.mouse.up()
    assert [(request.verb, request.vehicles) for request in sent(page, served)] == [("land", (2,))]
    with stopped(page):  # a press right after the end asks again
        page.locator("#verbs [data-verb='resume']").hover()
        page.evaluate(select)
        while text.inner_text() == "To vehicle 2":
            pass_time(page, 100)
        page.mouse.down()
        page.mouse.up()
        expect(page.locator("#answers > li").first).to_contain_text("Not sent. The selection had just ended")
        pass_time(page, 1000)
        page.mouse.down()
        page.mouse.up()
    assert [(request.verb, request.vehicles) for request in sent(page, served)] == [("resume", None)]


def set_slider(page: Page, label: str, value: float) -> None:
    page.get_by_role("slider", name=label).evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }", value
    )


def test_a_ring_is_chosen_within_what_the_team_can_fly(page: Page, served: CannedStation) -> None:
    """At 10 m 2 m/s and 0.5 m/s² allow 0.2 and 0.224 rad/s, at 40 m 0.05 and 0.112 rad/s."""
    page.get_by_label("Select vehicle 2").check()
    expect(page.get_by_role("button", name="Change ring… all 3")).to_be_visible()
    verb(page, "ring")()
    dialog, change = page.get_by_role("dialog"), page.get_by_role("button", name="Change the ring")
    expect(dialog).to_contain_text("10.0 m (2.5 to 39.5 m)")
    expect(dialog).to_contain_text("0.050 rad/s (up to 0.200 either way)")
    expect(dialog).to_contain_text("0.50 m/s along the ring, counter-clockwise, one turn in 126 s")
    expect(change).to_be_disabled()
    set_slider(page, "Angular rate", -0.9)
    expect(dialog).to_contain_text("2.00 m/s along the ring, clockwise, one turn in 31 s")
    change.click()
    expect(dialog).to_be_hidden()
    (request,) = sent(page, served)
    assert (request.verb, request.vehicles, request.ring) == ("ring", None, RingValues(None, -0.2, None, None))
    served.team = lambda time_s: replace(by_pilot(1)(time_s), ring=RingValues(None, -0.2))
    expect(page.locator(".card .tactic").first).to_have_text("pilot override")
    verb(page, "ring")()
    expect(dialog).to_contain_text("-0.200 rad/s")
    set_slider(page, "Radius", 39.5)
    expect(dialog).to_contain_text("-0.050 rad/s (up to 0.050 either way)")
    change.click()
    assert [each.ring for each in sent(page, served)] == [RingValues(39.5, -0.05)]
    verb(page, "ring")()
    set_slider(page, "Altitude", 14.0)
    set_slider(page, "Tilt", 90.0)
    expect(dialog).to_contain_text("14.0 m (2 to 30 m)")
    expect(dialog).to_contain_text("26° (up to 26° either way)")  # 1 m/s at 0.2 rad/s are 5 m up and down at 10 m
    change.click()
    assert [each.ring for each in sent(page, served)] == [RingValues(None, None, 14.0, 26.0)]
    verb(page, "ring")()
    page.get_by_role("button", name="Cancel").click()
    verb(page, "ring")()
    page.keyboard.press("h")  # a hold closes the dialog
    expect(dialog).to_be_hidden()
    assert [each.verb for each in sent(page, served)] == ["hold"]


def test_of_several_rings_one_is_changed_and_vehicles_are_assigned_to_one(page: Page, served: CannedStation) -> None:
    expect(page.locator("#verbs [data-verb='assign']")).to_have_count(0)  # with one ring
    verb(page, "ring")()
    expect(page.locator("#ring-name")).to_be_hidden()
    page.get_by_role("button", name="Cancel").click()
    served.team = rings_team
    served.begin(rings_mission(), rings_team)
    page.reload()
    expect(page.locator(".card .tactic")).to_have_text(["encircle north", "encircle south", "formation"])
    verb(page, "ring")()
    dialog, chosen = page.get_by_role("dialog"), page.locator("#ring-name")
    expect(chosen.locator("option")).to_have_text(["north", "south", "high"])
    expect(dialog).to_contain_text("10.0 m (2.5 to 39.5 m)")
    set_slider(page, "Radius", 20.0)
    chosen.select_option("south")
    expect(dialog).to_contain_text("12.0 m (2.5 to 39.5 m)")  # as commanded
    expect(dialog).to_contain_text("0.060 rad/s")
    chosen.select_option("high")
    expect(dialog).to_contain_text("8.0 m (2 to 19.5 m)")
    expect(dialog).to_contain_text("-0.100 rad/s")
    set_slider(page, "Radius", 9.0)
    page.get_by_role("button", name="Change the ring").click()
    (request,) = sent(page, served)
    assert (request.verb, request.vehicles) == ("ring", None)
    assert (request.ring, request.ring_number) == (RingValues(9.0), 2)
    for select, answer, number in (((1,), "high", 2), ((2, 3), "its own choice", None), ((), "north", 0)):
        for vehicle_id in select:
            page.get_by_label(f"Select vehicle {vehicle_id}").check()
        verb(page, "assign")()
        expect(dialog).to_contain_text("Assign")
        if select == (1,):
            expect(page.locator("#assign-name")).to_have_value("0")  # where it is
        page.locator("#assign-name").select_option(answer)
        page.get_by_role("button", name="Assign", exact=True).click()
        (request,) = sent(page, served)
        assert (request.verb, request.vehicles) == ("assign", select or (1, 2, 3))
        assert (request.ring, request.ring_number) == (None, number)


def test_hold_all_is_for_all_whatever_is_selected(page: Page, served: CannedStation) -> None:
    page.get_by_label("Select vehicle 2").check()
    page.locator("#hold-all").click()
    page.get_by_label("Select vehicle 2").check()
    page.keyboard.press("h")  # as at the terminal: to the selection
    page.keyboard.press("h")
    page.keyboard.press("Control+h")
    for _ in range(5):
        page.keyboard.down("h")  # held down: once
    page.keyboard.up("h")
    requests = [(request.verb, request.vehicles) for request in sent(page, served)]
    assert requests == [("hold", None), ("hold", (2,)), ("hold", None), ("hold", None)]
    verb(page, "kill")()
    page.keyboard.press("h")
    expect(page.get_by_role("dialog")).to_be_hidden()
    assert [request.verb for request in sent(page, served)] == ["hold"]


def test_vehicles_whose_flight_has_ended_are_not_counted(page: Page, served: CannedStation) -> None:
    mission = ring_mission()
    page.get_by_label("Select vehicle 2").check()
    served.team = lambda time_s: changed(
        ring_team(mission, 100.0 + time_s), 2, has_ended=True, ending="landed and disarmed"
    )
    expect(page.locator("#target-text")).to_have_text("To all 2 vehicles (1 ended)")
    expect(page.locator("#hold-all")).to_have_text("Hold all 2")
    expect(page.get_by_label("Select vehicle 2")).to_be_disabled()
    verb(page, "hold")()
    (request,) = sent(page, served)
    assert request.vehicles is None
    expect(page.locator(f"#answers [data-request='{request.request}']")).to_contain_text("Waiting for all 2 vehicles")
    served.team = lambda time_s: changed(
        ring_team(mission, 200.0 + time_s), 2, is_unaccounted=True, ending="lost: its link was lost"
    )
    expect(page.locator("#target-text")).to_have_text("To all 2 vehicles (1 missing)")
    expect(page.get_by_label("Select vehicle 2")).to_be_disabled()


def test_a_flight_without_processes_receives_no_commands(page: Page, served: CannedStation) -> None:
    mission = ring_mission()
    expect(page.locator("#hold-all")).to_be_enabled()
    picture = LostPicture("every process has ended", (1, 2, 3), 100.0, "", "watch them")
    for ended in (False, True, False):  # a network that is cut may come back
        lost = replace(picture, processes_ended=ended)
        served.team = lambda time_s, lost=lost: replace(ring_team(mission, 100.0 + time_s), lost=lost)
        for button in ("#hold-all", "#verbs [data-verb='land']"):
            expect(page.locator(button)).to_be_enabled(enabled=not ended)
        served.await_pictures(page)
        page.keyboard.press("h")
        assert len(sent(page, served)) == (not ended)


def test_land_and_return_have_to_be_held(page: Page, served: CannedStation) -> None:
    land = page.locator("#verbs [data-verb='land']")
    for name in ("land", "rtl"):
        for time_ms in (0.0, 0.8 * HOLD_MS):  # a click, which a busy computer may take long for, and too short a press
            press_for(page, name, time_ms)
        assert sent(page, served) == []
        page.mouse.down()
        assert [(request.verb, request.vehicles) for request in held(page, served)] == [(name, None)]
        page.mouse.up()
        assert sent(page, served) == []
    land.focus()
    for key in ("Enter", " "):
        with stopped(page):
            page.keyboard.down(key)
            pass_time(page, 0.8 * HOLD_MS)
            page.keyboard.up(key)
    assert sent(page, served) == []
    page.keyboard.down("Enter")
    assert [request.verb for request in held(page, served)] == ["land"]
    page.keyboard.up("Enter")
    assert sent(page, served) == []


def test_leaving_the_button_and_time_in_which_the_page_stands_still_are_not_held(
    page: Page, served: CannedStation
) -> None:
    land = page.locator("#verbs [data-verb='land']")
    with stopped(page):
        land.hover()
        page.mouse.down()
        pass_time(page, 0.5 * HOLD_MS)
        page.mouse.move(5, 5)
        pass_time(page, HOLD_MS)
        page.mouse.up()
        land.focus()
        page.keyboard.down("Enter")
        pass_time(page, 0.5 * HOLD_MS)
        page.locator("#verbs [data-verb='hold']").focus()
        pass_time(page, HOLD_MS)
        page.keyboard.up("Enter")
        land.hover()
        page.mouse.down()
        pass_time(page, 0.2 * HOLD_MS)
        page.clock.fast_forward(1500)
        pass_time(page, 0.1 * HOLD_MS)
        page.mouse.up()
    assert sent(page, served) == []


def paste(page: Page) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.evaluate("() => navigator.clipboard.writeText('kill')")
    page.keyboard.press("Control+V")


def drop_in(page: Page) -> None:
    page.keyboard.insert_text("kill")  # as a completion or a dropped text


def repeat(page: Page) -> None:
    page.keyboard.type("ki")
    page.keyboard.down("l")
    page.keyboard.down("l")  # the keyboard's repeat
    page.keyboard.up("l")


def type_a_part(page: Page) -> None:
    page.keyboard.press("Enter")
    page.keyboard.type("kil")


def test_kill_needs_its_word_typed(page: Page, served: CannedStation, subtests: pytest.Subtests) -> None:
    for way in (paste, drop_in, repeat, type_a_part):
        with subtests.test(way.__name__):
            verb(page, "kill")()
            expect(page.locator("#kill-word")).to_have_value("")
            way(page)
            expect(page.locator("#kill-send")).to_be_disabled()
            page.keyboard.press("Enter")
            assert sent(page, served) == []
            page.keyboard.press("Escape")
            expect(page.get_by_role("dialog")).to_be_hidden()
    page.get_by_label("Select vehicle 2").check()
    verb(page, "kill")()
    expect(page.get_by_role("dialog")).to_contain_text("Cut the motors of vehicle 2")
    page.keyboard.type("kill")
    page.locator("#kill-send").click()
    (request,) = sent(page, served)
    assert (request.verb, request.vehicles, request.confirmation) == ("kill", (2,), "kill")
    expect(page.get_by_role("dialog")).to_be_hidden()


def test_resume_of_a_pilots_vehicle_asks_first(page: Page, served: CannedStation) -> None:
    served.team = by_pilot(2)
    expect(page.locator(".card[data-vehicle='2'] .tactic")).to_have_text("pilot override")
    verb(page, "resume")()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("Vehicle 2 is flown by its pilot or autopilot")
    expect(page.get_by_role("button", name="Leave it")).to_be_focused()
    for _ in range(5):  # a held key chooses nothing but the careful answer
        page.keyboard.down("Enter")
    page.keyboard.up("Enter")
    assert sent(page, served) == []
    verb(page, "resume")()
    page.get_by_role("button", name="Resume only vehicles 1, 3").click()
    verb(page, "resume")()
    page.get_by_role("button", name="Take over all 3 vehicles").click()
    requests = [(request.vehicles, request.overrides_pilot) for request in sent(page, served)]
    assert requests == [((1, 3), False), (None, True)]
    page.get_by_label("Select vehicle 1").check()
    verb(page, "resume")()
    assert [(request.vehicles, request.overrides_pilot) for request in sent(page, served)] == [((1,), False)]


def test_answers_are_shown_with_their_time(page: Page, served: CannedStation) -> None:
    verb(page, "hold")()
    (request,) = sent(page, served)
    answers = page.locator(f"#answers [data-request='{request.request}']")
    expect(answers).to_contain_text("Hold, all 3 vehicles")
    expect(answers).to_contain_text("Waiting for all 3 vehicles")
    served.send(AnswerPicture(request.request, "hold", 1, "holds", 0.12, is_obeyed=True, is_final=True))
    served.send(AnswerPicture(request.request, "hold", 2, "is flown by its pilot", 0.2, is_obeyed=False, is_final=True))
    expect(answers).to_contain_text("✓ Vehicle 1: holds, after 0.1\u00a0s")
    expect(answers).to_contain_text("✗ Vehicle 2: is flown by its pilot, after 0.2\u00a0s")
    expect(answers).to_contain_text("Waiting for vehicle 3")
    served.send(AnswerPicture("0123", "hold", 3, "of another page", 0.2, is_obeyed=True, is_final=True))
    expect(page.locator("#answers")).not_to_contain_text("of another page")


def test_a_command_that_was_not_delivered_is_told_and_not_repeated(page: Page, served: CannedStation) -> None:
    served.is_slow = True
    verb(page, "hold")()
    (request,) = sent(page, served)
    slow = page.locator(f"#answers [data-request='{request.request}']")
    expect(slow).to_contain_text("Waiting for all 3 vehicles")
    pass_time(page, 1500)
    expect(slow).to_contain_text("Not delivered to the station yet")
    served.send(ReceiptPicture(request.request))
    expect(slow).to_contain_text("Waiting for all 3 vehicles")
    verb(page, "resume")()
    assert [request.verb for request in sent(page, served)] == ["resume"]
    served.is_refusing = True
    served.disconnect()
    answers = page.locator("#answers > li")
    expect(answers.nth(0)).to_contain_text("Connection lost before it was delivered to the station")
    expect(answers.nth(1)).to_contain_text("Connection lost before all 3 vehicles answered")
    verb(page, "abort")()
    expect(answers.first).to_contain_text("Not sent")
    expect(page.locator("#link")).to_have_text("■ no station")
    served.is_refusing = False
    expect(page.locator("#link")).to_have_text("● connected")
    assert sent(page, served) == []


def test_only_what_the_operator_may_is_offered(page: Page, served: CannedStation) -> None:
    offered = "#verbs button"
    verbs = [button.get_attribute("data-verb") for button in page.locator(offered).all()]
    assert verbs == ["hold", "resume", "rtl", "land", "abort", "ring", "rejoin", "kill"]
    served.send(replace(ring_mission(), operator=OperatorRights("ben", ("hold",))))
    expect(page.locator(offered)).to_have_count(1)
    expect(page.locator("#rights")).to_have_text("ben")
    served.send(ring_mission(may=()))
    expect(page.locator(offered)).to_have_count(0)
    expect(page.locator("#read-only")).to_be_visible()
    expect(page.locator("#rights")).to_have_text("read only")
    served.send(replace(ring_mission(), operator=OperatorRights(read_only="there are no keys here")))
    expect(page.locator("#read-only")).to_have_text("Read-only: there are no keys here.")
    expect(page.locator(".card")).to_have_count(3)
    team = served.team
    assert team is not None
    served.team = lambda time_s: replace(team(time_s), ending="landed")
    expect(page.locator("#read-only")).to_contain_text("Flight over")
    expect(page.locator("#rights")).to_have_text("flight over")


def test_answers_move_no_button(page: Page, subtests: pytest.Subtests) -> None:
    for number, width in enumerate((1920, 390), start=1):
        with subtests.test(width=width):
            page.set_viewport_size({"width": width, "height": 844})
            before = [page.locator(f"#verbs [data-verb='{name}']").bounding_box() for name in ("hold", "kill")]
            page.locator("#hold-all").click()
            verb(page, "hold")()
            expect(page.locator("#answers > li")).to_have_count(2 * number)
            assert [page.locator(f"#verbs [data-verb='{name}']").bounding_box() for name in ("hold", "kill")] == before
