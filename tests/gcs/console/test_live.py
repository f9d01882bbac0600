"""The live table and the summary, rendered into strings."""

import contextlib
import re
from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console, RenderableType

from gcs.console.live import LiveRow, LiveView, live_table, plain_line
from gcs.console.summary import summary
from gcs.metrics.result import (
    EstimatedVehicleResult,
    EstimateResult,
    FlightResult,
    FlockingResult,
    LoopResult,
    ReynoldsResult,
    RingResult,
    VehicleResult,
    Verdicts,
)

ROWS = (
    LiveRow(1, "encircle", "offboard", True, 10.02, 0.0512, 119.24, 121.3, 0.83),
    LiveRow(2, "encircle", "offboard", True, 9.97, -0.05, 120.8, 119.2, 0.31, "guard [pair 1]"),
    LiveRow(3, "formation", "hold", False, battery=0.12, note="silent for 3 s"),
)
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
    ring=RingResult(6.1, 0.58, 4.96),
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


def test_the_table_shows_every_number_with_its_unit_in_eighty_columns() -> None:
    lines = rendered(live_table(ROWS, 123.4, "vehicle 3 lost: hold")).splitlines()
    assert lines[0].strip() == "123.4 s"
    assert lines[1].split() == ["r", "ω", "lead", "lag"]
    assert lines[2].split() == ["tactic", "mode", "[m]", "[rad/s]", "[°]", "[°]", "batt"]
    assert lines[3].split() == ["1", "encircle", "offboard", "10.02", "+0.051", "119.2", "121.3", "83%"]
    assert "no link" in lines[-2]
    assert lines[-2].count("–") == 4
    assert "hold" not in lines[-2]
    assert lines[-1].strip() == "vehicle 3 lost: hold"
    assert max(map(len, lines)) <= 80


def test_brackets_in_a_note_are_no_markup() -> None:
    assert "guard [pair 1]" in rendered(live_table(ROWS, 0.0, ""), width=120)


def test_a_low_battery_is_coloured(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[float, str], ...] = (
        (0.83, ""),
        (0.35, ""),
        (0.34, "\x1b[33m"),
        (0.2, "\x1b[33m"),
        (0.19, "\x1b[1;31m"),
    )
    for battery, style in rows:
        with subtests.test(battery=battery, style=style):
            told = rendered(live_table([replace(ROWS[0], battery=battery)], 0.0, ""), colour=True)
            assert f"{style} {battery:.0%}" in told if style else f"\x1b[33m {battery:.0%}" not in told


def test_a_lost_link_is_red() -> None:
    told = rendered(live_table([replace(ROWS[0], connected=False)], 0.0, ""), colour=True)
    assert re.search(r"\x1b\[[\d;]*31m\s*no link", told)


def test_a_terminal_gets_a_table_drawn_over_and_left_standing() -> None:
    console, output = terminal()
    with LiveView(console) as view:
        for tick in range(50):
            view.update(ROWS, tick / 10.0, "flying")
    told = output.getvalue()
    assert "4.9 s" in told  # the newest state is drawn once more at the end
    assert told.count("flying") < 10  # and not every update on the way
    assert told.rstrip().endswith("\x1b[?25h")  # the cursor is back


def test_the_hint_is_below_the_table_and_news_stay_above_it() -> None:
    console, output = terminal()
    with LiveView(console) as view:
        view.update(ROWS, 1.0, "flying", "h hold")
        view.print_line("0.5 s: vehicle 1: [holds]")
        view.update(ROWS, 1.1, "flying", "h hold")
    told = output.getvalue()
    assert told.index("[holds]") < told.index("1.1 s") < told.rindex("h hold")
    assert told.rindex("flying") < told.rindex("h hold")


def test_elsewhere_there_are_news_but_no_hints() -> None:
    console, output = plain()
    with LiveView(console) as view:
        view.update((), 1.0, "", "h hold")
        view.print_line("0.5 s: vehicle 1: [holds]")
    assert output.getvalue() == "t=1.0s\n0.5 s: vehicle 1: [holds]\n"


def test_the_terminal_is_restored_when_the_flight_fails() -> None:
    console, output = terminal()
    with contextlib.suppress(RuntimeError), LiveView(console):
        raise RuntimeError("the flight failed")
    assert output.getvalue().rstrip().endswith("\x1b[?25h")


def test_elsewhere_a_line_comes_every_half_minute_of_the_mission_at_most() -> None:
    console, output = plain()
    with LiveView(console) as view:
        for tick in range(0, 3001):
            view.update(ROWS, tick / 10.0, "")
    lines = output.getvalue().splitlines()
    assert [line.split(" ")[0] for line in lines] == [f"t={due}.0s" for due in range(0, 301, 30)]
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
        view.update(ROWS, 1.0, "")
    assert output.getvalue() == plain_line(ROWS, 1.0, "") + "\n"  # one line, however narrow; brackets and all


def test_the_plain_line_leaves_out_what_is_not_known() -> None:
    assert plain_line(ROWS[1:], 12.34, "go") == (
        "t=12.3s | #2 encircle offboard r=9.97m w=-0.050rad/s lead=120.8deg lag=119.2deg battery=31%"
        " guard [pair 1] | #3 formation no-link battery=12% silent for 3 s | go"
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
    assert lines[8].strip() == "ring judged over 309.1 s, from 290.9 to 600.0 s: from settling to the end"
    assert lines[12].split() == ["1", "encircle", "284.8", "0.012", "0.034", "+0.0501", "0.0007", "0.013", "–"]
    assert lines[13].split() == ["2", "formation", "–", "–", "–", "–", "–", "0.014", "0.020"]
    assert lines[17].split() == ["flight", "1.37", "17.32", "0.501", "0.100", "10.00", "12.35"]
    assert "18000 ticks, 2 missed; a tick took 220 µs (median), 621 µs (99 %)" in lines[19]


def test_the_summary_names_the_reference_and_the_figures_beside_it() -> None:
    beside = EstimateResult(
        (EstimatedVehicleResult(1, 0.111, 0.2, 0.05, 0.444, 0.5),), RingResult(None, 0.77, 1.0), 1.5
    )
    lines = rendered(summary(replace(RESULT, estimate=beside))).splitlines()
    (told,) = [line for line in lines if "0.111" in line]
    assert "estimate" in told
    assert "truth" in lines[1]
    plain = rendered(summary(RESULT))
    assert "estimate" not in plain
    by_estimate = rendered(summary(replace(RESULT, reference="estimate", truth_missing="no truth of vehicle 2")))
    assert "estimate" in by_estimate.splitlines()[1]
    assert "no truth of vehicle 2" in " ".join(by_estimate.split())


def test_the_summary_colours_failures_red() -> None:
    told = rendered(summary(RESULT), colour=True)
    assert "\x1b[1;31m✗" in told
    assert "\x1b[1;32m✓" in told


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
