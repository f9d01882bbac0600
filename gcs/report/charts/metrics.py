"""The panels of how the flight went beside the paper's figures: errors, distances, flocking, the Lyapunov function."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.state import Vector
from gcs.metrics.metrics import formation_errors
from gcs.metrics.record import FlightRecord
from gcs.metrics.reynolds import Flocking
from gcs.report.charts.chart import level, logarithmic, over_time
from gcs.report.charts.panels import Sheet, say, title
from gcs.report.evidence.asked import Asked
from gcs.report.evidence.lyapunov import Decay, lyapunov_rad2
from gcs.style import (
    DASHES,
    DESIRED,
    FAIL,
    INK,
    WINDOW,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RUNNING_S = 10.0
_FLOOR_SHARE = 1e-3
_FLOOR_RAD2 = 1e-7
_PROMISED = DESIRED | {"color": "#0077BB"}
_DECAYS_SHOWN = 4
_DECAY_GREYS = ("#000000", "#4D4D4D", "#7F7F7F", "#A6A6A6")


def running_rms(values: Vector, samples: int) -> Vector:
    """Return the root mean square of the last `samples` of each row (V, T), of those known; NaN where none is."""
    known = np.isfinite(values)
    squares = np.cumsum(np.where(known, values, 0.0) ** 2, axis=1)
    count = np.cumsum(known, axis=1)
    squares[:, samples:] -= squares[:, :-samples].copy()
    count[:, samples:] -= count[:, :-samples].copy()
    mean = np.maximum(squares, 0.0) / np.maximum(count, 1)
    return np.where(known & (count > 0), np.sqrt(mean), np.nan)


def draw_radius_error(axes: "Axes", sheet: Sheet, asked: Asked) -> None:
    """Draw how far the radii are off."""
    title(axes, "Radius error", "")
    error_m = sheet.motion.radius_m - sheet.ring.radius_m
    _draw_error(axes, sheet, "radius error [m]", error_m, asked.tolerances.radius_error_rms_m)


def draw_rate_error(axes: "Axes", sheet: Sheet, asked: Asked) -> None:
    """Draw how far the angular velocities are off; C2 judges the error of their mean."""
    title(axes, "Angular velocity error", "")
    error_rad_s = sheet.motion.rate_rad_s - sheet.ring.angular_rate_rad_s
    tolerance_rad_s = asked.tolerances.angular_rate_error_rad_s
    _draw_error(axes, sheet, "rate error [rad/s]", error_rad_s, tolerance_rad_s, "tolerance of the mean")


def draw_spacing_error(axes: "Axes", sheet: Sheet, asked: Asked) -> None:
    """Draw how far the angles between neighbours on the ring are off."""
    title(axes, "Spacing error on the ring", "")
    error_deg = np.degrees(sheet.motion.lead_rad - sheet.motion.desired_spacing_rad)
    _draw_error(axes, sheet, "spacing error [°]", error_deg, asked.tolerances.spacing_error_rms_deg)


def draw_formation_errors(axes: "Axes", sheet: Sheet, asked: Asked, *, spacing: bool) -> None:
    """Draw how far speeds, or places relative to the neighbour's, are off in formation."""
    speed_m_s, spacing_m = formation_errors(sheet.record, asked.formation)
    if spacing:
        title(axes, "Spacing error in formation", "")
        _draw_error(axes, sheet, "spacing error [m]", spacing_m, asked.tolerances.formation_spacing_error_rms_m)
    else:
        title(axes, "Speed error in formation", "")
        _draw_error(axes, sheet, "speed error [m/s]", speed_m_s, asked.tolerances.formation_speed_error_rms_m_s)


def _draw_error(
    axes: "Axes", sheet: Sheet, label: str, error: Vector, tolerance: float, words: str = "tolerance"
) -> None:
    time_s = sheet.record.time_s
    samples = max(1, round(RUNNING_S * sheet.record.loop.rate_hz))
    rms = running_rms(error, samples)
    known = np.flatnonzero(np.isfinite(rms).any(axis=0))
    if not known.size:
        say(axes, "not measured in this flight")
        return
    over_time(axes, label, time_s[known[0] : known[-1] + 1])
    logarithmic(axes, np.append(rms, tolerance), _FLOOR_SHARE * tolerance)
    level(axes, tolerance, words)
    for row in range(len(rms)):
        axes.plot(*sheet.line(time_s, np.maximum(rms[row], 1e-3 * _FLOOR_SHARE * tolerance)), **sheet.style(row))


def draw_closest(axes: "Axes", sheet: Sheet, flocking: Flocking, asked: Asked) -> None:
    """Draw the distance of the two vehicles closest to each other, and mark the closest approach."""
    record, separation_m = sheet.record, asked.tolerances.separation_m
    closest_m = np.fmin.reduce(flocking.nearest_m, axis=0, initial=np.inf)
    if not np.isfinite(closest_m).any():
        title(axes, "Closest approach", "")
        say(axes, "no two vehicles were heard at once")
        return
    sample = int(np.argmin(closest_m))
    found = f"{closest_m[sample]:.2f} m at {record.time_s[sample]:.1f} s, {_pair(record, flocking, sample)}"
    title(axes, "Closest approach", found)
    over_time(axes, "distance [m]", record.time_s)
    known_m = np.where(np.isfinite(closest_m), closest_m, np.nan)
    axes.plot(*sheet.line(record.time_s, known_m), color=INK, linewidth=1.3)
    touches = closest_m[sample] < separation_m
    mark: dict[str, Any] = {"color": FAIL if touches else INK, "markersize": 8, "clip_on": False, "zorder": 10}
    axes.plot(record.time_s[sample], closest_m[sample], "v", **mark)
    axes.set_ylim(0.0, 1.08 * max(float(np.nanmax(known_m)), 1.5 * separation_m))
    level(axes, separation_m, f"separation asked for: {separation_m:g} m", below=True)


