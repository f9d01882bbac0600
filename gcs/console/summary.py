"""A result as terminal output - ending, verdicts with measurements, a table of the vehicles - and as an exit code."""

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gcs.console.table_view import TACTIC_STYLES
from gcs.console.terminal import STDERR
from gcs.errors import Exit
from gcs.metrics.catalogue import FLOCKING, OF_THE_RING, VEHICLE, VERDICTS, Criterion, Metric, VerdictState, evidence
from gcs.metrics.departures import departures_line
from gcs.metrics.ending import TeamEnding, named
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import engaged_line
from gcs.metrics.result import (
    EstimateResult,
    FlightResult,
    NamedRing,
    is_briefly_judged,
    reference_line,
    settled_line,
    verdict_states,
    window_line,
)
from gcs.metrics.reynolds import ReynoldsResult, phases
from gcs.mission.mission import Mission

VERDICT_STYLES = {
    VerdictState.PASSES: "bold green",
    VerdictState.FAILS: "bold red",
    VerdictState.NOT_JUDGED: "bold yellow",
    VerdictState.NOT_ASKED: "dim",
}


def show_result(mission: Mission, record: FlightRecord) -> FlightResult:
    """Evaluate a flight against its mission and print the summary."""
    result = evaluated(mission, record)
    STDERR.print(summary(result))
    return result


def verdict_of(result: FlightResult) -> Exit:
    """Return the exit code of a flight: its ending takes precedence over its verdicts."""
    if result.ended_early:
        return Exit.ENDED_IN_FLIGHT
    return Exit.HOLDS if result.all_hold else Exit.VERDICT_FAILED


def summary(result: FlightResult) -> RenderableType:
    """Return a flight's result for a terminal: how it ended, verdicts with measurements, a table of the vehicles."""
    flocking = _reynolds_grid(result.reynolds)
    return Group(
        *(() if result.ended is None else (_ending(result.ended),)),
        _headline(result),
        _verdict_table(result),
        *_window_lines(result),
        Text(),
        _vehicle_table(result),
        *(() if result.estimate is None else (_estimate_line(result.estimate),)),
        *(() if flocking is None else (Text(), flocking, Text())),
        _loop_line(result),
    )


def _window_lines(result: FlightResult) -> list[Text]:
    """Return over which part of the flight each ring was judged, several by their names; none without a ring."""
    lines = [("", result)] if not result.rings else [(_name_line(each), each.result) for each in result.rings]
    return [
        Text(f"{name}{window_line(each)}", style="yellow" if is_briefly_judged(each.ring) else "dim")
        for name, each in lines
        if name or window_line(each)
    ]


def _name_line(ring: NamedRing) -> str:
    """Return the name of one of several rings, its target and the vehicles that were on it."""
    ids = [vehicle.id for vehicle in ring.result.vehicles]
    return f"{ring.name}{ring.about}: {f'{named(ids)}; ' if ids else 'no vehicle was on it'}"


def _ending(ended: TeamEnding) -> Text:
    """Return how the flight ended, with the reason below unless the mission was completed and all are down."""
    if not ended.is_early:
        aloft = f"\n{ended.reason}" if ended.still_flying else ""
        return Text.assemble((ended.headline, "bold green"), (aloft, "yellow"))
    lost = [(f"✗ {each.line}\n", "bold red") for each in ended.unaccounted]
    return Text.assemble(*lost, (f"✗ {ended.headline}", "bold red"), f"\n{ended.reason}")


def _headline(result: FlightResult) -> Text:
    took = f" in {result.wall_time_line}" if result.wall_time_line else ""
    source = f"  {result.source}, seed {result.seed}, {result.duration_s:g} s{took}"
    reference = f"\n{reference_line(result)}"
    faults = f"\ninjected: {', '.join(result.faults)}" if result.faults else ""
    kinds = f"\n{result.kinds_line}" if len({*result.kinds.values()}) > 1 or result.source == "bench" else ""
    return Text.assemble(
        (result.mission, "bold"), (source, "dim"), (kinds, "yellow"), (reference, "dim"), (faults, "yellow")
    )


