"""Terminal output of a flight: the live table of the team."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Self, TypeVar

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from gcs.console.printable import Printable, printable_lines

RowT = TypeVar("RowT")

PLAIN_INTERVAL_S = 30.0
NO_HINT = Text()
REFRESH_HZ = 4.0
BATTERY_LOW, BATTERY_CRITICAL = 0.35, 0.2
TACTIC_STYLES = {"formation": "cyan", "encircle": "magenta", "excite": "blue", "unknown": "dim"}
MODE_STYLES = {"offboard": "green", "hold": "yellow", "land": "yellow", "return": "yellow", "unknown": "dim"}
LIVE_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("", "right"),
    ("tactic", "left"),
    ("mode", "left"),
    ("r\n[m]", "right"),
    ("ω\n[rad/s]", "right"),
    ("lead\n[°]", "right"),
    ("lag\n[°]", "right"),
    ("batt", "right"),
)


@dataclass(frozen=True, slots=True)
class LiveRow:
    """One vehicle at one time; None where a value does not apply or is not known.

    `spacing_lead_deg` and `spacing_lag_deg` are the angles to the neighbours on the ring; `battery` is a fraction.
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


class TableView(Generic[RowT]):
    """A live table on a terminal; elsewhere a line of text every `interval_s` at most.

    Use it as a context manager. `update` only stores the rows: the table is drawn four times a second.
    """

    def __init__(
        self,
        console: Console,
        table: Callable[[Sequence[RowT], float, str], RenderableType],
        line: Callable[[Sequence[RowT], float, str], str],
        interval_s: float = PLAIN_INTERVAL_S,
    ) -> None:
        """Prepare to draw on `console`, normally standard error's, tables or lines made of rows, time and message."""
        self._console = console
        self._table = table
        self._line = line
        self._interval_s = interval_s
        self._shown: tuple[Sequence[RowT], float, str, Text] = ((), 0.0, "", NO_HINT)
        self._printed_s: float | None = None
        self._live: Live | None = None
        if console.is_terminal and not console.is_dumb_terminal:
            self._live = Live(
                console=console,
                get_renderable=self._render,
                refresh_per_second=REFRESH_HZ,
                redirect_stdout=False,
            )

    def __enter__(self) -> Self:
        """Start drawing."""
        if self._live is not None:
            self._live.start(refresh=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Draw the newest state once more and leave it on the screen."""
        if self._live is not None:
            self._live.stop()

    @property
    def is_live(self) -> bool:
        """Whether the table is drawn on a terminal."""
        return self._live is not None

    def update(self, rows: Sequence[RowT], mission_time_s: float, message: str = "", hint: Text = NO_HINT) -> None:
        """Show the team at a mission time; a terminal shows the hint below the table."""
        self._shown = (tuple(rows), mission_time_s, message, hint)
        if self._live is None and self._line_is_due(mission_time_s):
            self._printed_s = mission_time_s
            self.print_line(self._line(rows, mission_time_s, message))

    def print_line(self, text: str) -> None:
        """Print a permanent line above the table."""
        self._console.print(printable_lines(text), markup=False, highlight=False, soft_wrap=True)

    def _line_is_due(self, now_s: float) -> bool:
        return self._printed_s is None or not 0.0 <= now_s - self._printed_s < self._interval_s

    def _render(self) -> RenderableType:
        rows, time_s, message, hint = self._shown
        table = self._table(rows, time_s, message)
        # A live view is drawn past the console's own hooks.
        return Printable(Group(table, hint) if hint else Group(table))


class LiveView(TableView[LiveRow]):
    """The view of a flight."""

    def __init__(self, console: Console) -> None:
        """Prepare to draw on `console`, normally standard error's."""
        super().__init__(console, live_table, plain_line)


def live_table(rows: Sequence[LiveRow], mission_time_s: float, message: str) -> RenderableType:
    """Return the table of a team at a mission time."""
    clock = f"{mission_time_s:.1f} s"
    table = Table(
        title=clock, title_justify="left", title_style="bold", box=None, pad_edge=False, collapse_padding=True
    )
    for name, justify in LIVE_COLUMNS:
        table.add_column(Text(name), justify=justify, no_wrap=True)
    table.add_column("")
    for row in rows:
        table.add_row(*_cells(row), style="" if row.connected else "dim")
    return Group(table, Text(message, style="yellow")) if message else table


def plain_line(rows: Sequence[LiveRow], mission_time_s: float, message: str) -> str:
    """Return the table as one line of plain text, vehicles separated by bars."""
    return " | ".join([f"t={mission_time_s:.1f}s", *map(_plain_vehicle, rows), *filter(None, [message])])


def _cells(row: LiveRow) -> tuple[Text, ...]:
    mode = Text(row.mode, style=MODE_STYLES.get(row.mode, "")) if row.connected else Text("no link", style="bold red")
    return (
        Text(str(row.vehicle_id), style="bold"),
        Text(row.tactic, style=TACTIC_STYLES.get(row.tactic, "")),
        mode,
        Text(number(row.radius_m, ".2f")),
        Text(number(row.angular_rate_rad_s, "+.3f")),
        Text(number(row.spacing_lead_deg, ".1f")),
        Text(number(row.spacing_lag_deg, ".1f")),
        Text(number(row.battery, ".0%"), style=_battery_style(row.battery)),
        Text(row.note, style="yellow"),
    )


def _plain_vehicle(row: LiveRow) -> str:
    numbers = (
        ("r", row.radius_m, ".2f", "m"),
        ("w", row.angular_rate_rad_s, "+.3f", "rad/s"),
        ("lead", row.spacing_lead_deg, ".1f", "deg"),
        ("lag", row.spacing_lag_deg, ".1f", "deg"),
        ("battery", row.battery, ".0%", ""),
    )
    known = [f"{name}={value:{form}}{unit}" for name, value, form, unit in numbers if value is not None]
    parts = [f"#{row.vehicle_id}", row.tactic, row.mode if row.connected else "no-link", *known, row.note]
    return " ".join(filter(None, parts))


def _battery_style(battery: float | None) -> str:
    if battery is None or battery >= BATTERY_LOW:
        return ""
    return "bold red" if battery < BATTERY_CRITICAL else "yellow"


def number(value: float | None, form: str) -> str:
    """Return a number in a format, a dash for None."""
    return "–" if value is None else format(value, form)
