"""Panels beside the paper's figures: running errors, distances, flocking metrics, the Lyapunov function."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.state import Vector
from gcs.metrics.record import FlightRecord
from gcs.metrics.reynolds import Flocking
from gcs.metrics.vehicles import formation_errors
from gcs.report.charts.chart import levels, logarithmic, over_time
from gcs.report.charts.panels import Sheet, mark_empty, title
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.lyapunov import Decay, lyapunov_rad2
from gcs.style import DASHES, DESIRED, FAIL, INK, WINDOW

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RUNNING_S = 10.0
_FLOOR_SHARE = 1e-3
_FLOOR_RAD2 = 1e-7
_EXPECTED = DESIRED | {"color": "#0077BB"}
_DECAYS_SHOWN = 4
_DECAY_GREYS = ("#000000", "#4D4D4D", "#7F7F7F", "#A6A6A6")


def running_rms(values: Vector, samples: int) -> Vector:
    """Return the root mean square of the last `samples` of each row (V, T), without NaN; NaN where a sample is NaN."""
    known = np.isfinite(values)
    squares = np.cumsum(np.where(known, values, 0.0) ** 2, axis=1)
    count = np.cumsum(known, axis=1)
    squares[:, samples:] -= squares[:, :-samples].copy()
    count[:, samples:] -= count[:, :-samples].copy()
    mean = np.maximum(squares, 0.0) / np.maximum(count, 1)
    return np.where(known & (count > 0), np.sqrt(mean), np.nan)


def draw_radius_error(axes: "Axes", sheet: Sheet, criteria: Criteria) -> None:
    """Draw the running rms error of the radii."""
    title(axes, sheet.titled("Radius error", "radius error"), "")
    error_m = sheet.motion.radius_m - sheet.desired_m
    _draw_error(axes, sheet, "radius error [m]", error_m, criteria.tolerances.radius_error_rms_m)


def draw_rate_error(axes: "Axes", sheet: Sheet, criteria: Criteria) -> None:
    """Draw the running rms error of the angular velocities; verdict C2 uses the error of their mean."""
    title(axes, sheet.titled("Angular velocity error", "angular velocity error"), "")
    error_rad_s = sheet.motion.rate_rad_s - sheet.desired_rad_s
    tolerance_rad_s = criteria.tolerances.angular_rate_error_rad_s
    _draw_error(axes, sheet, "rate error [rad/s]", error_rad_s, tolerance_rad_s, "tolerance of the mean")


def draw_spacing_error(axes: "Axes", sheet: Sheet, criteria: Criteria) -> None:
    """Draw the running rms error of the spacings on the ring."""
    title(axes, sheet.titled("Spacing error on the ring", "spacing error"), "")
    error_deg = np.degrees(sheet.motion.lead_rad - sheet.motion.desired_spacing_rad)
    _draw_error(axes, sheet, "spacing error [°]", error_deg, criteria.tolerances.spacing_error_rms_deg)


def draw_formation_errors(axes: "Axes", sheet: Sheet, criteria: Criteria, *, spacing: bool) -> None:
    """Draw the running rms error of the speeds, or of the spacings, in formation."""
    speed_m_s, spacing_m = formation_errors(sheet.record, criteria.formation)
    if spacing:
        title(axes, "Spacing error in formation", "")
        _draw_error(axes, sheet, "spacing error [m]", spacing_m, criteria.tolerances.formation_spacing_error_rms_m)
    else:
        title(axes, "Speed error in formation", "")
        _draw_error(axes, sheet, "speed error [m/s]", speed_m_s, criteria.tolerances.formation_speed_error_rms_m_s)


def _draw_error(
    axes: "Axes", sheet: Sheet, label: str, error: Vector, tolerance: float, level_label: str = "tolerance"
) -> None:
    time_s = sheet.record.time_s
    samples = max(1, round(RUNNING_S * sheet.record.loop.rate_hz))
    rms = running_rms(error, samples)
    known = np.flatnonzero(np.isfinite(rms).any(axis=0))
    if not known.size:
        mark_empty(axes, "not measured in this flight")
        return
    over_time(axes, label, time_s[known[0] : known[-1] + 1])
    logarithmic(axes, np.append(rms, tolerance), _FLOOR_SHARE * tolerance)
    levels(axes, {level_label: tolerance})
    for row in range(len(rms)):
        axes.plot(*sheet.line(time_s, np.maximum(rms[row], 1e-3 * _FLOOR_SHARE * tolerance)), **sheet.style(row))


def draw_closest(axes: "Axes", sheet: Sheet, flocking: Flocking, criteria: Criteria) -> None:
    """Draw the distance of the two vehicles closest to each other, and mark the closest approach."""
    record, separation_m = sheet.record, criteria.tolerances.separation_m
    closest_m = np.fmin.reduce(flocking.nearest_m, axis=0, initial=np.inf)
    if not np.isfinite(closest_m).any():
        title(axes, "Closest approach", "")
        mark_empty(axes, "fewer than two vehicles were measured at any time")
        return
    sample = int(np.argmin(closest_m))
    found = f"{closest_m[sample]:.2f} m at {record.time_s[sample]:.1f} s, {_pair(record, flocking, sample)}"
    title(axes, "Closest approach", found)
    over_time(axes, "distance [m]", record.time_s)
    known_m = np.where(np.isfinite(closest_m), closest_m, np.nan)
    axes.plot(*sheet.line(record.time_s, known_m), color=INK, linewidth=1.3, label="distance")
    violated = closest_m[sample] < separation_m
    mark: dict[str, Any] = {"color": FAIL if violated else INK, "markersize": 8, "clip_on": False, "zorder": 10}
    axes.plot(record.time_s[sample], closest_m[sample], "v", **mark)
    axes.set_ylim(0.0, 1.08 * max(float(np.nanmax(known_m)), 1.5 * separation_m))
    levels(axes, {f"required separation: {separation_m:g} m": separation_m})


def _pair(record: FlightRecord, flocking: Flocking, sample: int) -> str:
    nearest_m = flocking.nearest_m[:, sample]
    rows = np.flatnonzero(nearest_m == np.nanmin(nearest_m))[:2]
    return "vehicles " + " and ".join(str(record.vehicles[row].vehicle_id) for row in rows)


def draw_nearest(axes: "Axes", sheet: Sheet, flocking: Flocking) -> None:
    """Draw each vehicle's distance to the nearest other: Reynolds' separation."""
    title(axes, "Separation: distance to the nearest other", "")
    _draw_rows(axes, sheet, "distance [m]", flocking.nearest_m)


def draw_mismatch(axes: "Axes", sheet: Sheet, flocking: Flocking) -> None:
    """Draw each velocity relative to the team's mean: Reynolds' alignment."""
    title(axes, "Alignment: velocity relative to the team's mean", "")
    _draw_rows(axes, sheet, "|v − mean v| [m/s]", flocking.mismatch_m_s)


def draw_order(axes: "Axes", sheet: Sheet, flocking: Flocking) -> None:
    """Draw the order parameter of the directions of flight."""
    title(axes, "Alignment: order parameter", "1: all in one direction")
    over_time(axes, "order [–]", sheet.record.time_s)
    axes.plot(*sheet.line(sheet.record.time_s, flocking.order), color=INK, linewidth=1.2, label="order")
    axes.set_ylim(0.0, 1.05)


def draw_cohesion(axes: "Axes", sheet: Sheet, flocking: Flocking) -> None:
    """Draw each vehicle's distance to the team's centroid: Reynolds' cohesion."""
    title(axes, "Cohesion: distance to the team's centroid", "")
    _draw_rows(axes, sheet, "distance [m]", flocking.off_centre_m)


