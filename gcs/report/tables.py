"""The tables of a report."""

from collections.abc import Sequence

import numpy as np

from estimation.state import Vector
from gcs.console.table_view import number
from gcs.metrics.catalogue import FLIGHT, FLOCKING, VEHICLE
from gcs.metrics.record import FlightEvent
from gcs.metrics.result import FlightResult
from gcs.metrics.reynolds import phases
from gcs.report.charts.onboard import intervals_ms
from gcs.report.evidence.estimate_errors import SIGMAS, EstimateError, consistency
from gcs.report.evidence.flight import FlightEvidence, Reception, VehicleEvidence
from gcs.report.evidence.lyapunov import DECAYED_SHARE, Decay
from gcs.report.page_parts import Table

_FOLDED_ROWS = 12


def vehicle_table(result: FlightResult) -> Table:
    """Return the metrics of every vehicle."""
    shown = [metric for metric in VEHICLE if metric.label]
    columns = ("vehicle", "final tactic", *(metric.heading for metric in shown))
    rows = tuple((str(v.id), v.tactic, *(metric.text(v) for metric in shown)) for v in result.vehicles)
    return Table("Metrics of every vehicle", columns, rows, words=2)


def ring_table(result: FlightResult) -> Table:
    """Return the metrics on a ring of the vehicles that were on it."""
    shown = [metric for metric in VEHICLE if metric.label and not metric.name.startswith("formation")]
    rows = tuple((str(v.id), *(metric.text(v) for metric in shown)) for v in result.vehicles)
    return Table("Metrics on this ring", ("vehicle", *(metric.heading for metric in shown)), rows)


def team_table(result: FlightResult) -> Table:
    """Return the metrics of the team."""
    rows = (
        *((metric.heading, metric.text(result)) for metric in FLIGHT if metric.label),
        (
            "window of the ring metrics [s]",
            "–" if result.window_s is None else "{:g} to {:g}".format(*result.window_s),
        ),
        ("ticks", str(result.loop.ticks)),
        ("wall time [s]", number(result.wall_time_s, ".1f")),
    )
    return Table("Metrics of the team", ("metric", "value"), rows)


def event_table(events: Sequence[FlightEvent]) -> Table:
    """Return all events, in order."""
    rows = tuple((f"{event.time_s:.1f}", str(event.vehicle), event.kind, event.text) for event in events)
    caption = f"Events ({len(rows)})"
    return Table(caption, ("time [s]", "vehicle", "kind", "event"), rows, words=4, folded=True)


def reynolds_table(result: FlightResult) -> Table:
    """Return Reynolds' flocking metrics in formation, on the ring, and over the whole flight."""
    rows = tuple((name, *(each.text(figures) for each in FLOCKING)) for name, figures in phases(result.reynolds))
    return Table("Flocking metrics", ("phase", *(each.heading for each in FLOCKING)), rows)


def decay_table(periods: Sequence[Decay]) -> Table:
    """Return the decay of V after every change of the ring."""
    rows = tuple(
        (
            f"{each.start_s:.1f}",
            str(each.members),
            f"{each.start_rad2:.3g}",
            number(each.decayed_after_s, ".1f"),
            number(each.expected_after_s, ".1f"),
        )
        for each in periods
    )
    share = f"{DECAYED_SHARE:.0%}"
    columns = ("from [s]", "members", "initial V [rad²]", f"below {share} after [s]", "expected [s]")
    return Table("Decay of V after every change of the ring", columns, rows)


