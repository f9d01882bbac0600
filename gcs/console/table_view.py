"""A live table of a team on a terminal: title, vehicles, alerts, and the operator's next steps."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, inf
from types import TracebackType
from typing import Self

from rich.console import Console, ConsoleOptions, Group, JustifyMethod, RenderableType, RenderResult
from rich.live import Live
from rich.segment import ControlType, Segment
from rich.table import Table
from rich.text import Text

from agents.tactics import NO_TACTIC, Tactic
from gcs.console.advice import Severity
from gcs.console.terminal import whole_words
from gcs.console.vehicle_view import TeamRow

Column = tuple[str, JustifyMethod]
"""A column's title and alignment."""
PlainNumber = tuple[str, float | None, str, str]
"""A number in a line of plain text: its name, value, format and unit."""
REFRESH_HZ = 4.0
WIDE = 110
"""Terminals with at least this many columns show all columns without abbreviations."""
SHORT_TACTICS = {Tactic.RETURN_AND_LAND.value: "return", Tactic.PILOT_OVERRIDE.value: "PILOT"}
UNKNOWN_TACTIC = "-"
RING_CHARACTERS = 6
"""The length of a ring's name where the table is not wide: with "on" as long as the longest tactic there."""
MISSING = "MISSING"
"""Stands for the tactic of a vehicle that is unaccounted for."""
TACTIC_STYLES = {
    Tactic.FORMATION.value: "cyan",
    Tactic.ENCIRCLE.value: "magenta",
    Tactic.EXCITE.value: "blue",
    NO_TACTIC: "dim",
}
STYLES: dict[Severity, str] = {"information": "", "warning": "yellow", "alarm": "bold red"}
WORDS: dict[Severity, str] = {"information": "", "warning": "warning: ", "alarm": "ALARM: "}
SIGNS: dict[Severity, str] = {"information": "", "warning": "!", "alarm": "!!"}
SAVE_CURSOR = "\x1b7"
"""Marks the start of the table: a supervisor that ends the flight erases the table from there."""
MOTION_COLUMNS: tuple[Column, ...] = (
    ("height\n[m]", "right"),
    ("speed\n[m/s]", "right"),
    ("near\n[m]", "right"),
    ("fence\n[m]", "right"),
)
NO_HINT = Text()
_ALERTS_MAX, _NOTES_MAX, _ROWS_MIN = 4, 2, 3
_HEADER_LINES = 3
_MOST_SEVERE_FIRST: tuple[Severity, ...] = ("alarm", "warning", "information")


@dataclass(frozen=True, slots=True)
class _Shown:
    """The content of the table; a closed view shows nothing as ongoing."""

    rows: tuple[TeamRow, ...] = ()
    time_s: float = 0.0
    message: str = ""
    hint: Text = field(default_factory=Text)
    title: str = ""
    closed: bool = False


@dataclass(frozen=True, slots=True)
class TableForm:
    """How a view is drawn: `table` of rows, wide and closed; elsewhere `line` of rows, time and message.

    `closed` is the title of a closed view.
    """

    table: Callable[[Sequence[TeamRow], bool, bool], Table]
    line: Callable[[Sequence[TeamRow], float, str], str]
    closed: str
    interval_s: float


