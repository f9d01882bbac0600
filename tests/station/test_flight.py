"""A stub team in flight, shown and commanded by the page: against what the vehicles themselves send on the bus."""

import asyncio
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import floor, hypot
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from agents.team.messages import BusMessage, MemberState, VehicleReport
from cordon.lockstep import LockstepClient
from gcs.console.team_bus import WatchedBus
from gcs.flight.stubs import url_ports
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.station.conftest import OpenPage
from tests.support.mission_text import LOW
from tests.support.wire import cordon, free_port, until_now

pytestmark = pytest.mark.browser

SHOWN_WITHIN_MS = 500
SPEED, SPEED_WHILE_PRESSED, HURRIED = 3.0, 1.0, 20.0
"""A busy computer shows what happens later: it must still be so then."""
CUT, CUT_AT_S = 3, 120.0
TARGET_M = (14.0, 0.0)
NEAR = (
    ("distance_max_m = 12.0", "distance_max_m = 40.0"),
    ("range_m = 15.0", "range_m = 60.0"),
    ("start_m = [35.0, -5.0]", f"start_m = [{TARGET_M[0]}, {TARGET_M[1]}]"),
    ("velocity_m_s = [0.1, 0.0]", "velocity_m_s = [0.0, 0.0]"),
)
PLACE_M = 0.8
"""How exactly a mark's place can be read: pixels, and a scale bar of whole pixels."""
READ = """() => {
  const centre = (node) => {
    const box = node.getBoundingClientRect();
    return [box.x + box.width / 2, box.y + box.height / 2];
  };
  const all = (place) => [...document.querySelectorAll(place)];
  const bar = document.querySelector(".maplibregl-ctrl-scale");
  const value = (node) => [node.dataset.quantity, node.textContent];
  const values = (card) => [...card.querySelectorAll("[data-quantity]")].map(value);
  const shown = (card) => ({ tactic: card.querySelector(".tactic").textContent, ...Object.fromEntries(values(card)) });
  return {
    cards: Object.fromEntries(all(".card").map((card) => [card.dataset.vehicle, shown(card)])),
    marks: Object.fromEntries(all(".symbol[data-vehicle]").map((mark) => [mark.dataset.vehicle, centre(mark)])),
    target: centre(document.querySelector(".symbol.target")),
    metre_px: bar.getBoundingClientRect().width / parseFloat(bar.textContent),
  };
}"""


class Bus:
    """The newest message of each kind that each vehicle of a mission has sent."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._newest: dict[tuple[type, int], MemberState | VehicleReport] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._listen()))

    def __enter__(self) -> "Bus":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    async def _listen(self) -> None:
        def keep(message: BusMessage) -> None:
            if isinstance(message, MemberState | VehicleReport):
                self._newest[type(message), message.sender] = message

        async with WatchedBus(self._mission, keep) as bus:
            while not self._stop.is_set():
                await bus.follow()
                await asyncio.sleep(0.05)

    def newest(self, kind: type[Any], vehicle: int) -> Any:
        """Return the newest message of a kind from a vehicle."""
        return self._newest[kind, vehicle]


@contextmanager
def flying(mission: str) -> Iterator[tuple[str, list[str]]]:
    """Fly beside a page; return the page's address, and the lines of the flight's text."""
    fault = f"link-cut@{CUT_AT_S:g}:{CUT}"
    page = ("--station", "--station-address", f"127.0.0.1:{free_port()}")
    options = ("--sitl", "--speed", f"{SPEED:g}", "--duration", "300", "--fault", fault)
    lines: list[str] = []
    with cordon("fly", mission, *options, *page) as flight:
        assert flight.stderr is not None
        reading = threading.Thread(
            target=lambda: lines.extend(iter(flight.stderr.readline, ""))  # type: ignore[union-attr]
        )
        reading.start()
        until_now(lambda: any("http://" in line for line in lines))
        found = re.search(r"http://\S+", "".join(lines))
        assert found is not None
        try:
            yield found[0], lines
        finally:
            flight.kill() if flight.poll() is None else None
            reading.join()


def shows(text: str, value: float | None, digits: int) -> bool:
    """Whether a text shows a value, rounded."""
    number = re.match(r"-?[\d.]+", text)
    if number is None or value is None:
        return text == "–" and value is None
    return abs(float(number[0]) - value) <= 0.5 * 10.0**-digits + 1e-6


def differing(shown: dict[str, str], state: MemberState, report: VehicleReport) -> list[str]:
    """Return the quantities of a card that differ from a vehicle's messages."""
    angle = state.angle
    holds = {
        "tactic": shown["tactic"] == state.tactic,
        "height": shows(shown["height"], state.altitude_m, 1),
        "speed": shows(shown["speed"], hypot(*state.velocity_m_s), 1),
        "radius": shows(shown["radius"], None if angle is None else angle.radius_m, 1),
        "rate": shows(shown["rate"], None if angle is None else angle.angular_rate_rad_s, 3),
        "mode": shown["mode"] == report.mode,
        "battery": shows(shown["battery"], floor(100.0 * (report.autopilot.battery or 0.0)), 0),
        "gps": f"{report.autopilot.satellites}\u00a0sat" in shown["gps"],
    }
    return [f"{name}: {shown[name]}" for name, found in holds.items() if not found]


