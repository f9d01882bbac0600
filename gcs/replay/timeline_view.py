"""The timeline of a vehicle as a table for a terminal and as JSON data."""

from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gcs.replay.timeline import Timeline, VehicleSummary

_STYLES = {
    "tactic": "bold magenta",
    "ring": "magenta",
    "command": "bold cyan",
    "failsafe": "bold red",
    "guard": "yellow",
    "plan": "yellow",
    "link": "yellow",
    "loop": "yellow",
    "target": "green",
    "team": "blue",
    "autopilot": "dim",
    "log": "dim",
}


def timeline_view(timeline: Timeline) -> RenderableType:
    """Return a timeline for a terminal: one line per event, and below it the values that caused it."""
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    for entry in timeline.entries:
        style = _STYLES.get(entry.kind, "")
        cell = Text(entry.text, style=style if style != "dim" else "")
        if entry.because:
            cell.append(f"\n{entry.because}", style="dim not bold")
        table.add_row(Text(_when(entry.time_s, timeline)), Text(entry.kind, style=style), cell)
    headline = Text.assemble(
        (f"vehicle {timeline.vehicle_id}", "bold"), (f" of {timeline.mission}, in mission time", "dim")
    )
    first, second = summary_lines(timeline)
    return Group(headline, table, Text(), Text(first, style="bold"), Text(second))


def timeline_dict(timeline: Timeline) -> dict[str, Any]:
    """Return a timeline as plain data; times are mission time."""
    start_s, summary = timeline.start_s or 0.0, timeline.summary
    return {
        "vehicle": timeline.vehicle_id,
        "lines": [
            {"time_s": entry.time_s - start_s, "kind": entry.kind, "text": entry.text, "because": entry.because}
            for entry in timeline.entries
        ],
        "summary": list(summary_lines(timeline)),
        "seconds": summary.seconds,
    }


def summary_lines(timeline: Timeline) -> tuple[str, str]:
    """Return the summary in two sentences: time by tactic, and counts of faults."""
    summary = timeline.summary
    did = ", ".join(f"{seconds:.1f} s {tactic}" for tactic, seconds in summary.seconds.items()) or "nothing"
    near = "no peer in range"
    if summary.nearest is not None and summary.nearest_s is not None:
        when = _when(summary.nearest_s, timeline)
        near = f"closest peer: vehicle {summary.nearest.vehicle_id}, {summary.nearest.distance_m:.2f} m at {when}"
    return f"Summary: {did}; {near}.", f"{'; '.join(_fault_counts(summary))}."


def _fault_counts(summary: VehicleSummary) -> list[str]:
    parts = [f"Guard: moved {summary.guarded} of {summary.decisions} setpoints"]
    parts.append(f"alerts: {', '.join(summary.alerts)}" if summary.alerts else "no alert")
    parts.append(f"{summary.fallbacks} failed plans")
    parts.append(f"{summary.skipped} skipped ticks")
    parts.append(f"longest telemetry gap {summary.telemetry_gap_max_s:.2f} s")
    parts.append(f"{summary.refused_messages} refused messages")
    if summary.battery:
        parts.append(f"battery {' -> '.join(f'{each:.0%}' for each in summary.battery)}")
    return parts


def _when(time_s: float, timeline: Timeline) -> str:
    if timeline.start_s is None:
        return "before start"
    return f"{time_s - timeline.start_s:.1f} s"
