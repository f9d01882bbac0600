"""Comparison of two flights: every metric with its difference, the verdicts, and charts of the errors."""

from collections.abc import Callable
from dataclasses import astuple, dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from rich.table import Table as TerminalTable
from rich.text import Text

from estimation.state import Vector
from gcs.console.live import number
from gcs.console.summary import VERDICT_SIGNS
from gcs.metrics.record import FlightRecord
from gcs.metrics.result import FlightResult, ReynoldsResult, RingReference, VehicleResult
from gcs.metrics.reynolds_view import FLOCKING_FORMS, FLOCKING_LABELS
from gcs.metrics.ring_motion import RingMotion, ring_motion
from gcs.report.charts.chart import Chart, chart, logarithmic, over_time
from gcs.report.charts.panels import mark_empty, title
from gcs.report.charts.thinning import thinned
from gcs.report.evidence.lyapunov import lyapunov_rad2
from gcs.report.page import KeyLine, render
from gcs.report.page_parts import Section, Table, VerdictEntry

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 1200
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#0077BB", "linewidth": 1.4, "linestyle": "-"},
    {"color": "#CC3311", "linewidth": 1.4, "linestyle": (0, (4, 1.5))},
)
_DASHES = ("", "8 3")
_FLOORS = {"m": 1e-4, "°": 1e-3, "rad²": 1e-7}

Better = Literal["less", "more", "neither"]


@dataclass(frozen=True, slots=True)
class ComparedFlight:
    """One of two flights: its name (unique), its result, and its record and ring for the charts."""

    name: str
    result: FlightResult
    record: FlightRecord
    ring: RingReference


@dataclass(frozen=True, slots=True)
class Comparison:
    """A metric of both flights as text, the difference, and the name of the better flight, empty if neither."""

    metric: str
    first: str
    second: str
    difference: str
    better: str


@dataclass(frozen=True, slots=True)
class _Metric:
    label: str
    form: str
    better: Better
    of: Callable[[FlightResult], float | None]


def _of_phase(phase: str, figure: int) -> Callable[[FlightResult], float | None]:
    return lambda result: astuple(getattr(result.reynolds, phase))[figure]


def _of_vehicle(vehicle_id: int, of: Callable[[VehicleResult], float | None]) -> Callable[[FlightResult], float | None]:
    return lambda result: next((of(vehicle) for vehicle in result.vehicles if vehicle.id == vehicle_id), None)


_TEAM = (
    _Metric("duration [s]", ".1f", "neither", lambda r: r.duration_s),
    _Metric("settling time [s]", ".1f", "less", lambda r: r.ring.settling_time_s),
    _Metric("spacing error rms [°]", ".2f", "less", lambda r: r.ring.spacing_error_rms_deg),
    _Metric("spacing error max [°]", ".2f", "less", lambda r: r.ring.spacing_error_max_deg),
    _Metric("closest approach [m]", ".3f", "more", lambda r: r.closest_approach_m),
    _Metric("setpoints moved by the guard", ".0f", "neither", lambda r: r.guard_interventions),
    _Metric("missed ticks", ".0f", "less", lambda r: r.loop.missed),
    _Metric("computing time, median [µs]", ".0f", "less", lambda r: r.loop.tick_p50_us),
    _Metric("computing time, 99 % [µs]", ".0f", "less", lambda r: r.loop.tick_p99_us),
    _Metric("real-time factor", ".3g", "neither", lambda r: r.realtime_factor),
)
# Which value is better depends on the mission: a wide ring is not worse than a narrow one.
_REYNOLDS = tuple(
    _Metric(f"{phase.name}: {label}", form, "neither", _of_phase(phase.name, index))
    for phase in fields(ReynoldsResult)
    for index, (label, form) in enumerate(zip(FLOCKING_LABELS, FLOCKING_FORMS, strict=True))
)
_VEHICLE: tuple[tuple[str, str, Better, Callable[[VehicleResult], float | None]], ...] = (
    ("engaged [s]", ".1f", "neither", lambda v: v.engaged_at_s),
    ("radius error rms [m]", ".3f", "less", lambda v: v.radius_error_rms_m),
    ("radius error max [m]", ".3f", "less", lambda v: v.radius_error_max_m),
    ("mean rate [rad/s]", "+.4f", "neither", lambda v: v.angular_rate_mean_rad_s),
    ("rate error rms [rad/s]", ".4f", "less", lambda v: v.angular_rate_error_rms_rad_s),
    ("formation speed error rms [m/s]", ".3f", "less", lambda v: v.formation_speed_error_rms_m_s),
    ("formation spacing error rms [m]", ".3f", "less", lambda v: v.formation_spacing_error_rms_m),
)


def comparisons(first: ComparedFlight, second: ComparedFlight) -> tuple[Comparison, ...]:
    """Return every metric that at least one flight has; the better flight is named where the rounded values differ."""
    vehicles = (vehicle.id for flight in (first, second) for vehicle in flight.result.vehicles)
    of_vehicles = (
        _Metric(f"vehicle {vehicle_id}: {label}", form, better, _of_vehicle(vehicle_id, of))
        for vehicle_id in dict.fromkeys(vehicles)
        for label, form, better, of in _VEHICLE
    )
    compared = (_compared(metric, first, second) for metric in (*_TEAM, *_REYNOLDS, *of_vehicles))
    return tuple(each for each in compared if each is not None)


