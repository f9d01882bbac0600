"""Comparison of flights: what differed in their missions, every metric with its spread, the verdicts, and charts."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rich.table import Table as TerminalTable
from rich.text import Text

from estimation.input_file import toml_content
from estimation.state import Vector
from gcs.console.summary import VERDICT_STYLES
from gcs.keys.private_files import create
from gcs.metrics.catalogue import FLIGHT, FLOCKING, PHASES, VEHICLE, Metric, VerdictState
from gcs.metrics.result import FlightResult, verdict_states
from gcs.metrics.vehicles import VehicleResult
from gcs.mission.mission import Mission
from gcs.mission.sections import SECTIONS, TUNED, TUNING
from gcs.report.charts.chart import WIDTH_IN, Chart, chart, logarithmic, over_time
from gcs.report.charts.panels import Sheet, landmarks_m, map_height_in, mark_empty, mark_vehicle, title
from gcs.report.evidence.lyapunov import lyapunov_rad2
from gcs.report.page_parts import Section, Table, VerdictEntry, key_line, render
from gcs.style import ENGAGED, flight_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes


POINTS_MAX = 1200
"""Of a line of one flight."""


@dataclass(frozen=True, slots=True)
class ComparedFlight:
    """One of several flights: its name (unique), its mission, and the data of its charts with its result."""

    name: str
    mission: Mission
    sheet: Sheet

    @property
    def result(self) -> FlightResult:
        """The metrics and verdicts of the flight."""
        return self.sheet.result

    @property
    def engaged_at_s(self) -> float | None:
        """The first tick in which a vehicle's tactic is encircle, None without one: the zero of compared times."""
        times_s = (vehicle.engaged_at_s for vehicle in self.result.vehicles)
        return min((time_s for time_s in times_s if time_s is not None), default=None)


def draw_compared_paths(axes: "Axes", flights: Sequence[ComparedFlight]) -> None:
    """Draw the paths of all flights over each other, a colour for each flight; targets are thin lines."""
    title(axes, "Paths", "")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    for index, flight in enumerate(flights):
        sheet, style = flight.sheet, flight_style(index)
        for target_m in sheet.record.target_paths_m:
            axes.plot(*sheet.path(target_m).T, **style | {"linewidth": 0.7})
        for row, track in enumerate(sheet.record.vehicles):
            axes.plot(*sheet.path(track.position_m).T, alpha=0.8, **style)
            engaged_s = flight.result.vehicles[row].engaged_at_s
            if engaged_s is not None:
                sample = int(np.argmin(np.abs(sheet.record.time_s - engaged_s)))
                axes.plot(*track.position_m[sample], color=style["color"], zorder=6, **ENGAGED)
            mark_vehicle(axes, track, style["color"])


def draw_compared_error(axes: "Axes", flights: Sequence[ComparedFlight], name: str) -> None:
    """Draw one of `ERRORS` of every flight that engaged over the time since it did, on a logarithmic scale."""
    error = ERRORS[name]
    title(axes, error.heading, "")
    lines = [
        (index, flight.sheet.record.time_s - flight.engaged_at_s, error.of(flight.sheet))
        for index, flight in enumerate(flights)
        if flight.engaged_at_s is not None
    ]
    known = [np.isfinite(values) for _, _, values in lines]
    if not any(mask.any() for mask in known):
        mark_empty(axes, "not measured in any flight" if lines else "no vehicle engaged in any flight")
        return
    times_s = [time_s[mask] for (_, time_s, _), mask in zip(lines, known, strict=True)]
    over_time(axes, error.label, np.sort(np.concatenate(times_s)))
    axes.set_xlabel("time since the first engagement [s]")
    logarithmic(axes, np.concatenate([values for _, _, values in lines]), error.floor)
    for index, time_s, values in lines:
        axes.plot(*flights[index].sheet.line(time_s, np.maximum(values, 0.1 * error.floor)), **flight_style(index))


