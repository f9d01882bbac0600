"""The timeline of one vehicle's flight: its events from the log, each with the values that caused it."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from agents.control.lmpc import QpStatus
from agents.inputs import AutopilotStatus
from estimation.state import Telemetry
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import Decision
from gcs.flightlog.run import mission_of
from gcs.replay.event_detectors import (
    AutopilotEvents,
    EventDetector,
    GuardEvents,
    LoopEvents,
    Neighbour,
    NoteEvents,
    PeerEvents,
    PlanFailures,
    ReceivedInputs,
    RingEvents,
    TargetEvents,
    TelemetryGaps,
    TimelineEntry,
    changed_setpoint,
)
from gcs.replay.playback import MissingRecords, Turn, config_of, turns

FOLDED_FROM, KEPT = 5, 2
"""This many similar entries or more are folded: the first `KEPT` stay, one entry represents the rest."""


@dataclass(slots=True)
class VehicleSummary:
    """A vehicle's flight in figures: seconds by tactic, the closest peer, and counts of faults."""

    seconds: dict[str, float] = field(default_factory=dict)
    nearest: Neighbour | None = None
    nearest_s: float | None = None
    decisions: int = 0
    guarded: int = 0
    fallbacks: int = 0
    skipped: int = 0
    refused_messages: int = 0
    telemetry_gap_max_s: float = 0.0
    battery: tuple[float, ...] = ()
    alerts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Timeline:
    """One vehicle's entries in order of time, on the core's clock; the mission began at `start_s` of it."""

    mission: str
    vehicle_id: int
    start_s: float | None
    entries: tuple[TimelineEntry, ...]
    summary: VehicleSummary


def timeline_of(log: FlightLog, vehicle_id: int) -> Timeline:
    """Return the timeline of a recorded vehicle; raises LogError where the log does not hold the mission."""
    config = config_of(log, mission_of(log), vehicle_id)
    detectors: tuple[EventDetector, ...] = (
        AutopilotEvents(),
        PeerEvents(),
        TargetEvents(),
        NoteEvents(),
        RingEvents(),
        GuardEvents(),
        PlanFailures(),
        TelemetryGaps(),
        LoopEvents(),
    )
    received, counts, entries, now_s = ReceivedInputs(), _Counts(1.0 / config.rate_hz), list[TimelineEntry](), 0.0
    for turn in turns(log, vehicle_id):
        if isinstance(turn, MissingRecords):
            entries.append(TimelineEntry(now_s, "log", f"{turn.reason}: no data for this part"))
            continue
        now_s = now_s if turn.tick is None else turn.tick.now_s
        received.take(turn)
        counts.take(turn, received)
        for detector in detectors:
            entries += detector.update(turn, received)
    for detector in detectors:
        entries += detector.end()
    if received.last is not None:
        entries.append(TimelineEntry(now_s, "log", f"log ends in tactic {received.last.tactic}"))
    entries.sort(key=lambda entry: entry.time_s)
    return Timeline(
        log.run.mission, vehicle_id, received.start_s, tuple(folded(entries, received.start_s)), counts.summary
    )


def folded(entries: Sequence[TimelineEntry], start_s: float | None) -> Iterator[TimelineEntry]:
    """Return the entries, with similar ones folded into a count."""
    alike: defaultdict[str, list[TimelineEntry]] = defaultdict(list)
    for entry in entries:
        alike[_key(entry)].append(entry)
    counted: Counter[str] = Counter()
    for entry in entries:
        group, key = alike[_key(entry)], _key(entry)
        counted[key] += 1
        if len(group) < FOLDED_FROM or counted[key] <= KEPT:
            yield entry
        elif counted[key] == KEPT + 1:
            until = f"until {group[-1].time_s - (start_s or 0.0):.1f} s"
            yield entry._replace(text=f"... {len(group) - KEPT} similar entries {until}, the first: {entry.text}")


def _key(entry: TimelineEntry) -> str:
    return entry.key or f"{entry.kind} {entry.text}"


class _Counts:
    """Counts the figures of the summary turn by turn."""

    def __init__(self, period_s: float) -> None:
        self.summary = VehicleSummary()
        self._period_s = period_s
        self._before: Decision | None = None
        self._telemetry_s: float | None = None

    def take(self, turn: Turn, received: ReceivedInputs) -> None:
        for item in turn.inputs:
            if isinstance(item, Telemetry):
                gap_s = 0.0 if self._telemetry_s is None else item.time_s - self._telemetry_s
                self.summary.telemetry_gap_max_s = max(self.summary.telemetry_gap_max_s, gap_s)
                self._telemetry_s = item.time_s
            elif isinstance(item, AutopilotStatus) and item.status.battery is not None:
                self.summary.battery = (*self.summary.battery[:1], item.status.battery)
        if turn.tick is not None:
            self.summary.skipped += received.late_ticks
        if turn.decision is not None:
            self._decide(turn.decision, received)

    def _decide(self, decision: Decision, received: ReceivedInputs) -> None:
        summary, before = self.summary, self._before
        summary.decisions += 1
        summary.guarded += changed_setpoint(decision)
        summary.fallbacks += decision.qp == QpStatus.FALLBACK.value
        summary.refused_messages = decision.messages_dropped
        if decision.alert and decision.alert not in summary.alerts:
            summary.alerts += (decision.alert,)
        if before is not None:
            took_s = decision.time_s - before.time_s
            summary.seconds[before.tactic] = summary.seconds.get(before.tactic, 0.0) + took_s
        nearest = received.nearest(decision)
        if nearest and (summary.nearest is None or nearest.distance_m < summary.nearest.distance_m):
            summary.nearest, summary.nearest_s = nearest, decision.time_s
        self._before = decision


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
