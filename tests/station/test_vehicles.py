"""What the page shows of vehicles: cards, table, top bar and map, against the pictures that it was sent."""

import math
import re
import time
from collections.abc import Callable
from functools import partial

import msgspec
import pytest
from msgspec.structs import replace
from playwright.sync_api import FloatRect, Page, Route, expect

from agents.team.messages import AutopilotReport, CameraView
from gcs.console.vehicle_view import with_unaccounted
from gcs.station.picture import MissionPicture, TeamPicture
from gcs.style import COLOURS
from tests.station.conftest import NO_WEBGL, OpenPage, pass_time, stopped
from tests.support.page.canned_station import CannedStation
from tests.support.page.station_pictures import (
    BOAT_M,
    BUOY_M,
    changed,
    ring_mission,
    ring_team,
    rings_mission,
    rings_team,
)
from tests.support.wire import repeated_now

pytestmark = pytest.mark.browser
SCRIPT = NO_WEBGL
SHOWN = {
    "mode": "offboard",
    "battery": "57 %",
    "endurance": "11:07",
    "height": "−7.3 m".replace("−", "-"),
    "speed": "5.0 m/s",
    "gps": "no fix, 17 sat",
    "estimator": "dead reckoning",
    "wind": "6.3 m/s",
    "link": "0.4 s",
    "heard": "0.2 s ago",
    "nearest": "4.2 m to 3",
    "margin": "1.2 m",
    "fence": "6.5 m",
    "radius": "9.8 m",
    "rate": "-0.048 rad/s",
    "lead": "90 °",
    "place": "47.397780, 8.546011",
    "home": "47.397742, 8.545594",
}


def with_own_values(team: TeamPicture) -> TeamPicture:
    """Return the team with a value for vehicle 2 in every field that no other vehicle has."""
    return changed(
        team,
        2,
        age_s=0.2,
        tactic="hold",
        guard="evading 1",
        autopilot=AutopilotReport(0.57, 667.9, 0, 17, 6.3),
        position_m=(31.5, 4.25, -7.3),
        velocity_m_s=(3.0, -4.0),
        estimator="dead reckoning",
        link_age_s=0.4,
        nearest_id=3,
        nearest_m=4.2,
        fence_margin_m=6.5,
        radius_m=9.8,
        angular_rate_rad_s=-0.048,
        lead_rad=math.pi / 2.0,
    )


def with_nothing_known(team: TeamPicture) -> TeamPicture:
    """Return the team with nothing known of vehicle 2 but that it is there."""
    return changed(team, 2, **dict.fromkeys(_NUMBERS), autopilot=AutopilotReport(), mode="", tactic="", estimator="")


_NUMBERS = [
    "position_m",
    "yaw_rad",
    "velocity_m_s",
    "aim_m",
    "link_age_s",
    "nearest_id",
    "nearest_m",
    "fence_margin_m",
    "radius_m",
    "angular_rate_rad_s",
    "lead_rad",
]


def station(change: Callable[[TeamPicture], TeamPicture] = lambda team: team, vehicles: int = 3) -> CannedStation:
    mission = ring_mission(vehicles)
    return CannedStation(mission, lambda time_s: change(ring_team(mission, 100.0 + time_s)))


def texts(page: Page, place: str) -> dict[str, str]:
    """Return what a card or a row shows, by the names of the quantities."""
    shown: dict[str, str] = page.eval_on_selector_all(
        f"{place} [data-quantity]",
        "nodes => Object.fromEntries(nodes.map(node => [node.dataset.quantity, node.textContent]))",
    )
    return {name: text.replace("\u00a0", " ") for name, text in shown.items()}


def shows(page: Page, place: str, expected: dict[str, str]) -> None:
    """Wait until a card or a row shows all this at once: on a busy computer a picture is a while old."""

    def attempt() -> None:
        assert texts(page, place) == expected

    repeated_now(attempt)


