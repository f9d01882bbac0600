"""The live table and the summary, rendered into strings."""

import contextlib
import re
from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from math import radians

import pytest
from msgspec import structs
from rich.console import Console, RenderableType
from rich.text import Text

from agents.safety.failsafe import Condition
from agents.team.messages import AutopilotReport, NextChange, Outlook
from gcs.console.live import LiveView, flight_title, plain_line
from gcs.console.summary import summary
from gcs.console.terminal import PrintableConsole
from gcs.console.vehicle_view import TeamRow, with_alert, with_outlook, with_unaccounted
from gcs.metrics.catalogue import Verdicts
from gcs.metrics.ending import Unaccounted
from gcs.metrics.result import EstimateResult, FlightResult, LoopResult
from gcs.metrics.reynolds import FlockingResult, ReynoldsResult
from gcs.metrics.ring import RingResult
from gcs.metrics.vehicles import EstimatedVehicleResult, VehicleResult
from tests.support.wire import until_now

ROWS = (
    TeamRow(
        1, tactic="encircle", mode="offboard", position_m=(0.0, 0.0, 8.04), velocity_m_s=(0.51, 0.0),
        autopilot=AutopilotReport(0.83, None, 3, 12), link_age_s=0.04, nearest_id=2, nearest_m=17.31,
        fence_margin_m=4.26, radius_m=10.02, angular_rate_rad_s=0.0512, lead_rad=radians(119.24),
        lag_rad=radians(121.3), round_trip_s=0.1204,
    ),
    TeamRow(
        2, tactic="return and land", mode="offboard", autopilot=AutopilotReport(0.31), radius_m=9.97,
        angular_rate_rad_s=-0.05, lead_rad=radians(120.8), lag_rad=radians(119.2), note="ring [pair 1]",
    ),
    with_alert(
        TeamRow(3, tactic="formation", autopilot=AutopilotReport(0.12), link_age_s=3.2, fence_margin_m=-0.5),
        "battery critical",
    ),
)  # fmt: skip
RESULT = FlightResult(
    mission="case2",
    seed=7,
    source="simulation",
    reference="truth",
    duration_s=600.0,
    window_s=(290.9, 600.0),
    vehicles=(
        VehicleResult(1, 284.8, "encircle", 0.012, 0.034, 0.0501, 0.0007, 0.013, None),
        VehicleResult(2, None, "formation", formation_speed_error_rms_m_s=0.014, formation_spacing_error_rms_m=0.02),
    ),
    ring=RingResult(6.1, 0.58, 4.96, judged_s=309.1, judged_from_s=290.9, judged_share=0.84, members_min=2),
    transitions=(),
    reynolds=ReynoldsResult(flight=FlockingResult(1.37, 17.321, 0.50149, 0.1, 10.0, 12.345)),
    closest_approach_m=1.37,
    guard_interventions=14,
    guard_causes={"separation": 14},
    loop=LoopResult(10.0, 18000, 2, 220.4, 621.3),
    verdicts=Verdicts(True, True, None, True, False),
    wall_time_s=6.0,
    realtime_factor=100.0,
)


def rendered(renderable: RenderableType, width: int = 80, colour: bool = False) -> str:
    console = Console(file=StringIO(), width=width, force_terminal=colour, color_system="standard" if colour else None)
    console.print(renderable)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def terminal() -> tuple[Console, StringIO]:
    output = StringIO()
    return Console(file=output, force_terminal=True, width=100, color_system="standard", _environ={}), output


def plain() -> tuple[Console, StringIO]:
    output = StringIO()
    return Console(file=output, force_terminal=False, width=40), output


def alerted(vehicle_id: int, alert: str) -> TeamRow:
    return with_alert(structs.replace(ROWS[0], vehicle_id=vehicle_id), alert)


def shown_at(width: int, rows: Sequence[TeamRow] = ROWS, height: int = 24, closes: bool = False) -> list[str]:
    """Return the lines of the newest frame, without colours."""
    output = StringIO()
    console = Console(file=output, force_terminal=True, width=width, height=height, _environ={})
    view = LiveView(console, 3.0)
    with view:
        view.update(rows, 12.0, "go", Text("h hold"), flight_title("case2", 12.0, 200.0, 2, 3))
        frame = rendered(view._render(), width)
        output.seek(output.truncate(0))
    lines = output.getvalue() if closes else frame
    return [line.rstrip() for line in re.sub(r"\x1b(7|\[[0-9;?]*[A-Za-z])", "", lines).replace("\r", "").splitlines()]


