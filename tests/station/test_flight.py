"""A stub team in flight, shown and commanded by the page: against what the vehicles themselves send on the bus."""

import asyncio
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import floor, hypot
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from agents.team.messages import BusMessage, MemberState, VehicleReport
from gcs.console.watched_bus import WatchedBus
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.station.conftest import OpenPage
from tests.support.mission_text import LOW
from tests.support.wire import cordon, free_port, until_now

pytestmark = pytest.mark.browser

WITHIN_S = 0.5
STALE_WITHIN_S = 1.5
SPEED = 3
CUT, CUT_AT_S = 3, 75.0
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
    """What the vehicles of a mission send, each message with the time of its arrival."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._heard: list[tuple[float, BusMessage]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._listen()))

    def __enter__(self) -> "Bus":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    async def _listen(self) -> None:
        async with WatchedBus(self._mission, lambda message: self._heard.append((time.monotonic(), message))) as bus:
            while not self._stop.is_set():
                await bus.follow()
                await asyncio.sleep(0.05)

    def of(self, kind: type[Any], vehicle: int, since_s: float = 0.0) -> list[Any]:
        """Return a vehicle's messages of a kind that were its newest at some time since."""
        times = [(at_s, each) for at_s, each in list(self._heard) if isinstance(each, kind) and each.sender == vehicle]
        before = [each for at_s, each in times if at_s < since_s][-1:]
        return before + [each for at_s, each in times if at_s >= since_s]


@contextmanager
def flying(mission: str) -> Iterator[tuple[str, list[tuple[float, str]]]]:
    """Fly beside a page; return the page's address, and the lines of the flight's text with their times."""
    fault = f"link-cut@{CUT_AT_S:g}:{CUT}"
    page = ("--station", "--station-address", f"127.0.0.1:{free_port()}")
    options = ("--sitl", "--speed", str(SPEED), "--duration", "200", "--fault", fault)
    lines: list[tuple[float, str]] = []
    with cordon("fly", mission, *options, *page) as flight:
        assert flight.stderr is not None
        reading = threading.Thread(
            target=lambda: lines.extend((time.monotonic(), line) for line in iter(flight.stderr.readline, ""))  # type: ignore[union-attr]
        )
        reading.start()
        until_now(lambda: any("http://" in line for _, line in lines), 30.0)
        found = re.search(r"http://\S+", "".join(line for _, line in lines))
        assert found is not None
        try:
            yield found[0], lines
        finally:
            flight.kill() if flight.poll() is None else None
            reading.join()


def shows(text: str, values: list[float | None], digits: int) -> bool:
    """Whether a text shows one of these values, rounded."""
    number = re.match(r"-?[\d.]+", text)
    if number is None:
        return text == "–" and None in values
    known = [each for each in values if each is not None]
    return any(abs(float(number[0]) - each) <= 0.5 * 10.0**-digits + 1e-6 for each in known)


def differing(shown: dict[str, str], states: list[MemberState], reports: list[VehicleReport]) -> list[str]:
    """Return the quantities of a card that none of the newest messages holds."""
    angles = [each.angle for each in states]
    holds = {
        "tactic": shown["tactic"] in [each.tactic for each in states],
        "height": shows(shown["height"], [each.altitude_m for each in states], 1),
        "speed": shows(shown["speed"], [hypot(*each.velocity_m_s) for each in states], 1),
        "radius": shows(shown["radius"], [None if each is None else each.radius_m for each in angles], 1),
        "rate": shows(shown["rate"], [None if each is None else each.angular_rate_rad_s for each in angles], 3),
        "mode": shown["mode"] in [each.mode for each in reports],
        "battery": shows(shown["battery"], [floor(100.0 * (each.battery or 0.0)) for each in reports], 0),
        "gps": any(f"{each.satellites}\u00a0sat" in shown["gps"] for each in reports),
    }
    return [f"{name}: {shown[name]}" for name, found in holds.items() if not found]


def far_off(read: dict[str, Any], vehicle: int, states: list[MemberState]) -> bool:
    """Whether a mark is nowhere near one of the places: the mission's x axis points east, and east is right."""
    (x_px, y_px), (target_x_px, target_y_px) = read["marks"][str(vehicle)], read["target"]
    x_m = TARGET_M[0] + (x_px - target_x_px) / read["metre_px"]
    y_m = TARGET_M[1] - (y_px - target_y_px) / read["metre_px"]
    return min(hypot(x_m - each.position_m[0], y_m - each.position_m[1]) for each in states) > PLACE_M


def check_all(page: Page, bus: Bus, vehicles: tuple[int, ...]) -> None:
    """Compare every card and mark with what the vehicles sent until then, or up to half a second before."""
    since_s = time.monotonic() - WITHIN_S
    read = page.evaluate(READ)
    for vehicle in vehicles:
        states, reports = bus.of(MemberState, vehicle, since_s), bus.of(VehicleReport, vehicle, since_s)
        assert differing(read["cards"][str(vehicle)], states, reports) == [], vehicle
        assert not far_off(read, vehicle, states), vehicle


def command(page: Page, verb: str, vehicle: int, *, hold: bool = False) -> None:
    page.get_by_label(f"Select vehicle {vehicle}").check()
    button = page.locator(f"#verbs [data-verb='{verb}']")
    button.click(delay=3000 if hold else 0)
    if verb == "kill":
        page.keyboard.type("kill")
        page.locator("#kill-send").click()
    page.get_by_label(f"Select vehicle {vehicle}").uncheck()


def test_a_team_is_shown_as_it_flies_and_obeys(open_page: OpenPage, mission_file: Callable[..., str]) -> None:
    path = mission_file("case2", *NEAR, LOW)
    with Bus(load_mission(path)) as bus, flying(path) as (url, lines):
        page = open_page(url)
        page.set_default_timeout(30_000)
        expect(page.locator(".card .tactic", has_text="encircle")).to_have_count(3, timeout=60_000)
        page.wait_for_timeout(2000)  # until the camera is there
        for _ in range(10):
            page.wait_for_timeout(300)
            check_all(page, bus, (1, 2, 3))
        tactic = page.locator(".card[data-vehicle='2'] .tactic")
        command(page, "hold", 2)
        until_now(lambda: bus.of(MemberState, 2)[-1].tactic == "hold")
        expect(tactic).to_have_text("hold")
        page.reload()
        expect(tactic).to_have_text("hold")
        command(page, "resume", 2)
        until_now(lambda: bus.of(MemberState, 2)[-1].tactic == "encircle")
        expect(tactic).to_have_text("encircle")

        until_now(lambda: any("practice: link cut" in line for _, line in lines), 60.0)
        cut_s = next(at_s for at_s, line in lines if "practice: link cut" in line)
        expect(page.locator(f".symbol[data-vehicle='{CUT}']")).to_have_attribute("data-current", "false")
        assert time.monotonic() - cut_s <= STALE_WITHIN_S
        expect(page.locator("#alarms")).to_contain_text(f"Vehicle {CUT}: ")
        page.get_by_role("button", name="Acknowledge").first.click()
        expect(page.locator("#alarms li").first).to_contain_text("(acknowledged)")

        command(page, "land", 1, hold=True)
        until_now(lambda: bus.of(MemberState, 1)[-1].tactic == "land")
        expect(page.locator(".card[data-vehicle='1'] .tactic")).to_have_text("land")
        command(page, "kill", 2)
        until_now(lambda: bus.of(VehicleReport, 2)[-1].ended != "")
        expect(page.locator(".card[data-vehicle='2']")).to_have_attribute("data-trouble", "ended")
        assert "killed" in bus.of(VehicleReport, 2)[-1].ended
