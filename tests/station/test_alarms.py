"""Alarms and events on the page: sound, words, acknowledgement, and what is read out."""

import pytest
from msgspec.structs import replace
from playwright.sync_api import Page, expect

from gcs.console.vehicle_view import NextView
from gcs.station.picture import EventPicture, LostPicture, TeamPicture
from tests.station.conftest import NO_WEBGL, OpenPage, pass_time, stopped
from tests.support.page.canned_station import RATE_HZ, CannedStation
from tests.support.page.station_pictures import changed, ring_mission, ring_team

pytestmark = pytest.mark.browser
REPEATED_MS = 2000
# Counts the tones that are started: headless browsers have no loudspeaker.
COUNT_TONES = (
    "window.tones = 0; const start = OscillatorNode.prototype.start;"
    "OscillatorNode.prototype.start = function (...when) { window.tones += 1; return start.apply(this, when); };"
)
# The time of a page waits for the next picture: one that a busy computer brings late raises no alarm of its own.
WAIT_FOR_PICTURES = """
const now_ms = performance.now.bind(performance);
let [heard, heard_ms] = [0, 0];
performance.now = () => {
  if (window.heard !== heard) [heard, heard_ms] = [window.heard, now_ms()];
  return Math.min(now_ms(), heard_ms + 1000);
};
"""
SIGNALS = (
    "window.vibrated = 0; Object.defineProperty(navigator, 'vibrate', {value: () => { window.vibrated += 1; }});"
    "window.locks = []; Object.defineProperty(navigator, 'wakeLock', {value: { request: async (kind) => {"
    "  const lock = {released: false, release: async () => { lock.released = true; }};"
    "  window.locks.push(lock); return lock; }}});"
)
SCRIPT = NO_WEBGL + COUNT_TONES + SIGNALS + WAIT_FOR_PICTURES
MISSION = ring_mission()


def well(time_s: float) -> TeamPicture:
    return ring_team(MISSION, 100.0 + time_s)


def link_lost(time_s: float) -> TeamPicture:
    return changed(well(time_s), 2, alert="link lost", advice="Wait: it lands by itself.", severity="alarm")


def two_alarms(time_s: float) -> TeamPicture:
    return changed(link_lost(time_s), 3, alert="battery empty", advice="Land it.", severity="alarm")


def lost(time_s: float) -> TeamPicture:
    """A flight that was lost 71 s before."""
    team = well(time_s)
    why = "no tick of the control loop of vehicle 2 for 0.7 s: the flying process 77 was killed"
    picture = LostPicture(why, (1, 2, 3), team.wall_s - 71.0, "only their autopilots control them now", "watch them")
    silent = tuple(replace(each, is_stale=True, age_s=71.0) for each in team.vehicles)
    return replace(team, vehicles=silent, lost=picture)


def battery_empty_too(time_s: float) -> TeamPicture:
    return changed(link_lost(time_s), 2, alert="battery empty", advice="Land it.")


def tones_in(page: Page, served: CannedStation, time_ms: float) -> int:
    """Let time pass on the page, in which pictures arrive as often as ever, and return how many tones began."""
    before: int = page.evaluate("window.tones")
    for _ in range(round(time_ms * RATE_HZ / 1000.0)):
        assert served.team is not None
        served.send(served.team(0.0))
        served.await_pictures(page)
        pass_time(page, 1000.0 / RATE_HZ)
    after: int = page.evaluate("window.tones")
    return after - before


def test_rows_of_alarms(page: Page, served: CannedStation) -> None:
    """Their order and groups, what follows, and that an alarm behind a graver one of its vehicle is not called over."""
    rows = page.locator("#alarm-bar li")

    def stale(time_s: float) -> TeamPicture:
        team = well(time_s)
        for vehicle_id in (1, 2, 3):
            team = changed(team, vehicle_id, alert="target stale", advice="Find it.", severity="alarm")
        return changed(team, 3, alert="battery empty", advice="Land it.")

    def cleared() -> None:
        served.team = well
        expect(page.locator("#worst")).to_have_text("● none")
        page.get_by_role("button", name="Acknowledge").click()
        expect(page.locator("#alarm-bar")).to_be_hidden()

    served.team = stale
    expect(rows).to_have_text(
        ["■ ALARM Vehicles 1, 2: target stale. Find it.", "■ ALARM Vehicle 3: battery empty. Land it."]
    )
    expect(page.locator("#assertive")).to_have_text(
        "Alarm. Vehicles 1, 2: target stale. Find it. Alarm. Vehicle 3: battery empty. Land it."
    )
    cleared()
    over = {"alert": "waits for resume", "advice": "Resume it.", "severity": "alarm", "waits_for_resume": True}
    served.team = lambda time_s: changed(link_lost(time_s), 3, **over)
    expect(rows).to_contain_text(["Vehicle 3: waits for resume", "Vehicle 2: link lost"])
    expect(page.locator(".card h3")).to_contain_text(["3", "2", "1"])
    cleared()
    lands = {"next": NextView("lands", 17.2, "estimator failing"), "blocks": "estimator failing"}
    served.team = lambda time_s: changed(link_lost(time_s), 2, also=("estimator failing", "tilt too large"), **lands)
    words = "lands in 18 s (estimator failing); resume refused: estimator failing; also tilt too large"
    expect(page.locator(".card[data-vehicle='2'] .due")).to_have_text(words)
    expect(rows).to_contain_text(f"link lost. {words}.")
    served.team = lambda time_s: changed(link_lost(time_s), 2, next=NextView("lands", 3.9, "link lost"))
    expect(rows).to_contain_text("link lost. lands in 4 s.")
    expect(page.locator(".card[data-vehicle='1'] .due")).to_be_hidden()
    page.get_by_role("button", name="Acknowledge").click()
    served.team = battery_empty_too
    expect(rows).to_have_text("■ ALARM Vehicle 2: battery empty. Land it.")
    expect(rows).to_have_attribute("data-state", "new")
    served.team = well
    expect(rows).to_have_text("□ OVER Vehicle 2: battery empty. ")
    served.team = link_lost
    expect(rows).to_contain_text(["ALARM Vehicle 2: link lost", "OVER Vehicle 2: battery empty"])