def test_every_field_is_on_the_card_and_in_the_table_and_what_is_not_known_is_a_dash(
    page: Page, served: CannedStation
) -> None:
    """Also on a browser that can draw no map."""
    served.team = lambda _: with_own_values(ring_team(ring_mission(), 100.0))
    card = page.locator(".card[data-vehicle='2'] .tactic")
    expect(card).to_have_text("hold, evading 1")
    shows(page, ".card[data-vehicle='2']", SHOWN)
    assert texts(page, ".card[data-vehicle='1']")["gps"] == "3D, 14 sat"
    expect(page.locator("#table [data-vehicle='2'] [data-quantity='battery']")).to_be_visible()
    in_table = {"tactic": "hold, evading 1", "x": "31.5 m", "y": "4.3 m", "alert": "no alert"}
    shows(page, "#table [data-vehicle='2']", SHOWN | in_table)
    page.get_by_role("tab", name="Map").click()
    expect(page.locator("#no-webgl")).to_contain_text("WebGL is missing")
    served.team = lambda _: with_nothing_known(ring_team(ring_mission(), 100.0))
    expect(card).to_have_text("–")
    shown = texts(page, ".card[data-vehicle='2']")
    assert {name for name, text in shown.items() if text != "–"} == {"heard", "home"}


def test_top_bar_on_every_size_of_screen(page: Page, served: CannedStation, subtests: pytest.Subtests) -> None:
    alarm = changed(ring_team(ring_mission(), 185.0), 3, alert="link lost", severity="alarm")
    served.team = lambda _: replace(alarm, ring_members=2)
    expect(page.locator("#elapsed")).to_have_text("T+ 3:05")
    shown = {
        "remaining": "6:55",
        "ring": "2 of 3",
        "worst": "■ 3: link lost",
        "link": "● connected",
        "rights": "anna",
    }
    for name, text in shown.items():
        expect(page.locator(f"#{name}")).to_have_text(text)
    served.team = lambda _: replace(ring_team(ring_mission(), 600.0), ending="killed by the operator")
    expect(page.locator("#ending")).to_have_text("Flight over: killed by the operator")
    expect(page.locator(".card[data-trouble='ended']")).to_have_count(3)
    waits = changed(ring_team(ring_mission(), 185.0), 3, has_ended=True, in_reserve=True, tactic="", ending="landed")
    served.team = lambda _: waits
    expect(page.locator(".card[data-trouble='ended']")).to_have_count(1)
    expect(page.locator(".card[data-trouble='ended'] .headline")).to_have_text("reserve")
    expect(page.locator(".card[data-trouble='ended'] .tactic")).to_have_text("reserve")
    expect(page.locator("#commands")).to_contain_text("(1 in reserve)")
    served.team = lambda _: replace(ring_team(ring_mission(), 0.0), time_s=None, link="case2 is not flying")
    expect(page.locator("#link")).to_have_text("▲ case2 is not flying")
    expect(page.locator("#elapsed")).to_have_text("not started")
    for source, words in (
        ("sitl", "practice on stubs"),
        ("flight", "REAL vehicles"),
        ("unstated", "REAL? not stated"),
    ):
        served.send(replace(ring_mission(), source=source))
        for width in (1920, 1024, 390):
            with subtests.test(source=source, width=width):
                page.set_viewport_size({"width": width, "height": 800})
                expect(page.locator("#source")).to_have_text(words)
                expect(page.locator("#source")).to_be_in_viewport(ratio=1)


def test_large_team_is_a_compact_list_with_the_gravest_trouble_first_and_in_full(open_page: OpenPage) -> None:
    def change(team: TeamPicture) -> TeamPicture:
        team = changed(team, 5, alert="link lost", advice="Wait.", severity="alarm")
        team = changed(changed(team, 4, is_stale=True, age_s=3.0), 3, alert="GPS jammed", severity="warning")
        return changed(changed(team, 2, autopilot=AutopilotReport(0.34)), 1, has_ended=True)

    with station(change, vehicles=16) as served:
        page = open_page(served.url, script=NO_WEBGL)
        for place, vehicle in enumerate((5, 4, 2, 3, *range(6, 17), 1)):
            expect(page.locator(".card").nth(place)).to_have_attribute("data-vehicle", str(vehicle))
        words = ["■ ALARM", "◌ STALE", "▲ Warning", "▲ Warning", *[""] * 11, "□ Ended"]
        expect(page.locator(".card .badge")).to_have_text(words)
        expect(page.locator(".card[data-vehicle='5'] .advice")).to_have_text("Wait.")
        expect(page.locator(".card[data-vehicle='5'] .advice")).to_be_visible()
        calm = page.locator(".card[data-vehicle='12']")
        expect(calm.locator("[data-quantity='battery']")).to_be_visible()
        expect(calm.locator("[data-quantity='gps']")).to_be_hidden()
        styles = page.locator(".mark").evaluate_all("marks => marks.map(m => m.style.borderStyle + m.style.cssText)")
        assert len(set(styles)) == 16  # colours repeat after eight
        height = calm.bounding_box()
        assert height is not None
        assert height["height"] < 60
        page.get_by_role("button", name="Compact").click()
        expect(calm.locator("[data-quantity='gps']")).to_be_visible()