def _largest(error: Vector) -> Vector:
    """Return the largest of the errors (V, T) at each time, NaN where there is none."""
    largest = np.fmax.reduce(np.abs(error), axis=0, initial=-np.inf)
    return np.where(largest >= 0.0, largest, np.nan)


def _of_all_rings(of: Callable[[Sheet], Vector]) -> Callable[[Sheet], Vector]:
    """Return the function that gives the largest of a quantity of all rings of a flight, NaN where there is none."""
    return lambda sheet: np.fmax.reduce([of(each) for each in sheet.each_ring])


class Error(NamedTuple):
    """A quantity over time: its heading, its label with the unit, the lowest value drawn, and its values (T,).

    The values of a flight over several rings are the largest of all.
    """

    heading: str
    label: str
    floor: float
    of: Callable[[Sheet], Vector]


ERRORS = {
    "radius": Error(
        "Largest radius error",
        "error [m]",
        1e-4,
        _of_all_rings(lambda sheet: _largest(sheet.motion.radius_m - sheet.desired_m)),
    ),
    "spacing": Error(
        "Largest spacing error",
        "error [°]",
        1e-3,
        _of_all_rings(lambda sheet: _largest(np.degrees(sheet.motion.lead_rad - sheet.motion.desired_spacing_rad))),
    ),
    "lyapunov": Error("Lyapunov function", "V [rad²]", 1e-7, _of_all_rings(lambda sheet: lyapunov_rad2(sheet.motion))),
}
"""The quantities over time by their names."""


@dataclass(frozen=True, slots=True)
class KeyDifference:
    """A place, such as `encirclement.radius_m`, and the value of each flight there; None where it has none."""

    place: str
    values: tuple[object, ...]

    @property
    def shown(self) -> tuple[str, ...]:
        """The values as text."""
        return tuple(
            "–" if each is None else each if isinstance(each, str) else dumps(each, ensure_ascii=False)
            for each in self.values
        )


def mission_differences(missions: Sequence[Mission]) -> tuple[KeyDifference, ...]:
    """Return the places at which not all missions have the same value, in the order of a mission file.

    Of vehicles that not all missions have the ids are given alone, at `vehicles`.
    """
    common = min(len(mission.vehicles) for mission in missions)
    values = [dict(_placed(mission, common)) for mission in missions]
    places = dict.fromkeys(place for each in values for place in each)
    found = (KeyDifference(place, tuple(each.get(place) for each in values)) for place in places)
    return tuple(each for each in found if any(value != each.values[0] for value in each.values))


def _placed(mission: Mission, vehicles: int) -> Iterator[tuple[str, object]]:
    """Return every value of a mission, its first vehicles and the profiles that it names, with its place."""
    for name in SECTIONS:
        if name != "decision":  # its thresholds are the vehicles'
            yield from _keys(mission, name, name)
    yield from _keys(mission, "target_filter", TUNED["target_filter"][0])
    for name, link in mission.links.items():
        yield from _flat(f"links.{name}", link.model_dump(mode="json"))
    yield "vehicles", list(mission.ids)
    for index, vehicle in enumerate(mission.vehicles[:vehicles]):
        yield from _flat(f"vehicles[{index}]", vehicle.section.model_dump(mode="json"))
    for name, text in mission.profile_texts.items():
        yield from _flat(f"profile {name}", toml_content(text))


def _keys(mission: Mission, name: str, section: str) -> Iterator[tuple[str, object]]:
    """Return the values of a section and of its tuning, each where a mission file has it."""
    tuned = TUNING[name].model_fields if name in TUNING else {}
    for key, value in getattr(mission, name).model_dump(mode="json").items():
        yield from _flat(f"tuning.{name}.{key}" if key in tuned else f"{section}.{key}", value)