def test_an_alarm_sounds_until_it_is_acknowledged_and_stays_until_then(page: Page, served: CannedStation) -> None:
    rows, acknowledge = page.locator("#alarms li"), page.get_by_role("button", name="Acknowledge")
    expect(page.locator("#sound")).to_have_text("Sound: press once")
    page.mouse.click(5, 5)  # browsers let a page sound after a gesture
    expect(page.locator("#sound")).to_have_text("Sound on")
    expect(page.locator("#alarm-bar")).to_be_hidden()
    assert tones_in(page, served, 1.2 * REPEATED_MS) == 0
    served.team = link_lost
    expect(rows).to_have_text("■ ALARM Vehicle 2: link lost. Wait: it lands by itself.")
    expect(page.locator("#assertive")).to_have_text("Alarm. Vehicle 2: link lost. Wait: it lands by itself.")
    assert tones_in(page, served, 2.2 * REPEATED_MS) >= 4
    acknowledge.click()
    expect(rows).to_contain_text("(acknowledged)")
    assert tones_in(page, served, 1.2 * REPEATED_MS) == 0
    served.team = two_alarms
    expect(rows).to_have_count(2)
    assert tones_in(page, served, 1.2 * REPEATED_MS) >= 2
    served.team = well
    expect(rows).to_have_text(["□ OVER Vehicle 3: battery empty. "])
    assert tones_in(page, served, 1.2 * REPEATED_MS) == 0
    expect(page.locator("#worst")).to_have_text("● none")
    acknowledge.click()
    expect(page.locator("#alarm-bar")).to_be_hidden()
    served.team = link_lost  # it comes again: it is a new one
    expect(rows).to_have_attribute("data-state", "new")


def test_sound_can_be_turned_off_and_on_and_the_press_that_unlocks_it_leaves_it_on(
    page: Page, served: CannedStation
) -> None:
    switch = page.locator("#sound")
    switch.click()
    expect(switch).to_have_text("Sound on")
    switch.click()
    expect(switch).to_have_text("Sound off")
    served.team = link_lost
    expect(page.locator("#alarms li")).to_have_count(1)
    assert tones_in(page, served, 1.2 * REPEATED_MS) == 0
    switch.click()
    assert tones_in(page, served, 1.2 * REPEATED_MS) >= 2


def test_alarm_is_in_the_title_and_vibrates_and_the_screen_stays_on_until_the_flight_ends_without_an_alarm(
    page: Page, served: CannedStation
) -> None:
    expect(page).to_have_title("case2 - cordon")
    page.mouse.click(5, 5)
    served.team = link_lost
    expect(page).to_have_title("■ Vehicle 2: link lost · case2 - cordon")
    assert page.evaluate("vibrated") >= 1
    served.team = two_alarms
    expect(page).to_have_title("■ 2 alarms · case2 - cordon")
    page.get_by_role("button", name="Acknowledge").click()
    before = page.evaluate("vibrated")
    tones_in(page, served, 1.2 * REPEATED_MS)
    assert page.evaluate("vibrated") == before
    assert page.evaluate("locks.map(lock => lock.released)") == [False]
    served.team = lambda time_s: replace(link_lost(time_s), ending="landed and disarmed")
    expect(page.locator("#ending")).to_have_text("Flight over: landed and disarmed")
    expect(page).to_have_title("case2 - cordon")
    assert page.evaluate("locks.map(lock => lock.released)") == [True]
    served.is_refusing = True
    served.disconnect()
    expect(page.locator("#link")).to_have_text("■ no station")
    pass_time(page, 500)
    expect(page.locator("#alarm-bar")).to_be_hidden()