def test_eighty_columns_show_what_an_operator_needs_with_its_unit() -> None:
    lines = shown_at(80)
    assert lines[0] == "case2  T+12.0 s, 188 s left  ring 2 of 3"
    assert lines[1].split() == ["height", "speed", "near", "fence", "link", "GPS", "r"]
    assert lines[2].split() == ["tactic", "mode", "[m]", "[m/s]", "[m]", "[m]", "[s]", "(sat)", "batt", "[m]"]
    assert lines[3].split() == [
        "1", "encircle", "offboard", "8.0", "0.5", "17.3", "4.3", "0.0", "3D", "12", "83%", "10.02",
    ]  # fmt: skip
    assert lines[4].split()[:2] == ["2", "return"]
    assert lines[5].split()[:5] == ["!!3", "formation", "NO", "LINK", "–"]
    assert {"-0.5!!", "3.2!!", "12%!!"} <= set(lines[5].split())
    assert lines[6:] == [
        "ALARM: vehicle 3: battery critical: it lands where it is: clear the place below",
        "it",
        "vehicle 2: ring [pair 1]",
        "go",
        "h hold",
    ]
    assert max(map(len, lines)) <= 80


def due(vehicle_id: int, alert: str, outlook: Outlook, now_s: float = 100.0) -> TeamRow:
    return with_alert(with_outlook(structs.replace(ROWS[0], vehicle_id=vehicle_id), outlook, now_s), alert)


def test_what_acts_what_blocks_a_resume_and_what_comes_next_are_in_the_line_of_the_alert() -> None:
    blocked = Outlook(NextChange("land", 117.2, "estimator failing"), "estimator failing", also=("estimator failing",))
    lines = shown_at(200, [due(1, "too close", blocked)])
    assert lines[4] == (
        "ALARM: vehicle 1: too close; lands in 18 s (estimator failing); resume refused: estimator failing: "
        "hold all; land one of the two if they stay close"
    )
    acting = Outlook(NextChange("land", 117.2, "tilt too large"), "tilt too large", also=("link degraded",))
    later = structs.replace(acting, next=NextChange("land", 120.0, "tilt too large"))
    rows = [due(1, "tilt too large", later), due(2, "tilt too large", acting, 101.0)]
    assert shown_at(200, rows)[5].startswith(
        "ALARM: vehicles 1, 2: tilt too large; lands in 17 s; also link degraded: check"
    ), "the first of several"
    assert "tilt too large lands in 17 s; also link degraded" in plain_line([rows[1]], 1.0, "")


def test_what_is_due_without_an_alert_is_a_note_until_it_has_come() -> None:
    end = Outlook(NextChange("return and land", 130.0, "mission's end"))
    assert "vehicle 1: returns and lands in 30 s (mission's end)" in shown_at(100, [due(1, "", end)])
    pushed = Outlook(guard=("separation", "fence"), evaded=(2, 3))
    assert "vehicle 1: evading 2, 3, kept inside the fence" in shown_at(100, [due(1, "", pushed)])
    assert "mission's end" not in " ".join(shown_at(100, [due(1, "", end, 132.1)]))


def test_a_vehicle_that_waits_for_a_resume_asks_for_it_first_of_all_alarms() -> None:
    rows = [alerted(1, "too close"), due(2, "telemetry stale", Outlook(waits_for_resume=True))]
    asked, close = shown_at(200, rows)[5:7]
    assert asked == "ALARM: vehicle 2: waits for resume: telemetry stale is over: resume continues its mission"
    assert close.startswith("ALARM: vehicle 1: too close")


def test_vehicles_that_are_unaccounted_for_come_first_with_their_places_also_after_the_end() -> None:
    """All of them, however many other alerts there are; the rest of the table has ended."""
    rows = [structs.replace(ROWS[0], vehicle_id=i, ending="disarmed") for i in (1, 2)]
    for i in range(3, 9):
        last = Unaccounted(i, 47.397742, 8.545594, (0.0, 0.0, float(i)), 35.0)
        rows.append(with_unaccounted(structs.replace(ROWS[0], vehicle_id=i, mode=""), last))
    for closes in (False, True):
        lines = shown_at(120, rows, closes=closes, height=40)
        table = [line.split()[:2] for line in lines if "MISSING" in line or " ended " in line]
        assert table[-8:] == [*([f"!!{i}", "MISSING"] for i in range(3, 9)), ["1", "ended"], ["2", "ended"]], closes
        for i in range(3, 9):
            assert any(f"ALARM: vehicle {i}: unaccounted for: last at 47.397742, 8.545594" in line for line in lines)
    assert "#3 MISSING" in plain_line(rows, 12.0, "")
    assert "47.397742, 8.545594, height 3.0 m, 35 s ago" in plain_line(rows, 12.0, "")