def _flat(place: str, value: object) -> Iterator[tuple[str, object]]:
    """Return the values in a table, or in an array of tables, each with its place."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _flat(f"{place}.{key}", each)
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        for index, each in enumerate(value):
            yield from _flat(f"{place}[{index}]", each)
    else:
        yield place, value


@dataclass(frozen=True, slots=True)
class Comparison:
    """A metric of every flight as text, the largest less the smallest, and the names of the best, empty without one."""

    metric: str
    values: tuple[str, ...]
    spread: str
    best: str


def comparisons(flights: Sequence[ComparedFlight]) -> tuple[Comparison, ...]:
    """Return every metric that at least one flight has; the best are named where the rounded values differ."""
    results = [flight.result for flight in flights]
    ids = dict.fromkeys(vehicle.id for result in results for vehicle in result.vehicles)
    parts: list[tuple[str, Sequence[Metric], Sequence[object]]] = [
        ("", FLIGHT, results),
        *((f"{phase}: ", FLOCKING, [getattr(result.reynolds, phase) for result in results]) for phase in PHASES),
        *((f"vehicle {i}: ", VEHICLE, [_vehicle(result, i) for result in results]) for i in ids),
    ]
    names = [flight.name for flight in flights]
    compared = (
        _compared(f"{whose}{metric.heading}", metric, dict(zip(names, of, strict=True)))
        for whose, metrics, of in parts
        for metric in metrics
        if metric.label
    )
    return tuple(each for each in compared if each is not None)


def _vehicle(result: FlightResult, vehicle_id: int) -> VehicleResult | None:
    return next((vehicle for vehicle in result.vehicles if vehicle.id == vehicle_id), None)


def _compared(label: str, metric: Metric, parts: Mapping[str, object]) -> Comparison | None:
    """Return a metric of these parts of the flights, by the flights' names; None if no flight has it."""
    shown = {name: metric.text(part) for name, part in parts.items()}
    # Computed from the rounded values, so that the table is consistent.
    known = {name: float(text) for name, text in shown.items() if metric.of(parts[name]) is not None}
    if not known:
        return None
    least, most = min(known.values()), max(known.values())
    spread, best = f"{most - least:{metric.form.removeprefix('+')}}", ""
    if len(known) == 1:
        spread = "–"
    elif least == most:
        spread = "0"
    elif metric.worst is not None and metric.ranked:
        wanted = least if metric.worst == "max" else most
        best = ", ".join(name for name, value in known.items() if value == wanted)
    return Comparison(label, tuple(shown.values()), spread, best)


def differences(flights: Sequence[ComparedFlight]) -> tuple[KeyDifference, ...]:
    """Return what differed: how the flights were flown, and the values in their missions."""
    results = [flight.result for flight in flights]
    flown = (
        KeyDifference("source", tuple(each.source for each in results)),
        KeyDifference("seed", tuple(each.seed for each in results)),
        KeyDifference("faults", tuple(list(each.faults) for each in results)),
    )
    differing = (each for each in flown if any(value != each.values[0] for value in each.values))
    return (*differing, *mission_differences([flight.mission for flight in flights]))


def remarks(flights: Sequence[ComparedFlight]) -> tuple[str, ...]:
    """Return what keeps the flights from being compared in everything, a sentence each."""
    found = [
        f"{flight.name}: no vehicle engaged: the flight is not in the charts over the time since the engagement."
        for flight in flights
        if flight.engaged_at_s is None
    ]
    teams = [[vehicle.id for vehicle in flight.result.vehicles] for flight in flights]
    if any(team != teams[0] for team in teams):
        known = [", ".join(map(str, team)) or "none" for team in teams]
        named = (f"{flight.name}: {team}" for flight, team in zip(flights, known, strict=True))
        found.append(f"The flights have different vehicles: {'; '.join(named)}.")
    return tuple(found)


def comparison_table(flights: Sequence[ComparedFlight]) -> TerminalTable:
    """Return the flights' verdicts and metrics as a table for a terminal."""
    table = _terminal_table(["", *(flight.name for flight in flights), "spread", "best"], len(flights) + 1)
    if any(flight.result.ended for flight in flights):
        table.add_row(Text("ended", style="bold"), *(_ending(flight.result) for flight in flights))
    for name, states in _states(flights).items():
        table.add_row(Text(name, style="bold"), *(Text(each.sign, style=VERDICT_STYLES[each]) for each in states))
    for each in comparisons(flights):
        table.add_row(*map(Text, (each.metric, *each.values, each.spread)), Text(each.best, style="green"))
    return table