def event(number: int, severity: str = "information", vehicle_id: int | None = None) -> EventPicture:
    return EventPicture(number, 60.0 * number, 1.7e9, severity, f"what {number}", vehicle_id)  # type: ignore[arg-type]


def test_events_newest_first_and_each_once_and_past_ones_are_not_read_out(page: Page, served: CannedStation) -> None:
    pass_time(page, 1100)
    for each in (event(1), event(2, "warning", 3), event(3, "alarm", 1)):
        served.send(each)
    rows = page.locator("#events li")
    expect(rows).to_have_count(3)
    assert [row.inner_text().replace("\n", " ") for row in rows.all()] == [
        "3:00 ■ ALARM Vehicle 1: what 3",
        "2:00 ▲ Warning Vehicle 3: what 2",
        "1:00 ● Information what 1",
    ]
    expect(page.locator("#polite")).to_have_text("ALARM: Vehicle 1: what 3")
    served.is_refusing = True
    served.disconnect()
    expect(page.locator("#link")).to_have_text("■ no station")
    served.is_refusing = False  # the station sends the past again
    expect(page.locator("#link")).to_have_text("● connected")
    for number in (4, 4, 5):
        served.send(event(number))
    expect(rows.first).to_contain_text("what 5")
    expect(rows).to_have_count(5)
    with stopped(page):  # what comes within a second of the page's time is of the past
        page.reload()
        expect(rows).to_have_count(5)
        expect(page.locator("#polite")).to_be_empty()


def test_a_lost_flight_is_shown_with_what_controls_the_vehicles_and_a_clock_that_counts_up(
    page: Page, served: CannedStation
) -> None:
    banner = page.locator("#lost")
    expect(banner).to_be_hidden()
    served.team = lost
    expect(banner).to_be_visible()
    for part in ("All 3 vehicles", "No tick of the control loop of vehicle 2 for 0.7 s", "only their autopilots"):
        expect(banner).to_contain_text(part, ignore_case=True)
    expect(page.locator("#lost-advice")).to_contain_text("Watch them.")
    expect(page.locator("#alarms li")).to_contain_text(["unaccounted for"])
    expect(page.locator(".card .headline").first).to_contain_text("last seen 71 s ago")
    expect(page.locator("#ending")).to_be_hidden()
    expect(page.locator("#lost-since")).to_have_text("1:11")
    since_s = seconds(page)
    served.team = lambda time_s: replace(lost(time_s), wall_s=well(time_s).wall_s + 100.0)
    expect(page.locator("#lost-since")).to_have_text("2:51")
    assert seconds(page) == since_s + 100
    served.team = well
    expect(banner).to_be_hidden()


def seconds(page: Page) -> int:
    minutes, seconds = page.locator("#lost-since").inner_text().split(":")
    return 60 * int(minutes) + int(seconds)


SPEECH = """
window.said = [];
window.SpeechSynthesisUtterance = class { constructor(text) { this.text = text; } };
Object.defineProperty(window, "speechSynthesis", {
  value: { speak: ({ text }) => said.push(text), cancel: () => said.push("") },
});
"""


def test_a_voice_says_alarms_once_it_is_turned_on(open_page: OpenPage) -> None:
    mission = ring_mission()
    alert = ""

    def team(time_s: float) -> TeamPicture:
        severity = "alarm" if alert else "information"
        return changed(ring_team(mission, time_s), 2, alert=alert, advice="Take over." * bool(alert), severity=severity)

    with CannedStation(mission, team) as station:
        page = open_page(station.url, script=NO_WEBGL + SPEECH)
        voice = page.locator("#voice")
        expect(voice).to_have_text("Voice off")
        alert = "GPS jammed"
        expect(page.locator("#alarms li")).to_have_count(1)
        assert page.evaluate("said") == []
        voice.click()
        expect(voice).to_have_text("Voice on")
        alert = "link lost"
        expect(page.locator("#alarms")).to_contain_text("link lost")
        assert page.evaluate("said") == ["Voice on", "Alarm. Vehicle 2: link lost. Take over."]
        voice.click()
        alert = "battery low"
        expect(page.locator("#alarms")).to_contain_text("battery low")
        assert page.evaluate("said.slice(2)") == [""]


def test_without_a_voice_of_the_browser_there_is_no_button(open_page: OpenPage) -> None:
    silent = (
        "delete Window.prototype.speechSynthesis; Object.defineProperty(window, 'speechSynthesis', { value: null });"
    )
    with CannedStation(ring_mission(), lambda time_s: ring_team(ring_mission(), time_s)) as station:
        page = open_page(station.url, script=NO_WEBGL + silent)
        expect(page.locator("#sound")).to_be_visible()
        expect(page.locator("#voice")).to_be_hidden()