def _pair(record: FlightRecord, flocking: Flocking, sample: int) -> str:
    nearest_m = flocking.nearest_m[:, sample]
    rows = np.flatnonzero(nearest_m == np.nanmin(nearest_m))[:2]
    return "vehicles " + " and ".join(str(record.vehicles[row].vehicle_id) for row in rows)


def draw_nearest(axes: "Axes", sheet: Sheet, flocking: Flocking) -> None:
    """Draw each vehicle's distance to the nearest other: Reynolds' separation."""
    title(axes, "Separation: distance to the nearest other", "")
    _draw_rows(axes, sheet, "distance [m]", flocking.nearest_m)


def draw_mismatch(axes: "Axes", sheet: Sheet, flocking: Flocking) -> None:
    """Draw how far each velocity is off the team's mean: Reynolds' alignment."""
    title(axes, "Alignment: velocity relative to the team's mean", "")
    _draw_rows(axes, sheet, "|v − mean v| [m/s]", flocking.mismatch_m_s)


def draw_order(axes: "Axes", sheet: Sheet, flocking: Flocking) -> None:
    """Draw the order parameter of the directions of flight."""
    title(axes, "Alignment: order parameter", "1: all fly the same way")
    over_time(axes, "order [–]", sheet.record.time_s)
    axes.plot(*sheet.line(sheet.record.time_s, flocking.order), color=INK, linewidth=1.2)
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


def draw_lyapunov(axes: "Axes", sheet: Sheet, stretches: Sequence[Decay]) -> None:
    """Draw V of the ring's spacings, and from every change of the ring on the decay that the spacing law promises."""
    time_s, value_rad2 = sheet.record.time_s, lyapunov_rad2(sheet.motion)
    title(axes, "Lyapunov function of the spacings", "")
    first_s, last_s = stretches[0].start_s, stretches[-1].end_s
    over_time(axes, "V [rad²]", time_s[(time_s >= first_s) & (time_s <= last_s)])
    if sheet.result.window_s is not None:
        axes.axvspan(*sheet.result.window_s, color=WINDOW, zorder=0)
    logarithmic(axes, value_rad2, _FLOOR_RAD2)
    low_rad2, _ = axes.get_ylim()
    axes.plot(*sheet.line(time_s, np.maximum(value_rad2, 0.1 * low_rad2)), color=INK, linewidth=1.3, label="flown")
    for index, stretch in enumerate(stretches):
        fine_s = np.linspace(stretch.start_s, stretch.end_s, 400)
        promised = stretch.promised_rad2(fine_s)
        shown = promised > 0.5 * low_rad2
        axes.plot(fine_s[shown], promised[shown], **_PROMISED, label="" if index else "promised")
    if stretches[0].decay_per_s is not None:
        axes.legend(loc="upper right", edgecolor="none", framealpha=0.8)


def draw_decays(axes: "Axes", sheet: Sheet, stretches: Sequence[Decay]) -> None:
    """Draw V relative to what it was after each of the last changes of the ring, and the promised decay."""
    time_s, value_rad2 = sheet.record.time_s, lyapunov_rad2(sheet.motion)
    title(axes, "After every change of the ring", "")
    falls = stretches[-_DECAYS_SHOWN:]
    promised_s = max((each.promised_after_s or 0.0 for each in falls), default=0.0)
    over_time(axes, "V / V at the change", np.array([0.0, max(20.0, 2.0 * promised_s)]))
    axes.set_xlabel("time since the change [s]")
    logarithmic(axes, np.array([_FLOOR_SHARE**2, 1.0]), _FLOOR_SHARE**2)
    for row, each in enumerate(falls):
        inside = (time_s >= each.start_s) & (time_s <= each.end_s)
        share = np.maximum(value_rad2[inside] / max(each.start_rad2, _FLOOR_RAD2), 0.1 * _FLOOR_SHARE**2)
        style: dict[str, Any] = {"color": _DECAY_GREYS[row], "linewidth": 1.4, "linestyle": DASHES[row]}
        drawn = sheet.line(time_s[inside] - each.start_s, share)
        axes.plot(*drawn, label=f"{each.members} vehicles, from {each.start_s:.0f} s", **style)
    for index, rate in enumerate(sorted({each.decay_per_s for each in falls if each.decay_per_s is not None})):
        since_s = np.array(axes.get_xlim())
        axes.plot(since_s, np.exp(-rate * since_s), **_PROMISED, label="" if index else "promised")
    axes.legend(loc="upper right", edgecolor="none", framealpha=0.8)
