"""What people and machines see of a story."""

from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gcs.replay.story import Story, Summary

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


def story_view(story: Story) -> RenderableType:
    """Return a story for people: a line for each thing that happened, below it what it hung on."""
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column()
    for line in story.lines:
        style = _STYLES.get(line.kind, "")
        told = Text(line.text, style=style if style != "dim" else "")
        if line.because:
            told.append(f"\n{line.because}", style="dim not bold")
        table.add_row(Text(_when(line.time_s, story)), Text(line.kind, style=style), told)
    headline = Text.assemble((f"vehicle {story.vehicle_id}", "bold"), (f" of {story.mission}, in mission time", "dim"))
    first, second = summary_lines(story)
    return Group(headline, table, Text(), Text(first, style="bold"), Text(second))


def story_dict(story: Story) -> dict[str, Any]:
    """Return a story as plain data; times are mission time."""
    start_s, summary = story.start_s or 0.0, story.summary
    return {
        "vehicle": story.vehicle_id,
        "lines": [
            {"time_s": line.time_s - start_s, "kind": line.kind, "text": line.text, "because": line.because}
            for line in story.lines
        ],
        "summary": list(summary_lines(story)),
        "seconds": summary.seconds,
    }


def summary_lines(story: Story) -> tuple[str, str]:
    """Return a flight in two sentences: what it did, and how well that went."""
    summary = story.summary
    did = ", ".join(f"{seconds:.1f} s {tactic}" for tactic, seconds in summary.seconds.items()) or "nothing"
    near = "nobody near"
    if summary.nearest is not None and summary.nearest_s is not None:
        when = _when(summary.nearest_s, story)
        near = f"nearest: vehicle {summary.nearest.vehicle_id}, {summary.nearest.distance_m:.2f} m away, at {when}"
    return f"In short: {did}; {near}.", f"{'; '.join(_well(summary))}."


def _well(summary: Summary) -> list[str]:
    parts = [f"Guard: {summary.guarded} of {summary.decisions} setpoints changed"]
    parts.append(f"alerts: {', '.join(summary.alerts)}" if summary.alerts else "no alert")
    parts.append(f"{summary.fallbacks} plans failed")
    parts.append(f"{summary.skipped} ticks skipped")
    parts.append(f"longest wait for telemetry {summary.telemetry_gap_max_s:.2f} s")
    parts.append(f"{summary.refused_messages} messages refused")
    if summary.battery:
        parts.append(f"battery {' -> '.join(f'{each:.0%}' for each in summary.battery)}")
    return parts


def _when(time_s: float, story: Story) -> str:
    if story.start_s is None:
        return "before"
    return f"{time_s - story.start_s:.1f} s"