def _draw_rows(axes: "Axes", sheet: Sheet, label: str, values: Vector) -> None:
    over_time(axes, label, sheet.record.time_s)
    for row in range(len(values)):
        axes.plot(*sheet.line(sheet.record.time_s, values[row]), **sheet.style(row))
    axes.set_ylim(bottom=0.0)


def draw_lyapunov(axes: "Axes", sheet: Sheet, periods: Sequence[Decay]) -> None:
    """Draw V of the ring's spacings, and from every change of the ring on the decay expected from the spacing law."""
    time_s, value_rad2 = sheet.record.time_s, lyapunov_rad2(sheet.motion)
    title(axes, sheet.titled("Lyapunov function of the spacings", "Lyapunov function"), "")
    first_s, last_s = periods[0].start_s, periods[-1].end_s
    over_time(axes, "V [rad²]", time_s[(time_s >= first_s) & (time_s <= last_s)])
    if sheet.result.window_s is not None:
        axes.axvspan(*sheet.result.window_s, color=WINDOW, zorder=0)
    logarithmic(axes, value_rad2, _FLOOR_RAD2)
    low_rad2, _ = axes.get_ylim()
    axes.plot(*sheet.line(time_s, np.maximum(value_rad2, 0.1 * low_rad2)), color=INK, linewidth=1.3, label="flown")
    for index, decay in enumerate(periods):
        fine_s = np.linspace(decay.start_s, decay.end_s, 400)
        expected = decay.expected_rad2(fine_s)
        shown = expected > 0.5 * low_rad2
        axes.plot(fine_s[shown], expected[shown], **_EXPECTED, label="" if index else "expected")
    if periods[0].decay_per_s is not None:
        axes.legend(loc="best", edgecolor="none", framealpha=0.8)


def draw_decays(axes: "Axes", sheet: Sheet, periods: Sequence[Decay]) -> None:
    """Draw V relative to its initial value after each of the last changes of the ring, and the expected decay."""
    time_s, value_rad2 = sheet.record.time_s, lyapunov_rad2(sheet.motion)
    title(axes, "After every change of the ring", "")
    recent = periods[-_DECAYS_SHOWN:]
    expected_s = max((each.expected_after_s or 0.0 for each in recent), default=0.0)
    over_time(axes, "V / V at the change", np.array([0.0, max(30.0, 2.0 * expected_s)]))
    axes.set_xlabel("time since the change [s]")
    logarithmic(axes, np.array([_FLOOR_SHARE**2, 1.0]), _FLOOR_SHARE**2)
    for row, each in enumerate(recent):
        inside = (time_s >= each.start_s) & (time_s <= each.end_s)
        share = np.maximum(value_rad2[inside] / max(each.start_rad2, _FLOOR_RAD2), 0.1 * _FLOOR_SHARE**2)
        style: dict[str, Any] = {"color": _DECAY_GREYS[row], "linewidth": 1.4, "linestyle": DASHES[row]}
        drawn = sheet.line(time_s[inside] - each.start_s, share)
        axes.plot(*drawn, label=f"{each.members} vehicles, from {each.start_s:.0f} s", **style)
    for index, rate in enumerate(sorted({each.decay_per_s for each in recent if each.decay_per_s is not None})):
        since_s = np.array(axes.get_xlim())
        axes.plot(since_s, np.exp(-rate * since_s), **_EXPECTED, label="" if index else "expected")
    axes.legend(loc="lower left", edgecolor="none", framealpha=0.8)