def error_table(caption: str, errors: Sequence[EstimateError], evidence: FlightEvidence) -> Table:
    """Return the size of the errors, their share within the vehicle's own 3σ bounds, and their mean NEES."""
    rows = []
    for error in errors:
        known = np.isfinite(error.error_m).all(axis=1)
        length_m = np.hypot(*error.error_m[known].T)
        vehicle_id = str(evidence.vehicles[error.row].vehicle_id)
        found = consistency(error)
        if found is None:
            rows.append((vehicle_id, *["–"] * 5))
            continue
        rows.append(
            (
                vehicle_id,
                f"{np.sqrt(np.mean(length_m**2)):.3f}",
                f"{length_m.max():.3f}",
                f"{SIGMAS * error.sigma_m[known].mean():.3f}",
                f"{found.within:.1%}",
                f"{found.nees:.2f}",
            )
        )
    columns = ("vehicle", "rms [m]", "max [m]", "mean 3σ [m]", "within 3σ", "NEES")
    return Table(caption, columns, tuple(rows))


def loop_table(evidence: FlightEvidence) -> Table:
    """Return the timing of every control loop, and counts of its plans and guard interventions."""
    rows = []
    for vehicle in evidence.vehicles:
        loop = vehicle.loop
        if not loop.time_s.size:
            rows.append((str(vehicle.vehicle_id), *["–"] * 10))
            continue
        p50_us, p99_us, most_us = np.percentile(loop.tick_us, (50, 99, 100))
        rows.append(
            (
                str(vehicle.vehicle_id),
                str(loop.time_s.size),
                str(round(float(loop.skipped.sum()))),
                *(f"{value:.0f}" for value in (p50_us, p99_us, most_us)),
                *(str(int((loop.qp == name).sum())) for name in ("bounded", "fallback")),
                *(str(int((loop.guard == name).sum())) for name in ("changed", "yielded", "braked")),
            )
        )
    columns = (
        "vehicle",
        "ticks",
        "missed",
        "median [µs]",
        "99 % [µs]",
        "max [µs]",
        "bounded plans",
        "fallback plans",
        "guard: changed",
        "yielded",
        "braked",
    )
    return Table("Control loops", columns, tuple(rows))


def value_table(evidence: FlightEvidence) -> Table:
    """Return the range, mean and last of each value of a user's planner."""
    rows = []
    for vehicle in evidence.vehicles:
        for name, values in sorted(vehicle.loop.values.items()):
            known = values[np.isfinite(values)]
            figures = (known.min(), known.mean(), known.max(), known[-1])
            rows.append((str(vehicle.vehicle_id), name, *(f"{each:.4g}" for each in figures)))
    return Table("Values of the planner", ("vehicle", "value", "least", "mean", "most", "last"), tuple(rows))


def link_table(evidence: FlightEvidence) -> Table:
    """Return the reception of telemetry and of peers' messages by every vehicle."""
    rows = []
    for vehicle in evidence.vehicles:
        received = [("own\u00a0autopilot", vehicle.telemetry)]
        received += [(f"vehicle\u00a0{sender}", reception) for sender, reception in sorted(vehicle.peers.items())]
        rows += [
            _reception_row(vehicle, source, reception, evidence.speed)
            for source, reception in received
            if reception.received_s.size
        ]
    columns = (
        "receiver",
        "sender",
        "messages",
        "median interval [ms]",
        "longest gap [ms]",
        "median age [ms]",
        "99 % age [ms]",
        "max age [ms]",
    )
    return Table("Reception", columns, tuple(rows), words=2, folded=len(rows) > _FOLDED_ROWS)


def _reception_row(vehicle: VehicleEvidence, source: str, reception: Reception, speed: float) -> tuple[str, ...]:
    _, interval_ms = intervals_ms(reception, speed)
    ages_ms = 1e3 * reception.age_s[np.isfinite(reception.age_s)]
    return (
        f"vehicle\u00a0{vehicle.vehicle_id}",
        source,
        str(reception.received_s.size),
        *_percentiles(interval_ms, (50, 100)),
        *_percentiles(ages_ms, (50, 99, 100)),
    )


def _percentiles(values: Vector, shares: tuple[int, ...]) -> list[str]:
    return [f"{value:.0f}" for value in np.percentile(values, shares)] if values.size else ["–"] * len(shares)