def test_a_hundred_and_twenty_columns_show_everything() -> None:
    unknown = structs.replace(ROWS[1], autopilot=AutopilotReport(0.31, None, 3, None))
    lines = shown_at(120, [ROWS[0], unknown])
    assert lines[1].split()[-5:] == ["r", "trip", "ω", "lead", "lag"]
    assert lines[3].split() == [
        "1", "encircle", "offboard", "8.0", "0.5", "17.3", "to", "2", "4.3", "0.0", "3D", "12", "83%",
        "10.02", "120", "+0.051", "119.2", "121.3",
    ]  # fmt: skip
    assert "return and land" in lines[4]
    assert " 3D – " in re.sub(" +", " ", lines[4]), "an unknown number of satellites is not 0"
    assert max(map(len, lines)) <= 120


def test_the_widest_values_fit_eighty_columns() -> None:
    widest = structs.replace(
        ROWS[0], vehicle_id=254, tactic="pilot override", mode="take-off", position_m=(0.0, 0.0, -123.4),
        velocity_m_s=(12.3, 0.0), nearest_m=2.9, fence_margin_m=-123.4, link_age_s=99.9, gps_threat="jammed",
        autopilot=AutopilotReport(0.12, None, 3, 12), radius_m=123.45,
    )  # fmt: skip
    row = shown_at(80, [with_alert(widest, "battery critical")])[3]
    assert row.split() == [
        "!!254", "PILOT", "take-off", "-123.4", "12.3", "2.9!!", "-123.4!!", "99.9!!", "jammed", "12", "12%!!",
        "123.45",
    ]  # fmt: skip


def test_a_team_that_is_too_large_for_the_screen_shows_those_with_alerts_and_the_hint() -> None:
    rows = [alerted(i, "battery low" if i in (20, 31) else "") for i in range(1, 33)]
    lines = shown_at(80, rows)
    assert len(lines) <= 24
    ids = [line.split()[0] for line in lines if "encircle" in line]
    assert ids == [*map(str, range(1, len(ids) - 1)), "!!20", "!!31"]
    assert f"and {32 - len(ids)} more vehicles" in lines
    assert "ALARM: vehicles 20, 31: battery low: it returns and lands: clear its landing" in lines
    assert lines[-1] == "h hold"


def test_many_alerts_leave_room_for_vehicles_and_the_hint() -> None:
    alerts = [condition.value for condition in Condition]
    rows = [structs.replace(alerted(i, alert), note="ring") for i, alert in enumerate(alerts, 1)]
    lines = shown_at(80, rows)
    assert len(lines) <= 24
    assert lines[-1] == "h hold"
    assert "encircle" in lines[3]
    assert f"and {len(alerts) - 4} more alerts" in lines


def test_after_the_end_nothing_is_shown_as_flying(subtests: pytest.Subtests) -> None:
    down = [with_alert(structs.replace(row, ending="disarmed"), "") for row in ROWS]
    for rows, ending in ((down, "disarmed"), (ROWS, "unknown")):
        with subtests.test(ending=ending):
            lines = shown_at(80, rows, closes=True)
            assert lines[0].startswith("ENDED  case2  T+12.0 s")
            assert [line.split()[:3] for line in lines[3:6]] == [[f"{i}", "ended", ending] for i in (1, 2, 3)]
            assert not any(word in "\n".join(lines) for word in ("offboard", "encircle", "ALARM", "h hold", "NO LINK"))


def test_events_and_alerts_have_the_colour_and_the_word_of_their_severity() -> None:
    console, output = terminal()
    with LiveView(console) as view:
        view.print_line("1.0 s: vehicle 1: battery low", "alarm")
        view.print_line("1.0 s: vehicle 1: peer silent", "warning")
        view.print_line("1.0 s: vehicle 1: [holds]")
        view.update([alerted(1, "peer silent")], 1.0)
    told = output.getvalue()
    assert "\x1b[1;31mALARM: 1.0 s: vehicle 1: battery low" in told
    assert "\x1b[33mwarning: 1.0 s: vehicle 1: peer silent" in told
    assert "\x1b[2K1.0 s: vehicle 1: [holds]" in told