def _states(flights: Sequence[ComparedFlight]) -> dict[str, list[VerdictState]]:
    """Return what each flight shows of each verdict, by the verdict's name."""
    of_each = [verdict_states(flight.result) for flight in flights]
    return {name: [states[name] for states in of_each] for name in of_each[0]}


def difference_table(flights: Sequence[ComparedFlight]) -> TerminalTable:
    """Return what differed in the missions as a table for a terminal."""
    table = _terminal_table(["differs", *(flight.name for flight in flights)], len(flights))
    for each in differences(flights):
        table.add_row(*map(Text, (each.place, *each.shown)))
    return table


def _terminal_table(names: Sequence[str], right: int) -> TerminalTable:
    """Return an empty table with these columns; as many as `right` behind the first are numbers."""
    table = TerminalTable(box=None, pad_edge=False, header_style="bold")
    for index, name in enumerate(names):
        table.add_column(Text(name), justify="right" if 0 < index <= right else "left")
    return table


def _ending(result: FlightResult) -> Text:
    """Return how a flight ended, in a word."""
    style = "bold red" if result.ended_early else "green"
    return Text("–") if result.ended is None else Text(result.ended.how.value, style=style)


def comparison_dict(flights: Sequence[ComparedFlight]) -> dict[str, Any]:
    """Return the flights for JSON: names, results, first engagements, and the values that differ by their places."""
    return {
        "names": [flight.name for flight in flights],
        "flights": [flight.result.to_dict() for flight in flights],
        "engaged_at_s": [flight.engaged_at_s for flight in flights],
        "differences": {each.place: list(each.values) for each in differences(flights)},
    }


def write_comparison(flights: Sequence[ComparedFlight], path: Path) -> None:
    """Write flights side by side to a file of HTML; raises OSError when it cannot be written."""
    with create(path) as file:
        file.write(comparison_html(flights).encode(errors="replace"))  # names of files may hold bytes that are no text


def comparison_html(flights: Sequence[ComparedFlight]) -> str:
    """Return flights side by side as a page of HTML."""
    names = tuple(flight.name for flight in flights)
    metrics = tuple((each.metric, *each.values, each.spread, each.best) for each in comparisons(flights))
    differing = tuple((each.place, *each.shown) for each in differences(flights))
    charts = (_paths(flights), *(_error(flights, name) for name in ERRORS))
    return render(
        "compare.html.j2",
        flights=flights,
        key=tuple(key_line(name, flight_style(index)) for index, name in enumerate(names)),
        differences=Table("Values that differ", ("place", *names), differing, words=1 + len(names)),
        verdicts=tuple(
            tuple(VerdictEntry(name, "", state, ()) for state in states) for name, states in _states(flights).items()
        ),
        section=Section("charts", "Charts", _LEAD, charts, missing=remarks(flights)),
        metrics=Table("All metrics", ("metric", *names, "spread", "best"), metrics),
    )


_LEAD = (
    "The paths of all flights, each in its mission's frame; circles mark engagements. Below, the largest error of any "
    "vehicle on the ring and the Lyapunov function of the spacings, on logarithmic scales: time is 0 when the first "
    "vehicle of each flight engaged."
)


def _paths(flights: Sequence[ComparedFlight]) -> Chart:
    points_m = np.concatenate([landmarks_m(flight.sheet) for flight in flights])
    draw = partial(draw_compared_paths, flights=flights)
    return chart(
        "compared-paths",
        draw,
        "Map of the paths of all flights.",
        map_height_in(points_m, WIDTH_IN),
        is_over_time=False,
    )


def _error(flights: Sequence[ComparedFlight], name: str) -> Chart:
    alt = f"{ERRORS[name].heading} of all flights over the time since the first engagement."
    return chart(f"compared-{name}", partial(draw_compared_error, flights=flights, name=name), alt)