def far_off(read: dict[str, Any], vehicle: int, state: MemberState) -> bool:
    """Whether a mark is far from the place: the mission's x axis points east, and east is right."""
    (x_px, y_px), (target_x_px, target_y_px) = read["marks"][str(vehicle)], read["target"]
    x_m = TARGET_M[0] + (x_px - target_x_px) / read["metre_px"]
    y_m = TARGET_M[1] - (y_px - target_y_px) / read["metre_px"]
    return hypot(x_m - state.position_m[0], y_m - state.position_m[1]) > PLACE_M


def check_all(page: Page, bus: Bus, clock: LockstepClient, vehicles: tuple[int, ...]) -> None:
    """Compare every card and mark with what the vehicles sent last, while their time stands still.

    It stands still for 2 s at most: where the page takes longer, on a busy computer, it is compared at another time.
    """
    found: list[tuple[int, list[str], bool]] = []
    for _ in range(20):
        with clock.held_after(0.3):
            page.wait_for_timeout(SHOWN_WITHIN_MS)
            read = page.evaluate(READ)
            sent = {each: (bus.newest(MemberState, each), bus.newest(VehicleReport, each)) for each in vehicles}
        found = [
            (vehicle, differing(read["cards"][str(vehicle)], state, report), far_off(read, vehicle, state))
            for vehicle, (state, report) in sent.items()
        ]
        if not any(differences or is_far for _, differences, is_far in found):
            return
    pytest.fail(f"vehicle, differences, far off: {found}")


@contextmanager
def pressed(page: Page, button: Locator) -> Iterator[None]:
    """Hold a button down for as long as what it does takes to be seen."""
    button.hover()
    page.mouse.down()
    yield
    page.mouse.up()


def command(page: Page, verb: str, vehicle: int, *, hold: bool = False) -> None:
    page.get_by_label(f"Select vehicle {vehicle}").check()
    button = page.locator(f"#verbs [data-verb='{verb}']")
    if hold:
        with pressed(page, button):
            expect(page.locator("#answers [data-request]").first).to_contain_text(verb, ignore_case=True)
    else:
        button.click()
    if verb == "kill":
        page.keyboard.type("kill")
        page.locator("#kill-send").click()
    page.get_by_label(f"Select vehicle {vehicle}").uncheck()


def test_a_team_is_shown_as_it_flies_and_obeys(open_page: OpenPage, mission_file: Callable[..., str]) -> None:
    path = mission_file("case2", *NEAR, LOW)
    mission = load_mission(path)
    with Bus(mission) as bus, flying(path) as (url, lines):
        page = open_page(url)
        expect(page.locator(".card .tactic", has_text="encircle")).to_have_count(3)
        expect(page.locator(".symbol[data-vehicle], .symbol.target")).to_have_count(4)
        ports = url_ports(mission, mission.ids).values()
        with LockstepClient(*ports, speed=SPEED_WHILE_PRESSED) as clock:
            for _ in range(2):
                check_all(page, bus, clock, (1, 2, 3))
            tactic = page.locator(".card[data-vehicle='2'] .tactic")
            command(page, "hold", 2)
            until_now(lambda: bus.newest(MemberState, 2).tactic == "hold")
            expect(tactic).to_have_text("hold")
            page.reload()
            expect(tactic).to_have_text("hold")
            command(page, "resume", 2)
            until_now(lambda: bus.newest(MemberState, 2).tactic == "encircle")
            expect(tactic).to_have_text("encircle")

        with LockstepClient(*ports, speed=HURRIED):
            until_now(lambda: any("injected: link cut" in line for line in lines))
        with LockstepClient(*ports, speed=SPEED_WHILE_PRESSED):
            expect(page.locator(f".symbol[data-vehicle='{CUT}']")).to_have_attribute("data-current", "false")
            expect(page.locator("#alarms")).to_contain_text(f"Vehicle {CUT}: ")
            page.get_by_role("button", name="Acknowledge").first.click()
            expect(page.locator("#alarms li").first).to_contain_text("(acknowledged)")

            command(page, "land", 1, hold=True)
            until_now(lambda: bus.newest(MemberState, 1).tactic == "land")
            expect(page.locator(".card[data-vehicle='1'] .tactic")).to_have_text("land")
            command(page, "kill", 2)
            until_now(lambda: bus.newest(VehicleReport, 2).ended != "")
            fallen = page.locator(".card[data-vehicle='2']")
            expect(fallen).to_have_attribute("data-trouble", "alarm")
            expect(fallen.locator(".headline")).to_contain_text("unaccounted for")
            assert "killed" in bus.newest(VehicleReport, 2).ended
        with LockstepClient(*ports, speed=HURRIED):
            expect(page.locator("#lost")).to_be_visible()  # the flight has ended: no card moves any more
        with pressed(page, fallen.locator(".recovered")):
            expect(fallen).to_have_attribute("data-trouble", "ended")