def missing(team: TeamPicture, vehicle: int) -> TeamPicture:
    view = next(each for each in team.vehicles if each.vehicle_id == vehicle)
    lost = replace(with_unaccounted(view), age_s=35.0, ending="lost: its link was lost")
    return replace(team, vehicles=tuple(lost if each is view else each for each in team.vehicles))


def test_a_vehicle_that_is_unaccounted_for_stays_first_until_its_recovery_is_confirmed(
    page: Page, served: CannedStation
) -> None:
    """Among other alarms, after the end of the flight, and whatever is acknowledged."""

    alarm = changed(ring_team(ring_mission(), 100.0), 1, alert="link lost", severity="alarm")
    served.team = lambda _: replace(missing(alarm, 3), ending="1, 2 landed; 3 lost")
    card = page.locator(".card").first
    expect(card).to_have_attribute("data-vehicle", "3")
    expect(card).to_have_attribute("data-trouble", "alarm")
    expect(card.locator(".tactic")).to_have_text("MISSING")
    expect(card.locator(".headline")).to_have_text("unaccounted for, last seen 35\u00a0s ago")
    expect(card.locator(".advice")).to_be_visible()
    expect(page.locator("#worst")).to_have_text("■ 3: unaccounted for")
    expect(page.locator("#alarms li")).to_contain_text(["Vehicle 3: unaccounted for"])
    expect(page.locator("#table tbody tr").first).to_have_attribute("data-vehicle", "3")
    expect(page.locator(".card[data-trouble='ended']")).to_have_count(2)
    recovered = page.locator(".recovered:visible")
    expect(recovered).to_have_count(1)
    recovered.hover()
    with stopped(page):
        for held_ms in (800, 0, 1500):  # a short press does nothing, and the last counts once
            page.mouse.down()
            pass_time(page, held_ms)
            page.mouse.up()
    served.await_requests(page)
    assert served.recovered == [3]
    assert served.requests == []
    served.team = lambda time_s: replace(ring_team(ring_mission(), time_s), ending="landed")
    expect(page.locator(".recovered:visible")).to_have_count(0)
    expect(page.locator("#worst")).to_have_text("ended")


CLIPBOARD = "window.copied = []; navigator.clipboard.writeText = async (text) => { window.copied.push(text); };"


def test_places_are_copied_by_a_click_in_degrees_or_in_metres_of_a_local_frame(open_page: OpenPage) -> None:
    """The places of vehicle 2 by the ellipsoid's radii: 31.5 m east and 4.25 m north of the origin."""
    with station(with_own_values) as served:
        page = open_page(served.url, script=CLIPBOARD)
        card = page.locator(".card[data-vehicle='2']")
        card.get_by_role("button", name="47.397780, 8.546011").click()
        expect(page.locator("#target-place")).to_contain_text("Target 47.3976")
        page.locator("#target-place").click()
        page.locator("#map").click(position={"x": 200, "y": 120})
        place, target, cursor = page.evaluate("copied")
        assert place == "47.397780, 8.546011"
        assert page.locator("#target-place").inner_text() != target, "the target's place alone is copied"
        assert page.locator("#cursor-place").get_attribute("data-copied") == cursor
        assert [len(each.split(", ")) for each in (target, cursor)] == [2, 2]
        assert math.dist(degrees(target), degrees(cursor)) < 0.001, "both are near the mission"
        served.team = None
        local = replace(ring_mission(), origin_deg=None, x_bearing_deg=0.0)
        served.mission = local
        served.send(local)
        served.team = lambda _: with_own_values(ring_team(local, 100.0))
        expect(card.locator("[data-quantity='place']")).to_have_text("x 31.5 m, y 4.3 m")


