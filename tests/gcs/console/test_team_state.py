"""What a listener makes of a team's words, and the table and lines that show it."""

import re
from io import StringIO

import msgspec
from msgspec import structs
from msgspec.structs import replace
from rich.console import Console

from agents.drops import Drops
from agents.safety.fence import Area
from agents.settings.sections import SafetySettings
from agents.team.messages import (
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    RingChoice,
    RingValues,
    VehicleReport,
)
from estimation.frames import MissionFrame
from gcs.console.team_state import EVENTS_KEPT, SILENT_AFTER_S, TeamEvent, TeamState
from gcs.console.vehicle_view import TeamRow, with_alert
from gcs.console.watch import WatchView, watch_line, watch_table

UNKNOWN = TeamRow(3, note="not received")
ROW = TeamRow(
    1,
    0.1,
    is_stale=False,
    tactic="encircle",
    position_m=(1.0, -2.0, 8.0),
    velocity_m_s=(0.5, 0.0),
    nearest_id=2,
    nearest_m=17.3,
    fence_margin_m=4.3,
    radius_m=10.02,
    angular_rate_rad_s=0.051,
)


def state(
    sender: int = 1,
    time_s: float = 100.0,
    tactic: str = "formation",
    alert: str = "",
    angle: NeighbourAngle | None = None,
) -> MemberState:
    here = (1.0, -2.0)
    return MemberState(sender, time_s, tactic, here, (0.0, 0.0), here, (0.0, 0.0), 8.0, 0.1, alert, angle=angle)


def test_silence_is_news_once_and_so_is_its_end() -> None:
    picture = TeamState((1,))
    assert (picture.rows(0.0), picture.any_received) == ([replace(UNKNOWN, vehicle_id=1)], False)
    picture.receive(state(), 0.0)
    assert picture.any_received
    (connected,) = picture.new_events(0.0)
    assert connected.line.startswith("vehicle 1: ")
    assert "formation" in connected.text
    assert picture.new_events(SILENT_AFTER_S) == []
    (lost,) = picture.new_events(SILENT_AFTER_S + 0.1)
    assert lost.line.startswith("vehicle 1: ")
    assert "formation" in lost.text
    assert lost.severity == "warning"
    assert picture.new_events(SILENT_AFTER_S + 0.2) == []
    assert picture.rows(SILENT_AFTER_S + 0.2)[0].is_stale
    picture.receive(state(tactic="hold"), 3.0)
    restored, changed = picture.new_events(3.0)
    assert restored.line.startswith("vehicle 1: ")
    assert changed == TeamEvent(1, "formation -> hold")
    assert not picture.rows(3.0)[0].is_stale


def test_a_vehicle_in_reserve_is_shown_as_such_and_not_as_one_whose_flight_has_ended() -> None:
    team = TeamState((1, 2), frame=MissionFrame(None))
    team.receive(VehicleReport(1, 100.0, "hold", ended="landed: in reserve", in_reserve=True), 0.0)
    (reserve, absent), output = team.rows(1.0), StringIO()
    assert (reserve.in_reserve, reserve.note, absent.in_reserve) == (True, "", False)
    with WatchView(Console(file=output, width=100, force_terminal=True, color_system=None, _environ={})) as view:
        view.update([reserve, absent], 1.0)
    shown = [line.split()[:2] for line in output.getvalue().splitlines() if "reserve" in line]
    assert shown[-1] == ["1", "reserve"]
    assert "ended" not in output.getvalue()
    assert "#1 reserve" in watch_line([reserve, absent], 1.0, "")
    team.receive(VehicleReport(1, 101.0, "offboard"), 2.0)
    team.receive(state(1), 2.0)
    assert team.rows(2.0)[0].over == "ended"


def test_a_vehicle_that_is_unaccounted_for_is_first_and_no_longer_silent_and_one_that_landed_has_ended() -> None:
    team = TeamState((1, 2), frame=MissionFrame(None))
    landed = VehicleReport(1, 100.0, "land", ended="landed", is_completed=True)
    lost = VehicleReport(2, 100.0, "offboard", link_age_s=30.0, ended="lost", unaccounted_m=(7.0, -8.0, 9.5))
    for each in (1, 2):
        team.receive(state(each), 0.0)
        team.receive(VehicleReport(each, 99.0, "offboard"), 0.0)
    team.receive(landed, 1.0)
    team.receive(lost, 1.0)
    one, two = team.rows(21.0)
    assert (one.has_ended, one.note, one.alert) == (True, "", "")
    assert (two.has_ended, two.is_unaccounted, two.severity) == (False, True, "alarm")
    assert all(part in two.advice for part in ("x 7.0 m", "y -8.0 m", "9.5 m", "50 s")), two.advice
    told = [(each.vehicle_id, each.severity) for each in team.new_events(21.0) if "connected" not in each.text]
    assert told == [(1, "information"), (2, "alarm")], "and neither is silent"

    output = StringIO()
    console = Console(file=output, width=100, force_terminal=True, color_system=None, _environ={})
    view = WatchView(console)
    with view:
        view.update([one, two], 21.0)
    lines = [line.strip() for line in output.getvalue().splitlines() if line.strip()]
    shown = [line.split()[:2] for line in lines if "MISSING" in line or "ended" in line]
    assert shown[-2:] == [["!!2", "MISSING"], ["1", "ended"]]
    assert any("ALARM: vehicle 2" in line and "x 7.0 m" in line for line in lines[-3:]), "also when it is closed"
    assert all(part in watch_line([one, two], 21.0, "") for part in ("#1 ended", "#2 MISSING", "x 7.0 m"))


