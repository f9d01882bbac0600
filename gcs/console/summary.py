"""Terminal output of a result: how the flight ended, verdicts with their measurements, and a table of the vehicles."""

from collections.abc import Sequence

from rich.console import Group, JustifyMethod, RenderableType
from rich.table import Table
from rich.text import Text

from gcs.console.table_view import TACTIC_STYLES, number
from gcs.metrics.ending import FlightEnding
from gcs.metrics.engagement import engaged_line
from gcs.metrics.result import (
    EstimatedVehicleResult,
    EstimateResult,
    FlightResult,
    VehicleResult,
    reference_line,
    window_line,
)
from gcs.metrics.reynolds import reynolds_grid

VERDICT_SIGNS = {True: ("✓", "bold green"), False: ("✗", "bold red"), None: ("–", "dim")}
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


def summary(result: FlightResult) -> RenderableType:
    """Return a flight's result for a terminal: how it ended, verdicts with measurements, a table of the vehicles."""
    flocking = reynolds_grid(result.reynolds)
    return Group(
        *(() if result.ended is None else (_ending(result.ended),)),
        _headline(result),
        _verdict_table(result),
        *((Text(line, style="dim"),) if (line := window_line(result)) else ()),
        Text(),
        _vehicle_table(result),
        *(() if result.estimate is None else (_estimate_line(result.estimate),)),
        *(() if flocking is None else (Text(), flocking, Text())),
        _loop_line(result),
    )


def _ending(ended: FlightEnding) -> Text:
    """Return how the flight ended, with the reason below unless the mission was completed."""
    if not ended.is_early:
        return Text(ended.headline, style="bold green")
    return Text.assemble((f"✗ {ended.headline}", "bold red"), f"\n{ended.reason}")


def _headline(result: FlightResult) -> Text:
    took = f" in {result.wall_time_line}" if result.wall_time_line else ""
    source = f"  {result.source}, seed {result.seed}, {result.duration_s:g} s{took}"
    reference = f"\n{reference_line(result)}"
    practice = f"\npractice: {', '.join(result.faults)}" if result.faults else ""
    kinds = f"\n{result.kinds_line}" if len({*result.kinds.values()}) > 1 or result.source == "bench" else ""
    return Text.assemble(
        (result.mission, "bold"), (source, "dim"), (kinds, "yellow"), (reference, "dim"), (practice, "yellow")
    )


def _verdict_table(result: FlightResult) -> Table:
    meanings = {
        "C1": ("radius", _worst("error {} m rms", [v.radius_error_rms_m for v in result.vehicles])),
        "C2": ("angular rate", _rates("mean", result.vehicles)),
        "C3": ("spacing", _spacing(result)),
        "formation": ("", _formation(result)),
        "separation": ("", _worst("closest approach {} m", [result.closest_approach_m])),
        "engaged": ("", engaged_line(result.engagement)),
    }
    table = Table.grid(padding=(0, 2))
    for name, holds in result.verdicts.named().items():
        sign, style = VERDICT_SIGNS[holds]
        meaning, evidence = meanings[name]
        table.add_row(Text(sign, style=style), Text(f"{name} {meaning}".strip()), Text(evidence, style="dim"))
    return table


def _rates(noun: str, vehicles: Sequence[VehicleResult | EstimatedVehicleResult]) -> str:
    means = [v.angular_rate_mean_rad_s for v in vehicles if v.angular_rate_mean_rad_s is not None]
    if not means:
        return ""
    low, high = f"{min(means):.4f}", f"{max(means):.4f}"
    return f"{noun} {low} rad/s" if low == high else f"{noun}s {low} to {high} rad/s"


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
    """Return the worst figures from the vehicles' estimates, beside those from the true positions."""
    spacing = estimate.ring.spacing_error_rms_deg
    parts = [
        _worst("radius error {} m rms", [v.radius_error_rms_m for v in estimate.vehicles]),
        _rates("rate", estimate.vehicles),
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