def degrees(text: str) -> tuple[float, ...]:
    return tuple(map(float, text.split(", ")))


REACH_M = """async ([mission, team]) => {
  const { teamMarks } = await import("./marks.js");
  const [circle_m] = teamMarks(mission, team).find(({ layer }) => layer === "reach").parts_m;
  const [x, y] = team.target.position_m;
  const distances_m = circle_m.map((point_m) => Math.hypot(point_m[0] - x, point_m[1] - y));
  return [Math.min(...distances_m), Math.max(...distances_m)];
}"""
"""The least and the largest radius of the circle that the map draws about a lost target."""


def test_the_map_shows_what_is_stale_what_is_selected_and_what_a_reload_keeps(open_page: OpenPage) -> None:
    """The circle about a lost target grows by 0.5 m/s, from twice the deviation of its last estimate along any axis."""

    def cut(team: TeamPicture, lost_for_s: float) -> TeamPicture:
        lost = replace(team, target=replace(team.target, sighting_age_s=lost_for_s, lost_speed_m_s=0.5))  # type: ignore[type-var]
        return with_nothing_known(changed(lost, 1, is_stale=True, age_s=12.3))

    with station() as served:
        page = open_page(served.url)
        label = page.locator(".symbol[data-vehicle='1'] .label")
        expect(label).to_have_text("1 · 8.0\u00a0m")
        page.locator(".symbol[data-vehicle='1']").click()
        expect(page.get_by_label("Select vehicle 1")).to_be_checked()
        expect(page.locator("#target-text")).to_have_text("To vehicle 1")
        served.team = lambda _: cut(ring_team(ring_mission(), 130.0), 40.0)
        expect(label).to_have_text("1 · last seen 12\u00a0s ago")
        expect(page.locator(".symbol[data-vehicle='1'] .shape")).to_have_attribute("fill", "url(#hatch-1)")
        expect(page.locator(".symbol[data-vehicle='2']")).to_have_count(0)
        expect(page.locator(".symbol[data-vehicle='3'] .shape")).to_have_attribute("fill", COLOURS[2])
        expect(page.locator(".card[data-vehicle='1']")).to_have_attribute("data-trouble", "stale")
        expect(page.locator(".card[data-vehicle='1']")).to_have_attribute("data-current", "false")
        expect(page.locator(".symbol.target")).to_have_attribute("data-current", "false")
        for lost_for_s in (40.0, 50.0):
            team, reached_m = cut(ring_team(ring_mission(), 130.0), lost_for_s), 0.5 * lost_for_s + 2.0 * math.sqrt(0.6)
            served.team = partial(lambda team, _: team, team)
            text = f"target, seen {lost_for_s:.0f}\u00a0s ago, within {reached_m:.1f}\u00a0m"
            expect(page.locator(".symbol.target .label")).to_have_text(text)
            pictures = [msgspec.to_builtins(each) for each in (ring_mission(), team)]
            assert page.evaluate(REACH_M, pictures) == pytest.approx([reached_m] * 2)
        page.locator("#layers summary").click()
        expect(page.get_by_label("Map tiles")).to_have_count(0)
        expect(page.locator(".tiles-source")).to_have_count(0)
        for box in page.locator("#layers input").all():
            box.uncheck()
        expect(label).to_be_hidden()
        page.get_by_role("tab", name="Strips").click()
        expect(page.locator("#strips figure canvas")).to_have_count(4)
        served.team = lambda time_s: ring_team(ring_mission(), 130.0 + time_s)
        page.get_by_label("Select vehicle 2").check()
        page.reload()
        expect(page.locator(".card")).to_have_count(3)
        expect(page.get_by_label("Select vehicle 2")).not_to_be_checked()
        expect(page.locator("#target-text")).to_have_text("To all 3 vehicles")
        expect(page.locator(".symbol[data-vehicle][data-current='true']")).to_have_count(3)
        rising = {"tactic": "", "mode": "take-off", "position_m": (0.0, 4.0, 2.5), "velocity_m_s": (0.0, 0.0)}
        served.team = lambda time_s: changed(ring_team(ring_mission(), 130.0 + time_s), 1, **rising)
        expect(label).to_have_text("1 \u00b7 2.5\u00a0m")
        expect(page.locator(".card[data-vehicle='1'] .tactic")).to_have_text("take-off")
        assert served.requests == []