def test_of_a_flight_that_is_gone_who_may_be_in_the_air_is_unaccounted_for() -> None:
    team = TeamState((1, 2))
    team.receive(VehicleReport(1, 99.0, "offboard", armed=True), 0.0)
    team.receive(VehicleReport(2, 99.0, "ready"), 0.0)
    for each in (1, 2):
        team.receive(state(each), 0.0)
    assert not any(row.is_unaccounted for row in team.rows(9.0))
    assert not any(row.is_unaccounted for row in team.rows(0.5, is_over=True)), "their messages may be in transit"
    one, two = team.rows(9.0, is_over=True)
    assert (one.is_unaccounted, one.position_m, two.is_unaccounted) == (True, (1.0, -2.0, 8.0), False)
    assert "9 s ago" in one.advice


def test_a_vehicle_that_is_lost_in_take_off_before_its_first_state_is_unaccounted_for() -> None:
    team, place_m = TeamState((1, 2)), (1.0, -2.0, 3.5)
    team.receive(VehicleReport(1, 99.0, "take-off", armed=True, link_age_s=0.5, position_m=place_m), 0.0)
    team.receive(VehicleReport(2, 99.0, "offboard", ended="lost", link_age_s=4.0, unaccounted_m=place_m), 0.0)
    assert [row.is_unaccounted for row in team.rows(9.0)] == [False, True]
    one, two = team.rows(9.0, is_over=True)
    assert one.position_m == two.position_m == place_m
    assert one.is_unaccounted
    assert "10 s ago" in one.advice
    assert "13 s ago" in two.advice


def test_alerts_commands_and_answers_are_told_once_however_often_they_are_repeated() -> None:
    picture = TeamState((1,))
    for _ in range(3):
        picture.receive(state(alert="battery low"), 0.0)
        picture.receive(OperatorCommand(100.0, "hold", None, "pat.here", 7), 0.0)
        picture.receive(CommandAnswer(1, 100.0, 7, "holds"), 0.0)
        picture.receive(CommandAnswer(1, 100.0, 8, "lands", "land", "kim.there"), 0.0)
    picture.receive(state(), 0.1)
    facts = (
        ("vehicle 1", "formation"),
        ("alert: battery low",),
        ("pat.here", "all vehicles", "hold"),
        ("holds",),
        ("vehicle 1", "land", "kim.there", "lands"),
        ("alert",),
    )
    events = picture.new_events(0.1)
    assert len(events) == len(facts)
    assert [event.severity for event in events] == ["information", "alarm", *["information"] * 4]
    assert all(fact in event.line for event, expected in zip(events, facts, strict=True) for fact in expected)


def rendered(rows: list[TeamRow], width: int = 80) -> list[str]:
    output = StringIO()
    Console(file=output, width=width).print(watch_table(3.0, rows, width > 80, False))
    return output.getvalue().splitlines()


def test_the_table_shows_every_number_with_its_unit_in_eighty_columns() -> None:
    near = with_alert(
        replace(ROW, vehicle_id=2, nearest_m=2.9, fence_margin_m=-1.0, tactic="pilot override"), "battery low"
    )
    lines = rendered([ROW, replace(near, age_s=3.2, is_stale=True), UNKNOWN, near])
    assert lines[0].split() == ["age", "height", "speed", "near", "fence", "x", "y", "r", "ω"]
    assert lines[1].split() == ["tactic", "[s]", *["[m]"] * 1, "[m/s]", *["[m]"] * 5, "[rad/s]"]
    assert lines[2].split() == ["1", "encircle", "0.1", "8.0", "0.5", "17.3", "4.3", "1.0", "-2.0", "10.02", "+0.051"]
    assert lines[3].split()[:6] == ["!!2", "silent", "3.2!!", "8.0", "0.5", "2.9!!"]
    assert lines[4].split()[:2] == ["3", "-"]
    assert lines[5].split()[:2] == ["!!2", "PILOT"]
    assert max(map(len, lines)) <= 80
    assert "pilot override" in rendered([near], 120)[2]
    assert "17.3 to 2" in rendered([ROW], 120)[2]


