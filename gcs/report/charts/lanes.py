"""The timeline of a flight: a lane for each vehicle with its tactics, engagement, commands, failsafes and guard.

Injected faults have a lane of their own above those of the vehicles.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.safety.guard import GuardStatus
from agents.tactics import NO_TACTIC
from gcs.metrics.record import FlightRecord, VehicleTrack
from gcs.report.charts.panels import Sheet, title
from gcs.report.evidence.flight import FlightEvidence
from gcs.style import ENGAGED, FAIL, FAINT, INK, TACTIC_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LANE_IN, _SLIM_LANE_IN = 0.42, 0.3
_KEY_COLUMNS = 8
_ACTS = [each.value for each in GuardStatus if each is not GuardStatus.PASSED]
_MARKS = {"command": ("v", "#0077BB"), "failsafe": ("D", FAIL), "guard": ("o", INK)}
_FAULT_MARK = ("X", "#AA4499")
_LABELLED_SHARE = 0.08
_GUARDING_GAP_S = 1.0
# Minimum length of a bar as a share of the flight, so that it is visible.
_SEEN_SHARE = 0.004
# Names of faults nearer to each other than this share of the flight stand in two rows.
_NAMED_SHARE = 0.18


def lanes_height_in(record: FlightRecord) -> float:
    """Return the height of the timeline of a flight."""
    vehicles = len(record.vehicles)
    return 0.7 + (_LANE_IN if vehicles <= 6 else _SLIM_LANE_IN) * (max(vehicles, 2) + bool(record.faults))


def draw_lanes(axes: "Axes", sheet: Sheet, evidence: FlightEvidence) -> None:
    """Draw one lane per vehicle, the first one at the top, below that of the injected faults."""
    title(axes, "Timeline", "")
    record = sheet.record
    ids = [track.vehicle_id for track in record.vehicles]
    faults = [-1] if record.faults else []
    axes.set(xlabel="time [s]", ylabel="vehicle")
    axes.set_yticks([*faults, *range(len(ids))], [*("faults" for _ in faults), *map(str, ids)])
    axes.set_ylim(len(ids) - 0.5, -0.5 - len(faults))
    axes.set_xlim(float(record.time_s[0]), float(record.time_s[-1]))
    axes.grid(visible=False, axis="y")
    for lane, track in enumerate(record.vehicles):
        _draw_tactics(axes, record, track, lane)
        _mark_engagement(axes, sheet, lane)
    least_s = _SEEN_SHARE * float(record.time_s[-1] - record.time_s[0])
    for lane, vehicle in enumerate(evidence.vehicles):
        acts = vehicle.loop.time_s[np.isin(vehicle.loop.guard, _ACTS)]
        axes.broken_barh(_spans(acts, least_s), (lane + 0.25, 0.16), color=INK, linewidth=0, zorder=4)
    for kind, mark in _marks(evidence).items():
        events = [event for event in record.events if event.kind == kind and event.vehicle in ids]
        lanes = [ids.index(event.vehicle) + (0.33 if kind == "guard" else -0.31) for event in events]
        _mark(axes, [event.time_s for event in events], lanes, mark)
    _draw_faults(axes, record)
    _draw_key(axes, sheet, evidence)


def _mark(axes: "Axes", times_s: Sequence[float], lanes: Sequence[float], mark: tuple[str, str]) -> None:
    marker, colour = mark
    edge: dict[str, Any] = {"markersize": 6, "markeredgecolor": "white", "markeredgewidth": 0.6}
    if times_s:
        axes.plot(times_s, lanes, marker, color=colour, linestyle="", zorder=6, clip_on=False, **edge)


def _mark_engagement(axes: "Axes", sheet: Sheet, lane: int) -> None:
    engaged_s = sheet.result.vehicles[lane].engaged_at_s
    if engaged_s is not None:
        axes.plot(engaged_s, lane, color=INK, zorder=5, clip_on=False, **ENGAGED)


def _draw_faults(axes: "Axes", record: FlightRecord) -> None:
    """Mark each injected fault by its name, and draw a line from there through the lanes."""
    _mark(axes, [each.at_s for each in record.faults], [-1.0] * len(record.faults), _FAULT_MARK)
    begin_s, end_s = axes.get_xlim()
    row, last_s = 0, -np.inf
    for name, at_s, vehicle, _ in sorted(record.faults, key=lambda fault: fault.at_s):
        row = 1 - row if at_s - last_s < _NAMED_SHARE * (end_s - begin_s) else 0
        last_s = at_s
        is_late = at_s > begin_s + (1.0 - _NAMED_SHARE) * (end_s - begin_s)
        axes.axvline(at_s, color=_FAULT_MARK[1], linewidth=0.8, linestyle=(0, (2, 2)), zorder=1)
        axes.annotate(
            name if vehicle is None else f"{name}: {vehicle}",
            (at_s, -1.0),
            xytext=(-6 if is_late else 6, 5 - 10 * row),
            textcoords="offset points",
            ha="right" if is_late else "left",
            va="center",
            fontsize=9,
            color=INK,
        )


def _marks(evidence: FlightEvidence) -> dict[str, tuple[str, str]]:
    """Return the marker of each kind of event; guard events are drawn as bars where their duration is known."""
    barred = any(vehicle.loop.guard.size for vehicle in evidence.vehicles)
    return {kind: mark for kind, mark in _MARKS.items() if not (barred and kind == "guard")}


def runs(track: VehicleTrack, record: FlightRecord) -> list[tuple[float, float, str]]:
    """Return the periods of one tactic: begin [s], end [s], tactic."""
    if not record.time_s.size:
        return []
    changed = np.flatnonzero(track.tactic[1:] != track.tactic[:-1]) + 1
    bounds = [0, *changed.tolist(), record.time_s.size - 1]
    return [
        (float(record.time_s[first]), float(record.time_s[last]), str(track.tactic[first]))
        for first, last in pairwise(bounds)
    ]


def _draw_tactics(axes: "Axes", record: FlightRecord, track: VehicleTrack, lane: int) -> None:
    whole_s = float(record.time_s[-1] - record.time_s[0])
    for from_s, to_s, tactic in runs(track, record):
        colour = TACTIC_COLOURS.get(tactic, "white")
        axes.barh(lane, to_s - from_s, 0.44, left=from_s, color=colour, edgecolor="white", linewidth=0.8, zorder=2)
        if to_s - from_s > _LABELLED_SHARE * whole_s and tactic != NO_TACTIC:
            axes.text((from_s + to_s) / 2.0, lane, tactic, ha="center", va="center", fontsize=9, color=INK, zorder=3)


def _spans(time_s: "np.ndarray[tuple[int], np.dtype[np.float64]]", least_s: float) -> list[tuple[float, float]]:
    """Join times into spans (start, length) [s]."""
    if not time_s.size:
        return []
    breaks = np.flatnonzero(np.diff(time_s) > _GUARDING_GAP_S) + 1
    return [(float(part[0]), max(float(part[-1] - part[0]), least_s)) for part in np.split(time_s, breaks)]


def key_rows(sheet: Sheet, evidence: FlightEvidence) -> int:
    """Return the number of rows of the legend below the lanes."""
    return -(-_key_entries(sheet, evidence) // _KEY_COLUMNS)


def _key_entries(sheet: Sheet, evidence: FlightEvidence) -> int:
    return len(_tactics(sheet.record)) + len(_kinds(sheet, evidence)) + _guarded(evidence)


def _tactics(record: FlightRecord) -> dict[str, str]:
    recorded = {str(tactic) for track in record.vehicles for tactic in np.unique(track.tactic)}
    return {tactic: colour for tactic, colour in TACTIC_COLOURS.items() if tactic in recorded}


def _kinds(sheet: Sheet, evidence: FlightEvidence) -> dict[str, dict[str, Any]]:
    """Return the style of each mark on the timeline by its name."""
    recorded = {event.kind for event in sheet.record.events}
    marks: dict[str, tuple[str, str]] = {kind: mark for kind, mark in _marks(evidence).items() if kind in recorded}
    if sheet.record.faults:
        marks["fault"] = _FAULT_MARK
    styles: dict[str, dict[str, Any]] = {kind: {"marker": mark, "color": ink} for kind, (mark, ink) in marks.items()}
    if any(vehicle.engaged_at_s is not None for vehicle in sheet.result.vehicles):
        styles["engages"] = {"color": INK, **ENGAGED}
    return styles


def _guarded(evidence: FlightEvidence) -> bool:
    return any(np.isin(vehicle.loop.guard, _ACTS).any() for vehicle in evidence.vehicles)


def _draw_key(axes: "Axes", sheet: Sheet, evidence: FlightEvidence) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    handles: list[Line2D | Patch] = [
        Patch(facecolor=colour, label=tactic, edgecolor=FAINT, linewidth=0.4)
        for tactic, colour in _tactics(sheet.record).items()
    ]
    handles += [Line2D([], [], linestyle="", label=kind, **style) for kind, style in _kinds(sheet, evidence).items()]
    if _guarded(evidence):
        handles.append(Patch(color=INK, label="guard intervention"))
    axes.figure.legend(
        handles=handles,
        loc="lower center",
        ncols=-(-len(handles) // key_rows(sheet, evidence)),
        frameon=False,
        handlelength=1.1,
        columnspacing=1.0,
        handletextpad=0.5,
    )