class TableView:
    """A live table on a terminal; elsewhere a line of text, at most every `form.interval_s`.

    Use it as a context manager. `update` only stores the state: the table is drawn four times a second.
    """

    def __init__(self, console: Console, form: TableForm) -> None:
        """Prepare to draw on `console`, normally standard error's."""
        self._console = console
        self._form = form
        self._shown = _Shown()
        self._alarms: set[tuple[int, str]] = set()
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
        """Draw the newest state as a closed view, and leave it on the screen."""
        self._shown = replace(self._shown, closed=True)
        if self._live is not None:
            self._live.stop()

    @property
    def is_live(self) -> bool:
        """Whether the table is drawn on a terminal."""
        return self._live is not None

    def shows_at(self, time_s: float) -> bool:
        """Whether an update at this time is shown: always on a terminal, elsewhere when the next line is due."""
        return self._live is not None or self._line_is_due(time_s)

    def update(
        self, rows: Sequence[TeamRow], time_s: float, message: str = "", hint: Text = NO_HINT, title: str = ""
    ) -> None:
        """Show the team; a terminal shows the hint below the table, and rings the bell for each new alarm."""
        rows = sorted(rows, key=lambda row: not row.is_unaccounted)
        self._shown = _Shown(tuple(rows), time_s, message, hint, title or f"{time_s:.1f} s")
        alarms = {(row.vehicle_id, row.alert) for row in rows if row.severity == "alarm"}
        if self._live is not None and alarms - self._alarms:
            self._console.bell()
        self._alarms = alarms
        if self._live is None and self._line_is_due(time_s):
            self._printed_s = time_s
            self.print_line(self._form.line(rows, time_s, message))

    def print_line(self, text: str, level: Severity = "information") -> None:
        """Print a permanent line above the table."""
        line = whole_words(f"{WORDS[level]}{text}", self._console)
        self._console.print(line, style=STYLES[level], markup=False, highlight=False, soft_wrap=True)

    def _line_is_due(self, now_s: float) -> bool:
        return self._printed_s is None or not 0.0 <= now_s - self._printed_s < self._form.interval_s

    def _render(self) -> RenderableType:
        shown, (width, height) = self._shown, self._console.size
        if shown.closed and not shown.rows:
            return Group()
        title = Text(f"{self._form.closed}  {shown.title}" if shown.closed else shown.title, style="bold")
        alerts = [row for row in shown.rows if row.alert and (row.is_unaccounted or not shown.closed)]
        below = [*_alerts(alerts), *_notes(shown.rows)]
        if not shown.closed:
            below += filter(None, [Text(shown.message, style="yellow"), shown.hint])
        room = height - _HEADER_LINES - 1 - sum(len(text.wrap(self._console, width)) or 1 for text in below)
        rows = _most_urgent(shown.rows, max(room, _ROWS_MIN))
        if len(rows) < len(shown.rows):
            below.insert(0, Text(f"and {len(shown.rows) - len(rows)} more vehicles", style="dim"))
        table = [self._form.table(rows, width >= WIDE, shown.closed)] if rows else []
        return Group(ControlCode(SAVE_CURSOR), title, *table, *below)


class ControlCode:
    """A control code for the terminal, of zero width."""

    def __init__(self, code: str) -> None:
        self._code = code

    def __rich_console__(self, _console: Console, _options: ConsoleOptions) -> RenderResult:
        """Render it."""
        yield Segment(self._code, None, [(ControlType.CURSOR_MOVE_TO_COLUMN, 0)])


def number(value: float | None, form: str) -> str:
    """Return a number in a format, a dash for None."""
    return "–" if value is None else format(value, form)


def graded(value: float | None, form: str, level: Severity) -> Text:
    """Return a number with the sign and the colour of its severity."""
    return Text(f"{number(value, form)}{SIGNS[level]}", style=STYLES[level])


def vehicle_cell(row: TeamRow, closed: bool) -> Text:
    """Return the vehicle's id with the sign of its alert."""
    level: Severity = "information" if closed else row.severity
    return Text(f"{SIGNS[level]}{row.vehicle_id}", style=STYLES[level] or "bold")


def tactic_cell(row: TeamRow, wide: bool) -> Text:
    """Return a vehicle's tactic, and its ring if there are several, abbreviated where the table is not wide."""
    if row.is_unaccounted:
        return Text(MISSING, style=STYLES["alarm"])
    words = _on_ring(row.tactic, row.ring, wide) if row.ring else row.tactic if wide else _short(row.tactic)
    return Text(words or UNKNOWN_TACTIC, style=TACTIC_STYLES.get(row.tactic, ""))


def _short(tactic: str) -> str:
    return SHORT_TACTICS.get(tactic, tactic)


def _on_ring(tactic: str, ring: str, wide: bool) -> str:
    """Return the tactic and the ring of a vehicle that is on a ring or flies to one: "encircle north", "on north"."""
    if wide:
        return f"{tactic} {ring}"
    name = ring if len(ring) <= RING_CHARACTERS else f"{ring[: RING_CHARACTERS - 1]}…"
    return f"{'on' if tactic == Tactic.ENCIRCLE.value else 'to'} {name}"


def motion_cells(row: TeamRow, separation_m: float, wide: bool) -> Iterator[Text]:
    """Yield the cells of `MOTION_COLUMNS`, that of the nearest other vehicle with its id in a wide table."""
    yield Text(number(row.height_m, ".1f"))
    yield Text(number(row.speed_m_s, ".1f"))
    too_close = row.nearest_m is not None and row.nearest_m < separation_m
    apart = graded(row.nearest_m, ".1f", "alarm" if too_close else "information")
    yield apart.append(f" to {row.nearest_id}") if wide and row.nearest_m is not None else apart
    is_outside = row.fence_margin_m is not None and row.fence_margin_m < 0.0
    yield graded(row.fence_margin_m, ".1f", "alarm" if is_outside else "information")