def test_the_bell_rings_once_for_each_new_alarm(subtests: pytest.Subtests) -> None:
    console, output = terminal()
    steps: tuple[tuple[list[TeamRow], int], ...] = (
        ([alerted(1, ""), alerted(2, "")], 0),
        ([alerted(1, "peer silent"), alerted(2, "")], 0),
        ([alerted(1, "battery low"), alerted(2, "")], 1),
        ([alerted(1, "battery low"), alerted(2, "battery low")], 2),
        ([alerted(1, ""), alerted(2, "battery low")], 2),
        ([alerted(1, "battery low"), alerted(2, "battery low")], 3),
    )
    with LiveView(console) as view:
        for rows, rings in steps:
            with subtests.test(alerts=[each.alert for each in rows]):
                view.update(rows, 1.0)
                assert output.getvalue().count("\a") == rings
    console, output = plain()
    with LiveView(console) as view:
        view.update([alerted(1, "battery low")], 1.0)
    assert "\a" not in output.getvalue()


def test_what_others_have_written_makes_a_terminal_do_nothing() -> None:
    evil, output = "\x1b[2J\x1b]0;mine\x07\x9b31m\u202e", StringIO()
    with LiveView(PrintableConsole(file=output, force_terminal=True, width=120)) as view:
        view.update([TeamRow(1, tactic=f"tactic {evil}", mode="offboard", note=evil)], 1.0, evil, Text(evil))
        view.print_line(f"said {evil}")
    assert "said ?[2J" in output.getvalue()
    for harm in ("\x1b[2J", "\x1b]", "\x07", "\x9b", "\u202e"):
        assert harm not in output.getvalue()


def test_a_terminal_gets_a_table_drawn_over_and_left_standing() -> None:
    console, output = terminal()
    with LiveView(console) as view:
        for tick in range(50):
            view.update(ROWS, tick / 10.0, "flying")
    told = output.getvalue()
    assert "4.9 s" in told  # the newest state is drawn once more at the end
    assert told.count("flying") < 10  # and not every update on the way
    assert told.rindex("\x1b[?25h") > told.rindex("\x1b[?25l")  # the cursor is back
    assert told.rindex("\x1b[?2004l") > told.rindex("\x1b[?2004h")  # pasted text is not marked any more


def test_the_hint_is_below_the_table_and_news_stay_above_it() -> None:
    console, output = terminal()
    with LiveView(console) as view:
        view.update(ROWS, 1.0, "flying", Text("h hold"))
        until_now(lambda: "h hold" in output.getvalue())
        view.print_line("0.5 s: vehicle 1: [holds]")
        told = output.getvalue()
        assert told.index("[holds]") < told.rindex("1.0 s") < told.rindex("flying") < told.rindex("h hold")
    told = output.getvalue()
    assert told.count("h hold") < told.count("1.0 s"), "after the end no key does anything"


def test_of_a_flight_that_fails_before_it_shows_a_team_only_the_restored_terminal_is_left() -> None:
    console, output = terminal()
    with contextlib.suppress(RuntimeError), LiveView(console) as view:
        view.update([], 0.0, "looking for the vehicles")
        output.seek(output.truncate(0))
        raise RuntimeError("the flight failed")
    assert "looking" not in output.getvalue()
    assert "ENDED" not in output.getvalue()
    assert output.getvalue().rstrip().endswith("\x1b[?25h\x1b[?2004l")


def test_elsewhere_a_line_comes_every_half_minute_of_the_mission_at_most() -> None:
    console, output = plain()
    with LiveView(console) as view:
        for tick in range(0, 901):
            view.update(ROWS, tick / 10.0, "")
    lines = output.getvalue().splitlines()
    assert [line.split(" ")[0] for line in lines] == [f"t={due}.0s" for due in range(0, 91, 30)]
    assert "\x1b" not in output.getvalue()


def test_a_mission_that_starts_again_is_told_at_once() -> None:
    console, output = plain()
    view = LiveView(console)
    for now_s in (95.0, 96.0, 0.0):
        view.update(ROWS, now_s, "")
    assert [line.split(" ")[0] for line in output.getvalue().splitlines()] == ["t=95.0s", "t=0.0s"]


