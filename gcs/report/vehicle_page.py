"""The report of an autopilot's log: its contents, and how the vehicle followed its setpoints."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.state import Vector
from gcs.keys.private_files import create
from gcs.report.charts.chart import chart, over_time
from gcs.report.charts.panels import mark_empty, thinned, thinned_path, title
from gcs.report.page_parts import KeyLine, Section, Table, render
from gcs.style import COLOURS, DESIRED, FAINT, INK
from gcs.vehicle_logs.vehicle_log import Series, VehicleLog, describe

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS = 1200
_AXES = ("x, north", "y, west", "z, up")
_MODE_COLOURS = ("#99DDFF", "#BBCC33", "#EEDD88", "#FFAABB", "#77AADD", "#DDDDDD", "#EE8866", "#AAAAAA")
_LINES: dict[str, dict[str, Any]] = {
    "position": {"color": COLOURS[0], "linewidth": 1.4},
    "true": {"color": COLOURS[2], "linewidth": 1.0},
}


def write_vehicle_report(logs: Sequence[VehicleLog], path: Path) -> None:
    """Write the report of a log's vehicles to a file; raises OSError when it cannot be written."""
    with create(path) as file:
        file.write(vehicle_report_html(logs).encode(errors="replace"))  # names of files may hold bytes that are no text


def vehicle_report_html(logs: Sequence[VehicleLog]) -> str:
    """Return the report of a log's vehicles as a page of HTML."""
    first = logs[0]
    facts = {"format": first.format, "SHA-256": first.sha256, "vehicles": ", ".join(str(log.system_id) for log in logs)}
    key = (
        KeyLine("setpoint", INK, "4 3"),
        KeyLine("estimate", COLOURS[0], ""),
        KeyLine("truth, where a simulator logged it", COLOURS[2], ""),
    )
    return render(
        "vehicle_log.html.j2", name=Path(first.path).name, facts=facts, key=key, sections=list(map(_section, logs))
    )


def summarised(log: VehicleLog) -> dict[str, Any]:
    """Return the contents of a log as plain data; a distance that is not known is None."""
    _, apart_m = distance_m(log)
    known = apart_m[np.isfinite(apart_m)]
    return {
        "path": log.path,
        "format": log.format,
        "sha256": log.sha256,
        "vehicle": log.system_id,
        "autopilot": log.autopilot,
        "firmware": log.firmware,
        "duration_s": log.duration_s,
        "series": {name: {"samples": each.time_s.size, "rate_hz": each.rate_hz} for name, each in log.series().items()},
        "modes": [[mode.span.begin_s, mode.span.end_s, mode.name] for mode in log.modes],
        "setpoint_distance_rms_m": float(np.sqrt(np.mean(known**2))) if known.size else None,
        "missing": list(log.missing),
        "notes": list(log.notes),
        "damaged": log.is_damaged,
    }


def _section(log: VehicleLog) -> Section:
    name, charts = f"vehicle-{log.system_id}", []
    if log.position is not None:
        charts = [
            chart(
                f"{name}-paths",
                partial(_draw_paths, log=log),
                "Map of setpoints and positions.",
                4.0,
                is_over_time=False,
            ),
            chart(
                f"{name}-axes",
                [partial(_draw_axis, log=log, axis=axis) for axis in range(3)],
                "Setpoint and position over time, along each axis.",
                5.2,
            ),
            chart(f"{name}-lag", partial(_draw_distance, log=log), "Distance from the setpoint over time."),
        ]
    if log.velocity is not None:
        charts.append(chart(f"{name}-speed", partial(_draw_speed, log=log), "Horizontal speed over time."))
    if log.modes:
        charts.append(chart(f"{name}-modes", partial(_draw_modes, log=log), "Flight modes over time.", 1.6))
    holds = Table("Contents of the log", ("", "contents"), tuple(describe(log)), words=2)
    texts = tuple((f"{text.time_s:.1f}", text.text) for text in log.texts)
    autopilot_texts = (
        (Table("Messages of the autopilot", ("time [s]", "text"), texts, words=2, folded=len(texts) > 8),)
        if texts
        else ()
    )
    lead = "Metres about the vehicle's own local origin, x north, y west, z up; seconds since the log's first sample."
    missing = () if log.position is not None else ("The log holds no position: charts are not available.",)
    return Section(name, f"Vehicle {log.system_id}", lead, tuple(charts), (holds, *autopilot_texts), missing)