def test_station_that_is_gone_leaves_nothing_alive_and_another_mission_replaces_the_vehicles(
    open_page: OpenPage, subtests: pytest.Subtests
) -> None:
    """The page's own clock: no vehicle is drawn as if it flew where the last picture had it."""
    with station() as served:
        page = open_page(served.url, simulated=True)
        for way in ("silent", "closed"):
            with subtests.test(way):
                expect(page.locator(".symbol[data-vehicle][data-current='true']")).to_have_count(3)
                served.is_silent = served.is_refusing = True
                if way == "closed":
                    served.disconnect()
                pass_time(page, 1500)
                expect(page.locator(".symbol[data-vehicle][data-current='false']")).to_have_count(3)
                pass_time(page, 1000)
                expect(page.locator("#link")).to_have_text("■ no station")
                expect(page.locator(".symbol.target .label")).to_contain_text(re.compile(r"seen \d"))
                expect(page.locator("#alarms")).to_contain_text("No connection to the station")
                served.is_silent = served.is_refusing = False
                expect(page.locator("#link")).to_have_text("● connected")
        other: MissionPicture = replace(ring_mission(2), mission="other")
        served.team = None
        time.sleep(0.2)
        served.mission = other
        served.send(other)
        served.team = lambda time_s: ring_team(other, time_s)
        expect(page.locator("#mission")).to_have_text("other")
        expect(page.locator(".card")).to_have_count(2)
        expect(page.locator(".symbol[data-vehicle]")).to_have_count(2)


def pixels(page: Page, vehicle: int) -> tuple[float, float]:
    box = page.locator(f".symbol[data-vehicle='{vehicle}']").bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0


def scale_px_m(page: Page) -> float:
    """Return the pixels of a metre by the map's scale bar."""
    bar = page.locator(".maplibregl-ctrl-scale")
    box, number = bar.bounding_box(), re.match(r"(\d+)\D*m", bar.inner_text())
    assert box is not None
    assert number is not None
    return box["width"] / float(number[1])


CIRCLES = """async ([mission, team]) => {
  const { teamMarks } = await import("./marks.js");
  const found = teamMarks(mission, team).filter(({ layer }) => ["ring", "flown", "keep-out"].includes(layer));
  return found.map(({ layer, colour, parts_m: [points_m] }) => {
    const ends = (axis) => [Math.min, Math.max].map((end) => end(...points_m.map((at) => at[axis])));
    const [[left, right], [low, high]] = [ends(0), ends(1)];
    const circle = [(left + right) / 2, (low + high) / 2, (right - left) / 2];
    return [layer, colour, ...circle.map((each) => Math.round(each * 100) / 100)];
  });
}"""
"""Layer, colour, centre and radius of the circles that the map draws about targets."""


def test_the_map_shows_each_ring_about_its_target_with_its_name(open_page: OpenPage) -> None:
    """South was commanded to 12 m. One vehicle flies on each of the first two, at 10.5 m."""
    with CannedStation(rings_mission(), rings_team) as served:
        page = open_page(served.url)
        expect(page.locator(".symbol.target .label")).to_have_text(["boat", "buoy"])
        expect(page.locator(".ring-name")).to_have_text(["north", "south", "high"])
        expect(page.locator(".card .tactic")).to_have_text(["encircle north", "encircle south", "formation"])
        expect(page.locator("#target-place")).to_have_text(re.compile(r"^Targets boat [\d., ]+; buoy [\d., ]+$"))
        pictures = [msgspec.to_builtins(each) for each in (rings_mission(), rings_team())]
        north, south, high = COLOURS[-1], COLOURS[-2], COLOURS[-3]
        assert sorted(page.evaluate(CIRCLES, pictures)) == sorted(
            [
                ["ring", north, *BOAT_M, 10.0],
                ["flown", north, *BOAT_M, 10.5],
                ["keep-out", "", *BOAT_M, 4.0],
                ["ring", south, *BUOY_M, 12.0],
                ["flown", south, *BUOY_M, 10.5],
                ["ring", high, *BUOY_M, 8.0],
                ["keep-out", "", *BUOY_M, 4.0],
            ]
        )
        names_px = [page.locator(".ring-name").nth(number).bounding_box() for number in range(3)]
        (boat_x, boat_y), scale = centre_px(page.locator(".symbol.target").first.bounding_box()), scale_px_m(page)
        name_x, name_y = centre_px(names_px[0])
        assert math.hypot(name_x - boat_x, name_y - boat_y) / scale == pytest.approx(10.0, abs=0.6)
        one = rings_team()
        assert isinstance(one.targets, tuple)
        served.team = lambda _: replace(one, targets=(one.targets[0], None))  # type: ignore[index]
        expect(page.locator(".symbol.target .label")).to_have_text(["boat"])
        expect(page.locator(".ring-name")).to_have_text(["north"])


