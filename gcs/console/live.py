"""Terminal output of a flight: the live table of the team, and the summary of the result."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Self, TypeVar

from rich.console import Console, Group, JustifyMethod, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from gcs.console.printable import Printable, printable_lines
from gcs.metrics.result import EstimateResult, FlightResult, VehicleResult, reference_line
from gcs.metrics.reynolds_view import reynolds_grid

RowT = TypeVar("RowT")

PLAIN_INTERVAL_S = 30.0
REFRESH_HZ = 4.0
BATTERY_LOW, BATTERY_CRITICAL = 0.35, 0.2
TACTIC_STYLES = {"formation": "cyan", "encircle": "magenta", "excite": "blue", "unknown": "dim"}
MODE_STYLES = {"offboard": "green", "hold": "yellow", "land": "yellow", "return": "yellow", "unknown": "dim"}
VERDICT_SIGNS = {True: ("✓", "bold green"), False: ("✗", "bold red"), None: ("–", "dim")}
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
VEHICLE_COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("", "right"),
    ("final\ntactic", "left"),
    ("engaged\n[s]", "right"),
    ("radius\nrms [m]", "right"),
    ("radius\nmax [m]", "right"),
    ("mean rate\n[rad/s]", "right"),
    ("rate rms\n[rad/s]", "right"),
    ("speed rms\n[m/s]", "right"),
    ("spacing\nrms [m]", "right"),
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
        self._shown: tuple[Sequence[RowT], float, str, str] = ((), 0.0, "", "")
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

    def update(self, rows: Sequence[RowT], mission_time_s: float, message: str = "", hint: str = "") -> None:
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
        return Printable(Group(table, Text(hint, style="dim")) if hint else Group(table))


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


def summary(result: FlightResult) -> RenderableType:
    """Return a flight's result for a terminal: verdicts with their measurements, and a table of the vehicles."""
    flocking = reynolds_grid(result.reynolds)
    return Group(
        _headline(result),
        _verdict_table(result),
        Text(),
        _vehicle_table(result),
        *(() if result.estimate is None else (_estimate_line(result.estimate),)),
        *(() if flocking is None else (Text(), flocking, Text())),
        _loop_line(result),
    )


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


def _headline(result: FlightResult) -> Text:
    factor = "" if result.realtime_factor is None else f" ({result.realtime_factor:.3g}× real time)"
    took = "" if result.wall_time_s is None else f" in {result.wall_time_s:.1f} s{factor}"
    source = f"  {result.source}, seed {result.seed}, {result.duration_s:g} s{took}"
    reference = f"\n{reference_line(result)}"
    return Text.assemble((result.mission, "bold"), (source, "dim"), (reference, "dim"))


def _verdict_table(result: FlightResult) -> Table:
    meanings = {
        "C1": ("radius", _worst("error {} m rms", [v.radius_error_rms_m for v in result.vehicles])),
        "C2": ("angular rate", _rates(result)),
        "C3": ("spacing", _spacing(result)),
        "formation": ("", _formation(result)),
        "separation": ("", _worst("closest approach {} m", [result.closest_approach_m])),
    }
    table = Table.grid(padding=(0, 2))
    for name, holds in result.verdicts.named().items():
        sign, style = VERDICT_SIGNS[holds]
        meaning, evidence = meanings[name]
        table.add_row(Text(sign, style=style), Text(f"{name} {meaning}".strip()), Text(evidence, style="dim"))
    return table


def _rates(result: FlightResult) -> str:
    means = [v.angular_rate_mean_rad_s for v in result.vehicles if v.angular_rate_mean_rad_s is not None]
    if not means:
        return ""
    low, high = f"{min(means):.4f}", f"{max(means):.4f}"
    return f"mean {low} rad/s" if low == high else f"means {low} to {high} rad/s"


def _spacing(result: FlightResult) -> str:
    ring = result.ring
    parts = []
    if ring.spacing_error_rms_deg is not None and ring.spacing_error_max_deg is not None:
        parts.append(f"error {ring.spacing_error_rms_deg:.2f}° rms, {ring.spacing_error_max_deg:.2f}° max")
    if ring.settling_time_s is not None:
        parts.append(f"settled after {ring.settling_time_s:.1f} s")
    elif result.window_s is not None:
        parts.append("did not settle")
    return "; ".join(parts)


def _formation(result: FlightResult) -> str:
    speed = _worst("speed error {} m/s rms", [v.formation_speed_error_rms_m_s for v in result.vehicles])
    spacing = _worst("spacing error {} m rms", [v.formation_spacing_error_rms_m for v in result.vehicles])
    return ", ".join(filter(None, [speed, spacing]))


def _worst(sentence: str, values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return sentence.format(f"{max(known):.3f}") if known else ""


def _vehicle_table(result: FlightResult) -> Table:
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    for name, justify in VEHICLE_COLUMNS:
        table.add_column(Text(name), justify=justify, no_wrap=True)
    for vehicle in result.vehicles:
        table.add_row(*_vehicle_cells(vehicle))
    return table


def _vehicle_cells(vehicle: VehicleResult) -> tuple[Text, ...]:
    return (
        Text(str(vehicle.id), style="bold"),
        Text(vehicle.tactic, style=TACTIC_STYLES.get(vehicle.tactic, "")),
        Text(number(vehicle.engaged_at_s, ".1f")),
        Text(number(vehicle.radius_error_rms_m, ".3f")),
        Text(number(vehicle.radius_error_max_m, ".3f")),
        Text(number(vehicle.angular_rate_mean_rad_s, "+.4f")),
        Text(number(vehicle.angular_rate_error_rms_rad_s, ".4f")),
        Text(number(vehicle.formation_speed_error_rms_m_s, ".3f")),
        Text(number(vehicle.formation_spacing_error_rms_m, ".3f")),
    )


def _estimate_line(estimate: EstimateResult) -> Text:
    """Return the worst figures by the vehicles' estimates, beside those by truth."""
    rates = [v.angular_rate_mean_rad_s for v in estimate.vehicles if v.angular_rate_mean_rad_s is not None]
    spacing = estimate.ring.spacing_error_rms_deg
    parts = [
        _worst("radius error {} m rms", [v.radius_error_rms_m for v in estimate.vehicles]),
        f"rates {min(rates):.4f} to {max(rates):.4f} rad/s" if rates else "",
        "" if spacing is None else f"spacing error {spacing:.2f}° rms",
        _worst("closest approach {} m", [estimate.closest_approach_m]),
        _worst("estimated positions {} m rms off", [v.estimate_error_rms_m for v in estimate.vehicles]),
    ]
    return Text(f"by the vehicles' estimates: {', '.join(filter(None, parts))}")


def _loop_line(result: FlightResult) -> Text:
    loop = result.loop
    parts = [f"{loop.rate_hz:g} Hz, {loop.ticks} ticks, {loop.missed} missed"]
    if loop.tick_p50_us is not None and loop.tick_p99_us is not None:
        parts.append(f"a tick took {loop.tick_p50_us:.0f} µs (median), {loop.tick_p99_us:.0f} µs (99 %)")
    if result.guard_interventions is not None:
        causes = ", ".join(f"{cause} {count}" for cause, count in result.guard_causes.items())
        parts.append(f"guard interventions: {result.guard_interventions}" + (f" ({causes})" if causes else ""))
    return Text("; ".join(parts), style="dim")


def number(value: float | None, form: str) -> str:
    """Return a number in a format, a dash for None."""
    return "–" if value is None else format(value, form)
