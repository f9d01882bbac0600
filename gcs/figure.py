"""One page of figures of a flight: the paper's figures 1 to 6 (section 5).

Paths with the vehicles and the target, speeds in formation, radii, angular velocities and
spacings on the ring. matplotlib is imported only when a figure is asked for, and draws without a
display.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.state import Vector
from gcs.metrics import RingMotion, ring_motion
from gcs.record import FlightRecord, VehicleTrack
from gcs.result import FlightResult, FormationReference, RingReference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METADATA: dict[str, dict[str, None]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
WIDTH_IN = 10.0
# Vehicles 1, 2, 3 are blue, red and green as in the paper, in shades that stay apart for colour-blind eyes.
COLOURS = ("#0077BB", "#CC3311", "#009E73", "#AA4499", "#E69F00", "#56B4E9", "#882255", "#8A8A2A")
DASHES = ("-", (0, (5, 1.2, 1, 1.2)), (0, (1, 1)), (0, (7, 1, 1, 1, 1, 1)))
INK, FAINT, WINDOW, FAIL = "#333333", "#8A8A8A", "#F2F2F2", "#B3200A"
DESIRED: dict[str, Any] = {"color": INK, "linewidth": 1.0, "linestyle": (0, (4, 3)), "zorder": 4}
ENGAGED: dict[str, Any] = {"marker": "o", "markersize": 7, "markerfacecolor": "white", "markeredgewidth": 1.6}
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    # With the date left out of the metadata, the same flight gives the same file.
    "svg.hashsalt": "cordon",
}


@dataclass(frozen=True, slots=True)
class _Sheet:
    """What every panel draws from."""

    record: FlightRecord
    result: FlightResult
    ring: RingReference
    formation: FormationReference | None
    motion: RingMotion

    def style(self, row: int) -> dict[str, Any]:
        """Return how a vehicle's lines look: the colours in turn, then the same again in another dash."""
        dashes = DASHES[row // len(COLOURS) % len(DASHES)]
        crowded = len(self.record.vehicles) > len(COLOURS)
        return {
            "color": COLOURS[row % len(COLOURS)],
            "linestyle": dashes,
            "linewidth": 1.0 if crowded else 1.4,
        }


def save_figure(
    record: FlightRecord,
    result: FlightResult,
    ring: RingReference,
    path: Path,
    formation: FormationReference | None = None,
) -> None:
    """Draw a flight and write it to `path`, whose suffix chooses PNG, SVG or PDF.

    `formation` adds its desired speed. Raises ValueError for any other suffix, OSError when the file cannot
    be written.
    """
    suffix = path.suffix.lower()
    if suffix not in METADATA:
        raise ValueError(f"cannot draw a figure as {path.name!r}: its name must end in {', '.join(METADATA)}")
    from matplotlib import rc_context  # noqa: PLC0415

    with rc_context(STYLE):
        figure = _draw(_Sheet(record, result, ring, formation, ring_motion(record)))
        figure.savefig(path, dpi=160, metadata=METADATA[suffix])


def _draw(sheet: _Sheet) -> "Figure":
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    span_m = np.ptp(_landmarks_m(sheet), axis=0)
    map_height_in = float(np.clip(0.95 * WIDTH_IN * span_m[1] / max(span_m[0], 1e-9), 2.6, 5.2))
    figure = Figure(figsize=(WIDTH_IN, map_height_in + 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    layout = [["paths", "paths"], ["speed", "radius"], ["rate", "spacing"]]
    panels = figure.subplot_mosaic(layout, height_ratios=(map_height_in, 2.1, 2.1))  # type: ignore[arg-type]
    _draw_paths(panels["paths"], sheet)
    _draw_speeds(panels["speed"], sheet)
    _draw_radii(panels["radius"], sheet)
    _draw_rates(panels["rate"], sheet)
    _draw_spacings(panels["spacing"], sheet)
    _draw_legend(figure, sheet)
    return figure


def _landmarks_m(sheet: _Sheet) -> Vector:
    """Return points (K, 2) that the map must show: every path, and the desired ring where there is one."""
    paths = [track.position_m for track in sheet.record.vehicles]
    target_m = sheet.record.target_position_m
    if sheet.result.window_s is not None:
        paths += [target_m[-1:] - sheet.ring.radius_m, target_m[-1:] + sheet.ring.radius_m]
    points_m = np.concatenate([*paths, target_m])
    known_m = points_m[np.isfinite(points_m).all(axis=1)]
    return known_m if known_m.size else np.zeros((1, 2))


def _draw_paths(axes: "Axes", sheet: _Sheet) -> None:
    record = sheet.record
    axes.update_datalim(_landmarks_m(sheet))
    axes.margins(0.04)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    _title(axes, f"{record.mission}: paths", _verdict_line(sheet.result))
    _draw_target(axes, sheet)
    for row, track in enumerate(record.vehicles):
        axes.plot(*track.position_m.T, alpha=0.85, **sheet.style(row))
    for row, track in enumerate(record.vehicles):
        _mark_engagement(axes, sheet, row, track.position_m[:, 0], track.position_m[:, 1])
        _mark_vehicle(axes, row, track)


def _draw_target(axes: "Axes", sheet: _Sheet) -> None:
    from matplotlib.patches import Circle  # noqa: PLC0415

    path_m = sheet.record.target_position_m
    known_m = path_m[np.isfinite(path_m).all(axis=1)]
    if not known_m.size:
        return
    axes.plot(*known_m.T, color="black", linewidth=1.2, zorder=3)
    axes.plot(*known_m[0], marker="D", markersize=6, markerfacecolor="white", color="black", zorder=5)
    axes.plot(*known_m[-1], marker="D", markersize=8, color="black", zorder=6)
    if sheet.result.window_s is not None:
        axes.add_patch(Circle(tuple(known_m[-1]), sheet.ring.radius_m, fill=False, **DESIRED))


def _mark_vehicle(axes: "Axes", row: int, track: VehicleTrack) -> None:
    known_m = track.position_m[np.isfinite(track.position_m).all(axis=1)]
    if not known_m.size:
        return
    colour = COLOURS[row % len(COLOURS)]
    axes.plot(*known_m[0], marker="o", markersize=4, color=colour, zorder=5)
    axes.plot(*known_m[-1], marker="D", markersize=12, color=colour, markeredgecolor="white", zorder=7)
    axes.annotate(
        str(track.vehicle_id),
        known_m[-1],
        ha="center",
        va="center_baseline",
        fontsize=8 if track.vehicle_id < 10 else 7,
        fontweight="bold",
        color="white",
        zorder=8,
    )


def _mark_engagement(axes: "Axes", sheet: _Sheet, row: int, x: Vector, y: Vector) -> None:
    """Circle the sample of a line at which its vehicle engaged."""
    engaged_s = sheet.result.vehicles[row].engaged_at_s
    if engaged_s is None:
        return
    sample = int(np.argmin(np.abs(sheet.record.time_s - engaged_s)))
    axes.plot(x[sample], y[sample], color=COLOURS[row % len(COLOURS)], zorder=6, **ENGAGED)


def _draw_speeds(axes: "Axes", sheet: _Sheet) -> None:
    _title(axes, "Speed in formation", "")
    axes.set(xlabel="time [s]", ylabel="speed in x [m/s]")
    if sheet.formation is not None:
        axes.axhline(sheet.formation.speed_m_s, **DESIRED)
    time_s, end_s = sheet.record.time_s, 0.0
    for row, track in enumerate(sheet.record.vehicles):
        flying = track.tactic == "formation"
        speed_m_s = np.where(flying, track.velocity_m_s[:, 0], np.nan)
        axes.plot(time_s, speed_m_s, **sheet.style(row))
        _mark_engagement(axes, sheet, row, time_s, _held(speed_m_s))
        end_s = max(end_s, float(time_s[flying][-1])) if flying.any() else end_s
    if end_s > 0.0:
        axes.set_xlim(0.0, 1.03 * end_s)
    else:
        _say(axes, "nobody flew in formation")


def _held(values: Vector) -> Vector:
    """Fill every NaN with the number before it, so that a mark just after a line's end finds it."""
    known = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(values.size)))
    return values[known]


def _draw_radii(axes: "Axes", sheet: _Sheet) -> None:
    axes.set(xlabel="time [s]", ylabel="radius [m]")
    errors_m = [v.radius_error_rms_m for v in sheet.result.vehicles if v.radius_error_rms_m is not None]
    _title(axes, "Radius about the target", f"error {max(errors_m):.2g} m rms at most" if errors_m else "")
    _draw_ring_panel(axes, sheet, sheet.motion.radius_m, sheet.ring.radius_m)


def _draw_rates(axes: "Axes", sheet: _Sheet) -> None:
    axes.set(xlabel="time [s]", ylabel="angular velocity [rad/s]")
    means_rad_s = [v.angular_rate_mean_rad_s for v in sheet.result.vehicles if v.angular_rate_mean_rad_s is not None]
    _title(axes, "Angular velocity", f"mean {np.mean(means_rad_s):.4f} rad/s" if means_rad_s else "")
    wanted_rad_s = sheet.ring.angular_rate_rad_s
    _draw_ring_panel(axes, sheet, sheet.motion.rate_rad_s, wanted_rad_s)
    # A vehicle that passes close to the target turns about it at a rate that would flatten all the rest.
    low_rad_s, high_rad_s = axes.get_ylim()
    reach_rad_s = 4.0 * max(abs(wanted_rad_s), 0.05)
    axes.set_ylim(max(low_rad_s, wanted_rad_s - reach_rad_s), min(high_rad_s, wanted_rad_s + reach_rad_s))


def _draw_spacings(axes: "Axes", sheet: _Sheet) -> None:
    axes.set(xlabel="time [s]", ylabel="angle to the next [°]")
    error_deg = sheet.result.ring.spacing_error_rms_deg
    _title(axes, "Angular separation", f"error {error_deg:.2g}° rms" if error_deg is not None else "")
    lead_deg, desired_deg = np.degrees(sheet.motion.lead_rad), np.degrees(sheet.motion.desired_spacing_rad)
    if sheet.result.window_s is not None and np.isnan(lead_deg).all():
        _say(axes, "one vehicle on the ring: nothing to separate")
    else:
        _draw_ring_panel(axes, sheet, lead_deg, desired_deg)


def _draw_ring_panel(axes: "Axes", sheet: _Sheet, values: Vector, desired: Vector | float) -> None:
    """Draw one quantity (V, T) of the ring, from the first engagement on, over the window of the metrics."""
    if sheet.result.window_s is None:
        _say(axes, "nobody engaged")
        return
    time_s = sheet.record.time_s
    first_s = min(v.engaged_at_s for v in sheet.result.vehicles if v.engaged_at_s is not None)
    axes.set_xlim(first_s - 0.02 * (time_s[-1] - first_s), time_s[-1])
    axes.axvspan(*sheet.result.window_s, color=WINDOW, zorder=0)
    axes.plot(time_s, np.where(time_s >= first_s, desired, np.nan), **DESIRED)
    for row in range(len(values)):
        axes.plot(time_s, values[row], **sheet.style(row))
    for row in range(len(values)):
        _mark_engagement(axes, sheet, row, time_s, values[row])
    axes.ticklabel_format(axis="y", useOffset=False)


def _draw_legend(figure: "Figure", sheet: _Sheet) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    tracks = enumerate(sheet.record.vehicles)
    handles = [
        *(Line2D([], [], label=f"vehicle {track.vehicle_id}", **sheet.style(row)) for row, track in tracks),
        Line2D([], [], label="target", color="black", marker="D", linewidth=1.2),
        Line2D([], [], label="desired", **DESIRED),
        Line2D([], [], label="engages", linestyle="", color=FAINT, **ENGAGED),
        Patch(label="window of the metrics", color="#DDDDDD"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 7), frameon=False)


def _verdict_line(result: FlightResult) -> str:
    marks = {True: "✓", False: "✗", None: "–"}
    return "   ".join(f"{name} {marks[holds]}" for name, holds in result.verdicts.named().items())


def _title(axes: "Axes", text: str, finding: str) -> None:
    axes.set_title(text, loc="left", fontweight="bold")
    axes.set_title(finding, loc="right", fontsize=9, color=FAIL if "✗" in finding else FAINT)


def _say(axes: "Axes", text: str) -> None:
    """Say why a panel is empty."""
    axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=FAINT)
