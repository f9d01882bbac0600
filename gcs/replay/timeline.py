"""The timeline of one vehicle's flight: its events from the log, each with the values that caused it."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

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
    NoteEvents,
    PeerEvents,
    PlanFailures,
    RingEvents,
    TargetEvents,
    TelemetryGaps,
    TimelineEntry,
    changed_setpoint,
)
from gcs.replay.playback import MissingRecords, Turn, config_of, turns
from gcs.replay.received_inputs import Neighbour, ReceivedInputs

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