def test_a_dumb_terminal_gets_lines() -> None:
    output = StringIO()
    console = Console(file=output, force_terminal=True, _environ={"TERM": "dumb"})
    with LiveView(console) as view:
        view.update(ROWS, 1.0, "", Text("h hold"))
        view.print_line("0.5 s: vehicle 1: [holds]")
    # One line, however narrow; brackets and all, and no hint.
    assert output.getvalue() == plain_line(ROWS, 1.0, "") + "\n0.5 s: vehicle 1: [holds]\n"


def test_the_plain_line_leaves_out_what_is_not_known() -> None:
    assert plain_line(ROWS[1:], 12.34, "go") == (
        "t=12.3s | #2 return and land offboard r=9.97m w=-0.050rad/s lead=120.8deg lag=119.2deg battery=31%"
        " ring [pair 1] | #3 formation no-link fence=-0.5m battery=12% battery critical | go"
    )


def test_the_summary_gives_each_verdict_its_sign_and_its_evidence() -> None:
    lines = rendered(summary(RESULT)).splitlines()
    assert lines[0].strip() == "case2  simulation, seed 7, 600 s in 6.0 s (100× real time)"
    assert "truth" in lines[1]
    assert [re.split(r"\s{2,}", line.strip()) for line in lines[2:7]] == [
        ["✓", "C1 radius", "error 0.012 m rms"],
        ["✓", "C2 angular rate", "mean 0.0501 rad/s"],
        ["–", "C3 spacing", "error 0.58° rms, 4.96° max; settled after 6.1 s"],
        ["✓", "formation", "speed error 0.014 m/s rms, spacing error 0.020 m rms"],
        ["✗", "separation", "closest approach 1.370 m"],
    ]
    assert lines[7].split() == ["–", "engaged"]
    assert lines[8].split() == ["–", "kept"]
    told = "ring judged over 309.1 s from 290.9 s on, 84% of its time: from settling to the end"
    assert " ".join(lines[9:11]).split() == told.split()
    assert lines[14].split() == ["1", "encircle", "284.8", "0.012", "0.034", "+0.0501", "0.0007", "0.013", "–"]
    assert lines[15].split() == ["2", "formation", "–", "–", "–", "–", "–", "0.014", "0.020"]
    assert lines[19].split() == ["flight", "1.37", "17.32", "0.501", "0.100", "10.00", "12.35"]
    assert "18000 ticks, 2 missed; a tick took 220 µs (median), 621 µs (99 %)" in lines[21]


def test_the_summary_names_the_reference_and_the_figures_beside_it() -> None:
    beside = EstimateResult(
        (EstimatedVehicleResult(1, 0.111, 0.2, 0.05, 0.444, 0.5),), RingResult(None, 0.77, 1.0), 1.5
    )
    lines = rendered(summary(replace(RESULT, estimate=beside))).splitlines()
    (told,) = [line for line in lines if "0.111" in line]
    assert "rate 0.0500 rad/s" in told
    assert "estimate" in told
    assert "truth" in lines[1]
    plain = rendered(summary(RESULT))
    assert "estimate" not in plain
    by_estimate = rendered(summary(replace(RESULT, reference="estimate", truth_missing="no truth of vehicle 2")))
    assert "estimate" in by_estimate.splitlines()[1]
    assert "no truth of vehicle 2" in " ".join(by_estimate.split())


def test_the_summary_of_a_flight_without_a_ring_claims_nothing() -> None:
    bare = replace(
        RESULT,
        window_s=None,
        vehicles=(VehicleResult(1, None, "unknown"),),
        ring=RingResult(),
        reynolds=ReynoldsResult(),
        closest_approach_m=None,
        guard_interventions=None,
        guard_causes={},
        loop=LoopResult(10.0, 0, 0, None, None),
        verdicts=Verdicts(None, None, None, None, None),
        realtime_factor=None,
    )
    told = rendered(summary(bare))
    assert [line.split()[-1] for line in told.splitlines()[2:7]] == [
        "radius", "rate", "spacing", "formation", "separation",
    ]  # fmt: skip
    assert "guard" not in told
    assert "Reynolds" not in told
    assert "600 s\n" in re.sub(" +\n", "\n", rendered(summary(RESULT.untimed())))
    assert "tick took" not in told
    assert "did not settle" in rendered(summary(replace(RESULT, ring=RingResult())))