def distance_m(log: VehicleLog) -> tuple[Vector, Vector]:
    """Return the times (T,) of the positions and their horizontal distance (T,) from the setpoint at that time.

    NaN before the first setpoint, and in modes that do not follow external setpoints.
    """
    if log.setpoint is None or log.position is None:
        return np.empty(0), np.empty(0)
    time_s = log.position.time_s
    held = np.searchsorted(log.setpoint.time_s, time_s, side="right") - 1
    apart_m = np.hypot(*(log.position.values - log.setpoint.values[held])[:, :2].T)
    flown = np.zeros(time_s.size, dtype=bool)
    for mode in log.modes:
        if mode.external:
            flown |= (time_s >= mode.span.begin_s) & (time_s < mode.span.end_s)
    return time_s, np.where((held >= 0) & flown, apart_m, np.nan)


def _draw_paths(axes: "Axes", log: VehicleLog) -> None:
    title(axes, "Map", "")
    axes.set(xlabel="x, north [m]", ylabel="y, west [m]")
    axes.set_aspect("equal", adjustable="datalim")
    for series, style in _drawn(log):
        axes.plot(*thinned_path(series.values[:, :2], _POINTS).T, **style)


def _draw_axis(axes: "Axes", log: VehicleLog, axis: int) -> None:
    title(axes, "Setpoint and position", "")
    assert log.position is not None
    over_time(axes, f"{_AXES[axis]} [m]", log.position.time_s)
    for series, style in _drawn(log):
        axes.plot(*thinned(series.time_s, series.values[:, axis], _POINTS), **style)


def _drawn(log: VehicleLog) -> list[tuple[Series, dict[str, Any]]]:
    lines: list[tuple[Series | None, dict[str, Any]]] = [
        (log.true_position, dict(_LINES["true"])),
        (log.position, dict(_LINES["position"])),
        (log.setpoint, {**DESIRED, "drawstyle": "steps-post"}),
    ]
    return [(series, style) for series, style in lines if series is not None]


def _draw_distance(axes: "Axes", log: VehicleLog) -> None:
    time_s, apart_m = distance_m(log)
    known = apart_m[np.isfinite(apart_m)]
    title(axes, "Distance from the setpoint", f"{np.sqrt(np.mean(known**2)):.2f} m rms" if known.size else "")
    if not known.size:
        mark_empty(axes, "the log holds no external setpoints")
        return
    over_time(axes, "distance [m]", time_s)
    axes.plot(*thinned(time_s, apart_m, _POINTS), **_LINES["position"])
    axes.set_ylim(bottom=0.0)


def _draw_speed(axes: "Axes", log: VehicleLog) -> None:
    assert log.velocity is not None
    speed_m_s = np.hypot(*log.velocity.values[:, :2].T)
    title(axes, "Horizontal speed", f"{np.nanmax(speed_m_s):.1f} m/s max")
    over_time(axes, "speed [m/s]", log.velocity.time_s)
    axes.plot(*thinned(log.velocity.time_s, speed_m_s, _POINTS), **_LINES["position"])


def _draw_modes(axes: "Axes", log: VehicleLog) -> None:
    title(axes, "Flight modes", "framed: external setpoints (offboard, guided)")
    names = list(dict.fromkeys(mode.name for mode in log.modes))
    axes.set(xlabel="time [s]", yticks=[], ylim=(0.0, 1.0), xlim=(0.0, max(log.duration_s, 1e-3)))
    for mode in log.modes:
        width_s = mode.span.end_s - mode.span.begin_s
        colour = _MODE_COLOURS[names.index(mode.name) % len(_MODE_COLOURS)]
        edge = {"edgecolor": INK, "linewidth": 1.2} if mode.external else {"linewidth": 0.0}
        axes.broken_barh([(mode.span.begin_s, width_s)], (0.15, 0.7), facecolor=colour, **edge)
        if width_s > 0.12 * log.duration_s:
            middle_s = mode.span.begin_s + width_s / 2.0
            axes.text(middle_s, 0.5, mode.name, ha="center", va="center", fontsize=9, color=INK)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_color(FAINT)