def _compared(metric: _Metric, first: ComparedFlight, second: ComparedFlight) -> Comparison | None:
    here, there = metric.of(first.result), metric.of(second.result)
    shown = number(here, metric.form), number(there, metric.form)
    if here is None and there is None:
        return None
    if here is None or there is None:
        return Comparison(metric.label, *shown, "–", "")
    # Computed from the rounded values, so that the table is consistent.
    more = float(shown[1]) - float(shown[0])
    if not more:
        return Comparison(metric.label, *shown, "0", "")
    better = ""
    if metric.better != "neither":
        better = first.name if (more > 0.0) == (metric.better == "less") else second.name
    return Comparison(metric.label, *shown, f"{more:+{metric.form.removeprefix('+')}}", better)


def comparison_table(first: ComparedFlight, second: ComparedFlight) -> TerminalTable:
    """Return both flights' verdicts and metrics as a table for a terminal."""
    table = TerminalTable(box=None, pad_edge=False, header_style="bold")
    names = ("", first.name, second.name, f"{second.name} − {first.name}", "better")
    for index, name in enumerate(names):
        table.add_column(Text(name), justify="right" if 0 < index < 4 else "left")
    if first.result.ended or second.result.ended:
        table.add_row(Text("ended", style="bold"), *(_ending(each.result) for each in (first, second)))
    for name, holds in first.result.verdicts.named().items():
        marks = (VERDICT_SIGNS[each] for each in (holds, second.result.verdicts.named()[name]))
        table.add_row(Text(name, style="bold"), *(Text(sign, style=style) for sign, style in marks))
    for each in comparisons(first, second):
        better = Text(each.better, style="green")
        table.add_row(*map(Text, (each.metric, each.first, each.second, each.difference)), better)
    return table


def _ending(result: FlightResult) -> Text:
    """Return how a flight ended, in a word."""
    style = "bold red" if result.ended_early else "green"
    return Text("–") if result.ended is None else Text(result.ended.how.value, style=style)


def write_comparison(first: ComparedFlight, second: ComparedFlight, path: Path) -> None:
    """Write two flights side by side to a file of HTML; raises OSError when it cannot be written."""
    path.write_text(comparison_html(first, second), encoding="utf-8")


def comparison_html(first: ComparedFlight, second: ComparedFlight) -> str:
    """Return two flights side by side as a page of HTML."""
    flights = (first, second)
    rows = tuple((c.metric, c.first, c.second, c.difference, c.better) for c in comparisons(first, second))
    columns = ("metric", first.name, second.name, "second − first", "better")
    return render(
        "compare.html.j2",
        flights=flights,
        key=tuple(
            KeyLine(flight.name, str(style["color"]), dashes)
            for flight, style, dashes in zip(flights, _STYLES, _DASHES, strict=True)
        ),
        verdicts=tuple(
            tuple(VerdictEntry(name, "", flight.result.verdicts.named()[name], ()) for flight in flights)
            for name in first.result.verdicts.named()
        ),
        section=Section("errors", "Over time", _LEAD, _charts(flights), missing=()),
        metrics=Table("All metrics", columns, rows),
    )


_LEAD = (
    "The largest error of any vehicle on the ring and the Lyapunov function of the spacings, on logarithmic scales "
    "over the time since the start of each mission."
)


def _charts(flights: tuple[ComparedFlight, ComparedFlight]) -> tuple[Chart, ...]:
    motions = tuple(ring_motion(flight.record) for flight in flights)
    radius_m = tuple(
        _largest(motion.radius_m - flight.ring.radius_m) for flight, motion in zip(flights, motions, strict=True)
    )
    spacing_deg = tuple(_largest(_spacing_deg(motion)) for motion in motions)
    value_rad2 = tuple(lyapunov_rad2(motion) for motion in motions)
    drawn = (
        ("radius", "Largest radius error", "m", radius_m),
        ("spacing", "Largest spacing error", "°", spacing_deg),
        ("lyapunov", "Lyapunov function", "rad²", value_rad2),
    )
    return tuple(
        chart(
            f"compared-{name}",
            partial(_draw, flights=flights, values=values, heading=heading, unit=unit),
            f"{heading} of both flights over time.",
        )
        for name, heading, unit, values in drawn
    )


def _draw(
    axes: "Axes", flights: tuple[ComparedFlight, ComparedFlight], values: tuple[Vector, ...], heading: str, unit: str
) -> None:
    title(axes, heading, "")
    known = [np.isfinite(each) for each in values]
    if not any(mask.any() for mask in known):
        mark_empty(axes, "not measured in either flight")
        return
    time_s = np.sort(np.concatenate([f.record.time_s[mask] for f, mask in zip(flights, known, strict=True)]))
    over_time(axes, f"{'V' if unit == 'rad²' else 'error'} [{unit}]", time_s)
    logarithmic(axes, np.concatenate(values), _FLOORS[unit])
    for flight, each, style in zip(flights, values, _STYLES, strict=True):
        axes.plot(*thinned(flight.record.time_s, np.maximum(each, 0.1 * _FLOORS[unit]), _POINTS), **style)


def _spacing_deg(motion: RingMotion) -> Vector:
    return np.degrees(motion.lead_rad - motion.desired_spacing_rad)


def _largest(error: Vector) -> Vector:
    """Return the largest of the errors (V, T) at each time, NaN where there is none."""
    largest = np.fmax.reduce(np.abs(error), axis=0, initial=-np.inf)
    return np.where(largest >= 0.0, largest, np.nan)