def motion_numbers(row: TeamRow) -> tuple[PlainNumber, ...]:
    """Return the same for a line of plain text, and the motion on the ring."""
    return (
        ("height", row.height_m, ".1f", "m"),
        ("speed", row.speed_m_s, ".1f", "m/s"),
        ("near", row.nearest_m, ".1f", "m"),
        ("fence", row.fence_margin_m, ".1f", "m"),
        ("r", row.radius_m, ".2f", "m"),
        ("w", row.angular_rate_rad_s, "+.3f", "rad/s"),
    )


def plain_row(row: TeamRow, tactic: str, also: str, numbers: Iterable[PlainNumber]) -> str:
    """Return a vehicle as plain text, without the numbers that are unknown."""
    known = [f"{name}={value:{form}}{unit}" for name, value, form, unit in numbers if value is not None]
    return " ".join(
        filter(
            None,
            [f"#{row.vehicle_id}", tactic, row.ring or "", also, *known, _cause(row), row.due, row.guard, row.note],
        )
    )


def in_degrees(angle_rad: float | None) -> float | None:
    """Return an angle in degrees."""
    return None if angle_rad is None else degrees(angle_rad)


def empty_table(columns: Iterable[Column]) -> Table:
    """Return a table without rows."""
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for title, justify in columns:
        table.add_column(Text(title), justify=justify, no_wrap=True)
    return table


def _alerts(rows: Sequence[TeamRow]) -> list[Text]:
    """Return a line for each alert with what is due and the next step, the most severe first.

    Each unaccounted vehicle has a line of its own, with its last place.
    """
    whose = _vehicles({row.vehicle_id: _cause(row) for row in rows})
    alerts: dict[str, TeamRow] = {}
    for row in rows:
        cause = _cause(row)
        if cause and (cause not in alerts or _due_s(row) < _due_s(alerts[cause])):
            alerts[cause] = row
    lines = [
        Text(
            f"{WORDS[row.severity]}{whose[cause]}: {'; '.join(filter(None, [row.alert, row.due]))}: {row.advice}",
            style=STYLES[row.severity],
        )
        for cause, row in sorted(alerts.items(), key=lambda each: _rank(each[1]))
    ]
    return _first(lines, max(_ALERTS_MAX, sum(row.is_unaccounted for row in rows)), "alerts")


def _cause(row: TeamRow) -> str:
    """Return what vehicles with one line have in common: their alert."""
    return f"{row.alert}: {row.advice}" if row.is_unaccounted else row.alert


def _due_s(row: TeamRow) -> float:
    return inf if row.next is None else row.next.in_s


def _rank(row: TeamRow) -> tuple[bool, int, bool]:
    """Unaccounted vehicles come first, then alarms, and among them those that wait for the operator."""
    return not row.is_unaccounted, _MOST_SEVERE_FIRST.index(row.severity), not row.waits_for_resume


def _notes(rows: Sequence[TeamRow]) -> list[Text]:
    """Return a line for each note, for the guard's action, and for what is due without an alert."""
    shown = {row.vehicle_id: ("" if row.alert else row.due, row.guard, row.note) for row in rows}
    whose = _vehicles({vehicle_id: ", ".join(filter(None, texts)) for vehicle_id, texts in shown.items()})
    return _first([Text(f"{whose[note]}: {note}", style="yellow") for note in whose], _NOTES_MAX, "notes")


def _vehicles(texts: Mapping[int, str]) -> dict[str, str]:
    """Return the vehicles of each non-empty text, as text."""
    ids: dict[str, list[str]] = {}
    for vehicle_id, text in texts.items():
        ids.setdefault(text, []).append(str(vehicle_id))
    return {text: f"vehicle{'s' * (len(of) > 1)} {', '.join(of)}" for text, of in ids.items() if text}


def _first(lines: list[Text], count: int, what: str) -> list[Text]:
    more = len(lines) - count
    return [*lines[:count], Text(f"and {more} more {what}", style="yellow")] if more > 0 else lines


def _most_urgent(rows: Sequence[TeamRow], count: int) -> Sequence[TeamRow]:
    """Return `count` rows in their order, preferring those with alerts."""
    ranked = sorted(range(len(rows)), key=lambda i: (_MOST_SEVERE_FIRST.index(rows[i].severity), i))
    # One line less, for the number of omitted rows.
    return rows if len(rows) <= count else [rows[i] for i in sorted(ranked[: count - 1])]