def centre_px(box: FloatRect | None) -> tuple[float, float]:
    assert box is not None
    return box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0


def test_map_is_in_metres_and_turns_by_the_bearing_of_the_x_axis(open_page: OpenPage) -> None:
    """With x at 30° from north, 20 m along x go 10 m east, 20 m along y 10 m north; or x is up and y left."""
    mission = replace(ring_mission(), x_bearing_deg=30.0)
    places_m = {1: (0.0, 0.0, 8.0), 2: (20.0, 0.0, 8.0), 3: (0.0, 20.0, 8.0)}

    def team(time_s: float) -> TeamPicture:
        shown = replace(ring_team(mission, time_s), target=None)
        for number, place_m in places_m.items():
            shown = changed(shown, number, position_m=place_m, yaw_rad=math.pi / 2.0)
        return shown

    with CannedStation(mission, team) as served:
        page = open_page(served.url)
        expect(page.locator(".symbol[data-vehicle='3']")).to_be_visible()

        def apart(along_x_m: tuple[float, float], along_y_m: tuple[float, float]) -> None:
            scale, (x1, y1), (x2, y2), (x3, y3) = scale_px_m(page), *(pixels(page, number) for number in (1, 2, 3))
            assert ((x2 - x1) / scale, (y1 - y2) / scale) == pytest.approx(along_x_m, abs=0.6)
            assert ((x3 - x1) / scale, (y1 - y3) / scale) == pytest.approx(along_y_m, abs=0.6)

        repeated_now(lambda: apart((10.0, 17.32), (-17.32, 10.0)))
        arrow = page.locator(".symbol[data-vehicle='1'] .shape")
        expect(arrow).to_have_attribute("transform", "rotate(-60)")
        page.get_by_role("button", name="Mission up").click()
        repeated_now(lambda: apart((0.0, 20.0), (-20.0, 0.0)))
        expect(arrow).to_have_attribute("transform", "rotate(-90)")


def test_labels_of_many_vehicles_do_not_cover_each_other(open_page: OpenPage) -> None:
    """Of each vehicle the label or the number on its symbol is seen, and no label covers another one or a symbol."""

    def grave(team: TeamPicture) -> TeamPicture:
        return changed(team, 5, alert="link lost", advice="Wait.", severity="alarm")

    with station(grave, 32) as served:
        page = open_page(served.url, viewport={"width": 1920, "height": 800}, reduced_motion="reduce")
        expect(page.locator(".symbol[data-vehicle]")).to_have_count(32)
        page.get_by_role("button", name="Fit").click()

        def attempt() -> None:
            shown = page.evaluate(SHOWN_LABELS)
            assert shown["named"] == [f"{number}" for number in range(1, 33)], "colours repeat, numbers do not"
            assert 5 in shown["labelled"]
            assert shown["covered"] == []

        repeated_now(attempt)


SHOWN_LABELS = """() => {
  const symbols = [...document.querySelectorAll(".symbol")];
  const isSeen = (node) => {
    const { opacity, display } = getComputedStyle(node);
    return opacity !== "0" && display !== "none";
  };
  const label = (symbol) => symbol.querySelector(".label");
  const vehicles = symbols.filter((symbol) => symbol.dataset.vehicle);
  const named = vehicles.filter((symbol) => isSeen(label(symbol)) || isSeen(symbol.querySelector(".number")));
  const labelled = symbols.filter((symbol) => isSeen(label(symbol)));
  const overlap = (one, other) => {
    const [a, b] = [one, other].map((node) => node.getBoundingClientRect());
    return a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  };
  const isCovered = (symbol) => symbols.some((other) => other !== symbol && (
    overlap(label(symbol), other.querySelector(".shape, .target-cross")) ||
    (labelled.includes(other) && overlap(label(symbol), label(other)))));
  const calm = labelled.filter((symbol) => symbol.dataset.trouble !== "alarm");
  return {
    named: named.map((symbol) => symbol.querySelector(".number").textContent),
    labelled: labelled.map((symbol) => Number(symbol.dataset.vehicle)),
    covered: calm.filter(isCovered).map((symbol) => label(symbol).textContent),
  };
}"""