def test_of_several_rings_each_vehicles_own_is_beside_its_tactic() -> None:
    picture = TeamState((1, 2, 3, 4), rings=("north", "the far away one"))
    chosen = {1: RingChoice(0), 2: RingChoice(1), 3: RingChoice(None), 4: RingChoice(5)}
    for vehicle_id, choice in chosen.items():
        picture.receive(structs.replace(state(vehicle_id), tactic="encircle", choice=choice), 0.0)
    rows = picture.rows(0.1)
    assert [row.ring for row in rows] == ["north", "the far away one", "", ""]
    shown = [re.match(r"\S+ +(.*?) +0\.1 ", line) for line in rendered(rows, 120)[2:]]
    assert [each and each[1] for each in shown] == [
        "encircle north",
        "encircle the far away one",
        "encircle",
        "encircle",
    ]
    narrow = rendered([structs.replace(row, nearest_m=17.3, fence_margin_m=-14.3, age_s=12.1) for row in rows])
    assert [line.split()[1:4] for line in narrow[2:4]] == [["on", "north", "12.1"], ["on", "the", "f…"]]
    assert " 12.1 " in narrow[3]
    assert max(map(len, narrow)) <= 80
    assert " #2 encircle the far away one x=" in watch_line(rows, 1.0, "")
    (unnamed,) = TeamState((1,)).rows(0.0)
    assert unnamed.ring is msgspec.UNSET
    assert "ring" not in msgspec.to_builtins(unnamed)


def test_commands_name_the_ring_that_they_are_for() -> None:
    picture = TeamState((1, 2), rings=("north", "south"))
    command = OperatorCommand(100.0, "ring", None, "pat", 1, ring=RingValues(12.0), ring_number=1)
    picture.receive(command, 0.0)
    picture.receive(OperatorCommand(100.0, "assign", 2, "pat", 2, ring_number=0), 0.0)
    picture.receive(OperatorCommand(100.0, "assign", 2, "pat", 3), 0.0)
    picture.receive(OperatorCommand(100.0, "hold", 2, "pat", 4), 0.0)
    assert [each.line for each in picture.new_events(0.0)] == [
        "command from pat to all vehicles: ring south",
        "command from pat to vehicle 2: assign north",
        "command from pat to vehicle 2: assign auto",
        "command from pat to vehicle 2: hold",
    ]


def test_the_line_leaves_out_what_is_not_known() -> None:
    rows = [ROW, replace(ROW, radius_m=None, angular_rate_rad_s=None, note="no messages for 2 s"), UNKNOWN]
    title, whole, without_ring, unknown = watch_line(rows, 12.0, "").split(" | ")
    assert title == "watched for 12 s"
    assert whole == "#1 encircle x=1.0m y=-2.0m height=8.0m speed=0.5m/s near=17.3m fence=4.3m r=10.02m w=+0.051rad/s"
    assert without_ring.startswith("#1 encircle x=1.0m y=-2.0m height=8.0m ")
    assert "for 2 s" in without_ring
    assert unknown.startswith("#3 ")
    assert "=" not in unknown


def test_neighbours_fences_and_the_ring_are_those_of_the_messages() -> None:
    picture = TeamState((1, 2), {1: Area(SafetySettings(fence_m=((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0))))})
    picture.receive(structs.replace(state(1), velocity_m_s=(3.0, 4.0)), 0.0)
    picture.receive(
        structs.replace(state(2, angle=NeighbourAngle(2, 100.0, 0.3, 0.05, 10.5)), position_m=(1.0, 5.0)), 0.5
    )
    first, second = picture.rows(0.5)
    assert (first.speed_m_s, first.nearest_id, first.nearest_m, first.fence_margin_m) == (5.0, 2, 7.0, 3.0)
    assert (second.speed_m_s, second.nearest_id, second.nearest_m, second.fence_margin_m) == (0.0, 1, 7.0, None)
    assert picture.ring_members(0.5) == 1
    assert (second.age_s, second.radius_m, second.angular_rate_rad_s) == (0.0, 10.5, 0.05)
    assert picture.ring_members(0.6 + SILENT_AFTER_S) == 0, "its messages have stopped"
    picture.receive(state(2), 3.0)
    assert picture.rows(3.0)[1].radius_m is None, "it has left the ring"


def test_of_a_view_that_is_closed_nothing_is_shown_as_if_it_went_on() -> None:
    output = StringIO()
    view = WatchView(Console(file=output, force_terminal=True, width=80, _environ={}))
    with view:
        view.update([with_alert(ROW, "battery low")], 3.0, "read-only", title="case2  watched for 3 s")
        output.seek(output.truncate(0))
    assert "VIEW CLOSED  case2" in output.getvalue()
    assert "ALARM" not in output.getvalue()


def test_a_flood_of_commands_is_shown_in_part_and_the_newest_are_kept() -> None:
    picture = TeamState((1,))
    for number in range(2 * EVENTS_KEPT):
        picture.receive(OperatorCommand(100.0, "hold", None, "pat", number), 0.0)
    picture.receive(OperatorCommand(100.0, "kill", None, "pat", 5000), 0.0)
    events = picture.new_events(0.0)
    assert len(events) == EVENTS_KEPT
    assert "kill" in events[-1].text
    assert events[-1].severity == "warning"


def test_what_a_vehicle_drops_is_shown_by_reason() -> None:
    picture = TeamState((1,))
    picture.receive(structs.replace(state(), drops=Drops(too_many=12, wrong_sender=3)), 0.0)
    assert "too many 12, wrong sender 3" in watch_line(picture.rows(0.0), 1.0, "")