def _verdict_table(result: FlightResult) -> Table:
    beside = {
        "C3": "" if result.rings else _settled(result),
        "engaged": engaged_line(result.engagement),
        "kept": departures_line(result.departures),
    }
    states = verdict_states(result)
    table = Table.grid(padding=(0, 2))
    for verdict in VERDICTS:
        state = states[verdict.name]
        open_text = state.value if state is VerdictState.NOT_JUDGED else ""
        by_ring = result.rings if verdict.name in OF_THE_RING else ()
        measured = "; ".join(_ring_text(verdict.name, each) for each in by_ring) or _evidence(verdict.name, result)
        text = "; ".join(filter(None, (open_text, measured, beside.get(verdict.name))))
        table.add_row(Text(state.sign, style=VERDICT_STYLES[state]), Text(verdict.title), Text(text, style="dim"))
    return table


def _settled(result: FlightResult) -> str:
    return settled_line(result) or ("did not settle" if result.window_s is not None else "")


def _evidence(verdict: str, result: FlightResult) -> str:
    return ", ".join(_worst_text(*each) for each in evidence(verdict, result))


def _ring_text(verdict: str, ring: NamedRing) -> str:
    """Return what a verdict judges on one of several rings, and whether it fails there."""
    held = {True: "", None: "not judged" if verdict in ring.not_judged else "", False: "fails"}[ring.verdict(verdict)]
    settled = _settled(ring.result) if verdict == "C3" else ""
    return f"{ring.name} {', '.join(filter(None, (held, _evidence(verdict, ring.result), settled))) or '–'}"


def _worst_text(metric: Metric, judged: Criterion, values: Sequence[float]) -> str:
    """Return the worst value in words; of values that are no errors, their range."""
    if judged.desired:
        return _range(judged.noun, values, metric.form.removeprefix("+"), metric.spaced_unit)
    worst = metric.amount(min(values) if metric.worst == "min" else max(values))
    return " ".join(filter(None, (judged.subject, judged.noun, worst, judged.kind)))


def _range(noun: str, values: Sequence[float], form: str, unit: str) -> str:
    low, high = format(min(values), form), format(max(values), form)
    return f"{noun} {low}{unit}" if low == high else f"{noun}s {low} to {high}{unit}"


def _worst(sentence: str, values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return sentence.format(f"{max(known):.3f}") if known else ""


def _vehicle_table(result: FlightResult) -> Table:
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    shown = [metric for metric in VEHICLE if metric.label]
    table.add_column(justify="right", no_wrap=True)
    table.add_column(Text("final\ntactic"), no_wrap=True)
    for metric in shown:
        table.add_column(Text(metric.narrow), justify="right", no_wrap=True)
    for vehicle in result.vehicles:
        tactic = Text(vehicle.tactic, style=TACTIC_STYLES.get(vehicle.tactic, ""))
        table.add_row(Text(str(vehicle.id), style="bold"), tactic, *(Text(metric.text(vehicle)) for metric in shown))
    return table


def _reynolds_grid(result: ReynoldsResult) -> Table | None:
    """Return the metrics as a table of at most 80 columns, None for a single vehicle."""
    measured = phases(result)
    if not measured:
        return None
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    table.add_column(Text("Reynolds'\nrules"), no_wrap=True)
    for metric in FLOCKING:
        table.add_column(Text(metric.narrow), justify="right", no_wrap=True)
    for name, figures in measured:
        table.add_row(Text(name), *(Text(metric.text(figures)) for metric in FLOCKING))
    return table


def _estimate_line(estimate: EstimateResult) -> Text:
    """Return the worst figures from the vehicles' estimates, beside those from the true positions."""
    spacing = estimate.ring.spacing_error_rms_deg
    rates_rad_s = [v.angular_rate_mean_rad_s for v in estimate.vehicles if v.angular_rate_mean_rad_s is not None]
    parts = [
        _worst("radius error {} m rms", [v.radius_error_rms_m for v in estimate.vehicles]),
        _range("rate", rates_rad_s, ".4f", " rad/s") if rates_rad_s else "",
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