def test_map_that_is_not_there_yet_says_so(open_page: OpenPage) -> None:
    with station() as served:
        page = open_page("about:blank")
        held: list[Route] = []

        def hold(route: Route) -> None:
            held.append(route)

        page.route("**/maplibre-gl.mjs", hold)
        page.goto(served.url)
        expect(page.locator("#map-state")).to_have_text("Loading the map…")
        expect(page.locator(".card .tactic").first).to_have_text("encircle")  # what needs no map is there
        while not held:
            page.wait_for_timeout(10.0)  # meanwhile, requests are handled
        held.pop().continue_()
        expect(page.locator(".symbol[data-vehicle]")).to_have_count(3)
        expect(page.locator("#map-state")).to_be_hidden()
        page.unroute("**/maplibre-gl.mjs")
        page.route("**/maplibre-gl.mjs", lambda route: route.abort("connectionrefused"))
        page.reload()
        expect(page.locator("#map-state")).to_contain_text("could not be loaded")
        expect(page.locator(".card .tactic").first).to_have_text("encircle")


FOOTPRINT = """async ([mission, team]) => {
  const { teamMarks } = await import("./marks.js");
  const cameras = teamMarks(mission, team).filter(({ layer }) => layer === "camera");
  return cameras.map(({ colour, parts_m: [points_m] }) => [colour, points_m]);
}"""
"""The colours and corners of what cameras cover."""


def test_what_a_camera_covers_is_drawn_and_its_stream_is_a_link(open_page: OpenPage) -> None:
    """From 8 m, with 60 degrees: a circle below the camera; obliquely from tan 15 to tan 75 degrees; 100 m at most."""
    mission = ring_mission()
    planned = replace(mission.vehicles[0], camera_url="rtsp://192.168.1.20:554/main")
    mission = replace(mission, vehicles=(planned, *mission.vehicles[1:]))

    def looking(elevation_deg: float) -> TeamPicture:
        team = ring_team(mission, 100.0)
        view = CameraView(100.0, (20.0, -3.0, 8.0), math.radians(elevation_deg), math.radians(30.0), math.radians(60.0))
        return changed(team, 1, autopilot=AutopilotReport(camera=view))

    def covered_m(page: Page, elevation_deg: float) -> list[tuple[float, float]]:
        """The corners from the point below the camera: along its bearing and to its left."""
        pictures = [msgspec.to_builtins(each) for each in (mission, looking(elevation_deg))]
        ((colour, points_m),) = page.evaluate(FOOTPRINT, pictures)
        assert colour == COLOURS[0]
        along = complex(math.cos(math.radians(30.0)), math.sin(math.radians(30.0)))
        seen = [complex(x - 20.0, y + 3.0) / along for x, y in points_m]
        return [(each.real, each.imag) for each in seen]

    with CannedStation(mission, lambda _: looking(-45.0)) as served:
        page = open_page(served.url)
        link = page.get_by_role("link", name="Camera of vehicle 1")
        expect(link).to_have_attribute("href", "rtsp://192.168.1.20:554/main")
        expect(page.get_by_role("link", name="Camera of vehicle 2")).to_have_count(0)
        below = [math.hypot(*each) for each in covered_m(page, -90.0)]
        assert [min(below), max(below)] == pytest.approx([8.0 * math.tan(math.radians(30.0))] * 2)
        ahead = covered_m(page, -45.0)
        edges = [min(x for x, _ in ahead), max(x for x, _ in ahead)]
        assert edges == pytest.approx([8.0 * math.tan(math.radians(each)) for each in (15.0, 75.0)], rel=1e-6)
        left, right = (end(y for _, y in ahead) for end in (max, min))
        assert left == pytest.approx(-right)
        assert max(math.hypot(*each) for each in covered_m(page, -10.0)) == pytest.approx(100.0)
