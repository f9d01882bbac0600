"""Terminal output of a flight: the live table of the team."""

from collections.abc import Sequence
from functools import partial
from types import TracebackType
from typing import Self

from msgspec.structs import replace
from rich.console import Console
from rich.table import Table
from rich.text import Text

from agents.ports import FlightMode
from gcs.console.advice import Severity
from gcs.console.table_view import (
    MISSING,
    MOTION_COLUMNS,
    STYLES,
    UNKNOWN_TACTIC,
    Column,
    ControlCode,
    TableForm,
    TableView,
    empty_table,
    graded,
    in_degrees,
    motion_cells,
    motion_numbers,
    number,
    plain_row,
    tactic_cell,
    vehicle_cell,
)
from gcs.console.vehicle_view import TeamRow

PLAIN_INTERVAL_S = 30.0
BATTERY_LOW, BATTERY_CRITICAL = 0.35, 0.2
LINK_OLD_S = 1.0
MODE_STYLES = {
    FlightMode.OFFBOARD.value: "green",
    FlightMode.HOLD.value: "yellow",
    FlightMode.LAND.value: "yellow",
    FlightMode.RETURN.value: "yellow",
    FlightMode.UNKNOWN.value: "dim",
}
BRACKET_PASTES, DO_NOT_BRACKET_PASTES = "\x1b[?2004h", "\x1b[?2004l"
"""Switch the terminal's bracketed paste mode on and off."""
LIVE_COLUMNS: tuple[Column, ...] = (
    ("", "right"),
    ("tactic", "left"),
    ("mode", "left"),
    *MOTION_COLUMNS,
    ("link\n[s]", "right"),
    ("GPS\n(sat)", "right"),
    ("batt", "right"),
    ("r\n[m]", "right"),
)
WIDE_COLUMNS: tuple[Column, ...] = (
    ("trip\n[ms]", "right"),
    ("ω\n[rad/s]", "right"),
    ("lead\n[°]", "right"),
    ("lag\n[°]", "right"),
)
"""Columns that do not fit into 80 characters."""


class LiveView(TableView):
    """The view of a flight."""

    def __init__(self, console: Console, separation_m: float = 0.0) -> None:
        """Prepare to draw on `console`, normally standard error's; distances below `separation_m` are too close."""
        super().__init__(console, TableForm(partial(live_table, separation_m), plain_line, "ENDED", PLAIN_INTERVAL_S))

    def __enter__(self) -> Self:
        """Start drawing, and switch on bracketed paste mode."""
        if self.is_live:
            self._console.print(ControlCode(BRACKET_PASTES), end="")
        return super().__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Draw the last state of the flight, and restore the terminal."""
        super().__exit__(kind, error, trace)
        if self.is_live:
            self._console.print(ControlCode(DO_NOT_BRACKET_PASTES), end="")


def flight_title(mission: str, time_s: float | None, duration_s: float, ring_members: int, vehicles: int) -> str:
    """Return the title of a flight at a mission time, None before its start."""
    clock = "before the start" if time_s is None else f"T+{time_s:.1f} s, {max(duration_s - time_s, 0.0):.0f} s left"
    return f"{mission}  {clock}  ring {ring_members} of {vehicles}"


def live_table(separation_m: float, rows: Sequence[TeamRow], wide: bool, closed: bool) -> Table:
    """Return the table of a team; a closed one shows no vehicle as flying."""
    table = empty_table((*LIVE_COLUMNS, *(WIDE_COLUMNS if wide else ())))
    for row in rows:
        over = (closed or bool(row.ending)) and not row.is_unaccounted
        cells = _cells(_off_the_ring(row) if over else row, separation_m, wide, over)
        table.add_row(*(Text(cell.plain) for cell in cells) if over else cells, style="dim" if over else "")
    return table


def plain_line(rows: Sequence[TeamRow], mission_time_s: float, message: str) -> str:
    """Return the table as one line of plain text, vehicles separated by bars."""
    return " | ".join([f"t={mission_time_s:.1f}s", *map(_plain_vehicle, rows), *filter(None, [message])])


def _off_the_ring(row: TeamRow) -> TeamRow:
    return replace(row, radius_m=None, angular_rate_rad_s=None, lead_rad=None, lag_rad=None)


def _cells(row: TeamRow, separation_m: float, wide: bool, over: bool) -> list[Text]:
    silent: Severity = "alarm" if row.link_age_s is not None and row.link_age_s > LINK_OLD_S else "information"
    cells = [
        vehicle_cell(row, over),
        Text(row.over) if over else tactic_cell(row, wide),
        Text(row.ending or "unknown") if over else _mode(row),
        *motion_cells(row, separation_m, wide),
        graded(row.link_age_s, ".1f", silent),
        Text(_gps(row)),
        graded(row.autopilot.battery, ".0%", _battery_severity(row.autopilot.battery)),
        Text(number(row.radius_m, ".2f")),
    ]
    if wide:
        cells += [
            Text(number(None if row.round_trip_s is None else 1e3 * row.round_trip_s, ".0f")),
            Text(number(row.angular_rate_rad_s, "+.3f")),
            Text(number(in_degrees(row.lead_rad), ".1f")),
            Text(number(in_degrees(row.lag_rad), ".1f")),
        ]
    return cells


def _mode(row: TeamRow) -> Text:
    if row.mode:
        return Text(row.mode, style=MODE_STYLES.get(row.mode, ""))
    return Text("NO LINK", style=STYLES["alarm"])


def _gps(row: TeamRow) -> str:
    """Return the fix, or what disturbs it, and the satellites; a dash where the mission needs no GPS."""
    dimensions, satellites = row.autopilot.gps_dimensions, row.autopilot.satellites
    if dimensions is None:
        return "–"
    fix = row.gps_threat or (f"{dimensions}D" if dimensions else "none")
    return f"{fix} {'–' if satellites is None else satellites}"


def _plain_vehicle(row: TeamRow) -> str:
    numbers = (
        *motion_numbers(row),
        ("lead", in_degrees(row.lead_rad), ".1f", "deg"),
        ("lag", in_degrees(row.lag_rad), ".1f", "deg"),
        ("battery", row.autopilot.battery, ".0%", ""),
    )
    tactic, mode = (row.over, row.ending) if row.ending else (row.tactic or UNKNOWN_TACTIC, row.mode or "no-link")
    tactic = MISSING if row.is_unaccounted else tactic
    return plain_row(row, tactic, mode, numbers)


def _battery_severity(battery: float | None) -> Severity:
    if battery is None or battery >= BATTERY_LOW:
        return "information"
    return "alarm" if battery < BATTERY_CRITICAL else "warning"
