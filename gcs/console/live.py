"""Terminal output of a flight: the live table of the team."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from agents.ports import FlightMode
from gcs.console.advice import Severity
from gcs.console.table_view import (
    STYLES,
    ControlCode,
    TableForm,
    TableView,
    apart_cell,
    fence_cell,
    graded,
    number,
    tactic_cell,
    vehicle_cell,
)

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
LIVE_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("", "right"),
    ("tactic", "left"),
    ("mode", "left"),
    ("height\n[m]", "right"),
    ("speed\n[m/s]", "right"),
    ("near\n[m]", "right"),
    ("fence\n[m]", "right"),
    ("link\n[s]", "right"),
    ("GPS\n(sat)", "right"),
    ("batt", "right"),
    ("r\n[m]", "right"),
)
WIDE_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("trip\n[ms]", "right"),
    ("ω\n[rad/s]", "right"),
    ("lead\n[°]", "right"),
    ("lag\n[°]", "right"),
)
"""Columns that do not fit into 80 characters."""


@dataclass(frozen=True, slots=True)
class LiveRow:
    """One vehicle at one time; None for a value that does not apply or is unknown.

    `nearest_m` is the horizontal distance to the nearest other vehicle, too close below `separation_m`; `fence_m` is
    the distance to the fence, negative outside. `link_age_s` is the age of the newest telemetry, `round_trip_s` the
    time from a message to its answer [wall s]; `gps` the fix and the satellites. `spacing_lead_deg` and
    `spacing_lag_deg` are the angles to the neighbours on the ring; `battery` is a fraction. `ending` is how the
    vehicle's flight ended, empty before.
    """

    vehicle_id: int
    tactic: str
    mode: str
    connected: bool
    radius_m: float | None = None
    angular_rate_rad_s: float | None = None
    spacing_lead_deg: float | None = None
    spacing_lag_deg: float | None = None
    battery: float | None = None
    note: str = ""
    alert: str = ""
    height_m: float | None = None
    speed_m_s: float | None = None
    nearest_id: int | None = None
    nearest_m: float | None = None
    separation_m: float = 0.0
    fence_m: float | None = None
    link_age_s: float | None = None
    round_trip_s: float | None = None
    gps: str = "–"
    ending: str = ""


class LiveView(TableView[LiveRow]):
    """The view of a flight."""

    def __init__(self, console: Console) -> None:
        """Prepare to draw on `console`, normally standard error's."""
        super().__init__(console, TableForm(live_table, plain_line, "ENDED", PLAIN_INTERVAL_S))

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


def live_table(rows: Sequence[LiveRow], wide: bool, closed: bool) -> Table:
    """Return the table of a team; a closed one shows no vehicle as flying."""
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for name, justify in (*LIVE_COLUMNS, *(WIDE_COLUMNS if wide else ())):
        table.add_column(Text(name), justify=justify, no_wrap=True)
    for row in rows:
        if closed or row.ending:
            table.add_row(*(Text(cell.plain) for cell in _cells(_off_the_ring(row), wide, True)), style="dim")
        else:
            table.add_row(*_cells(row, wide, False))
    return table


def plain_line(rows: Sequence[LiveRow], mission_time_s: float, message: str) -> str:
    """Return the table as one line of plain text, vehicles separated by bars."""
    return " | ".join([f"t={mission_time_s:.1f}s", *map(_plain_vehicle, rows), *filter(None, [message])])


def _off_the_ring(row: LiveRow) -> LiveRow:
    return replace(row, radius_m=None, angular_rate_rad_s=None, spacing_lead_deg=None, spacing_lag_deg=None)


def _cells(row: LiveRow, wide: bool, over: bool) -> list[Text]:
    silent: Severity = "alarm" if row.link_age_s is not None and row.link_age_s > LINK_OLD_S else "information"
    cells = [
        vehicle_cell(row, over),
        Text("ended") if over else tactic_cell(row.tactic, wide),
        Text(row.ending or "unknown") if over else _mode(row),
        Text(number(row.height_m, ".1f")),
        Text(number(row.speed_m_s, ".1f")),
        apart_cell(row.nearest_m, row.nearest_id, row.separation_m, wide),
        fence_cell(row.fence_m),
        graded(row.link_age_s, ".1f", silent),
        Text(row.gps),
        graded(row.battery, ".0%", _battery_severity(row.battery)),
        Text(number(row.radius_m, ".2f")),
    ]
    if wide:
        cells += [
            Text(number(None if row.round_trip_s is None else 1e3 * row.round_trip_s, ".0f")),
            Text(number(row.angular_rate_rad_s, "+.3f")),
            Text(number(row.spacing_lead_deg, ".1f")),
            Text(number(row.spacing_lag_deg, ".1f")),
        ]
    return cells


def _mode(row: LiveRow) -> Text:
    if row.connected:
        return Text(row.mode, style=MODE_STYLES.get(row.mode, ""))
    return Text("NO LINK", style=STYLES["alarm"])


def _plain_vehicle(row: LiveRow) -> str:
    numbers = (
        ("height", row.height_m, ".1f", "m"),
        ("speed", row.speed_m_s, ".1f", "m/s"),
        ("near", row.nearest_m, ".1f", "m"),
        ("fence", row.fence_m, ".1f", "m"),
        ("r", row.radius_m, ".2f", "m"),
        ("w", row.angular_rate_rad_s, "+.3f", "rad/s"),
        ("lead", row.spacing_lead_deg, ".1f", "deg"),
        ("lag", row.spacing_lag_deg, ".1f", "deg"),
        ("battery", row.battery, ".0%", ""),
    )
    known = [f"{name}={value:{form}}{unit}" for name, value, form, unit in numbers if value is not None]
    mode = row.ending or (row.mode if row.connected else "no-link")
    parts = [f"#{row.vehicle_id}", "ended" if row.ending else row.tactic, mode, *known, row.alert, row.note]
    return " ".join(filter(None, parts))


def _battery_severity(battery: float | None) -> Severity:
    if battery is None or battery >= BATTERY_LOW:
        return "information"
    return "alarm" if battery < BATTERY_CRITICAL else "warning"
