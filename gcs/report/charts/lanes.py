"""The timeline of a flight: a lane for each vehicle with its tactics, commands, failsafes and guard interventions."""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from gcs.metrics.record import FlightRecord, VehicleTrack
from gcs.report.charts.panels import title
from gcs.report.evidence.flight import FlightEvidence
from gcs.style import FAIL, FAINT, INK, TACTIC_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LANE_IN, _SLIM_LANE_IN = 0.42, 0.3
_KEY_COLUMNS = 4
_ACTS = ("changed", "yielded", "braked")
_MARKS = {"command": ("v", "#0077BB"), "failsafe": ("D", FAIL), "guard": ("o", INK)}
_LABELLED_SHARE = 0.16
_GUARDING_GAP_S = 1.0
# Minimum length of a bar as a share of the flight, so that it is visible.
_SEEN_SHARE = 0.004


def lanes_height_in(vehicles: int) -> float:
    """Return the height of the timeline of a number of vehicles."""
    return 0.7 + (_LANE_IN if vehicles <= 6 else _SLIM_LANE_IN) * max(vehicles, 2)


def draw_lanes(axes: "Axes", record: FlightRecord, evidence: FlightEvidence) -> None:
    """Draw one lane per vehicle, the first one at the top."""
    title(axes, "Timeline", "")
    ids = [track.vehicle_id for track in record.vehicles]
    axes.set(xlabel="time [s]", ylabel="vehicle", yticks=range(len(ids)), yticklabels=list(map(str, ids)))
    axes.set_ylim(len(ids) - 0.5, -0.5)
    axes.set_xlim(float(record.time_s[0]), float(record.time_s[-1]))
    axes.grid(visible=False, axis="y")
    for lane, track in enumerate(record.vehicles):
        _draw_tactics(axes, record, track, lane)
    least_s = _SEEN_SHARE * float(record.time_s[-1] - record.time_s[0])
    for lane, vehicle in enumerate(evidence.vehicles):
        acts = vehicle.loop.time_s[np.isin(vehicle.loop.guard, _ACTS)]
        axes.broken_barh(_spans(acts, least_s), (lane + 0.25, 0.16), color=INK, linewidth=0, zorder=4)
    for kind, (marker, colour) in _marks(evidence).items():
        events = [event for event in record.events if event.kind == kind and event.vehicle in ids]
        if events:
            axes.plot(
                [event.time_s for event in events],
                [ids.index(event.vehicle) + (0.33 if kind == "guard" else -0.31) for event in events],
                marker,
                color=colour,
                markersize=6,
                markeredgecolor="white",
                markeredgewidth=0.6,
                linestyle="",
                zorder=6,
                clip_on=False,
            )
    _draw_key(axes, record, evidence)


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
        if to_s - from_s > _LABELLED_SHARE * whole_s and tactic != "unknown":
            axes.text((from_s + to_s) / 2.0, lane, tactic, ha="center", va="center", fontsize=9, color=INK, zorder=3)


def _spans(time_s: "np.ndarray[tuple[int], np.dtype[np.float64]]", least_s: float) -> list[tuple[float, float]]:
    """Join times into spans (start, length) [s]."""
    if not time_s.size:
        return []
    breaks = np.flatnonzero(np.diff(time_s) > _GUARDING_GAP_S) + 1
    return [(float(part[0]), max(float(part[-1] - part[0]), least_s)) for part in np.split(time_s, breaks)]


def key_rows(record: FlightRecord, evidence: FlightEvidence) -> int:
    """Return the number of rows of the legend below the lanes."""
    return -(-(len(_tactics(record)) + len(_kinds(record, evidence)) + _guarded(evidence)) // _KEY_COLUMNS)


def _tactics(record: FlightRecord) -> dict[str, str]:
    recorded = {str(tactic) for track in record.vehicles for tactic in np.unique(track.tactic)}
    return {tactic: colour for tactic, colour in TACTIC_COLOURS.items() if tactic in recorded}


def _kinds(record: FlightRecord, evidence: FlightEvidence) -> dict[str, tuple[str, str]]:
    recorded = {event.kind for event in record.events}
    return {kind: mark for kind, mark in _marks(evidence).items() if kind in recorded}


def _guarded(evidence: FlightEvidence) -> bool:
    return any(np.isin(vehicle.loop.guard, _ACTS).any() for vehicle in evidence.vehicles)


def _draw_key(axes: "Axes", record: FlightRecord, evidence: FlightEvidence) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415
    from matplotlib.patches import Patch  # noqa: PLC0415

    handles: list[Line2D | Patch] = [
        Patch(facecolor=colour, label=tactic, edgecolor=FAINT, linewidth=0.4)
        for tactic, colour in _tactics(record).items()
    ]
    handles += [
        Line2D([], [], marker=marker, color=colour, linestyle="", label=kind)
        for kind, (marker, colour) in _kinds(record, evidence).items()
    ]
    if _guarded(evidence):
        handles.append(Patch(color=INK, label="guard intervention"))
    axes.figure.legend(
        handles=handles,
        loc="lower center",
        ncols=_KEY_COLUMNS,
        frameon=False,
        handlelength=1.1,
        columnspacing=1.0,
        handletextpad=0.5,
    )
