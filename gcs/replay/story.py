"""The story of one vehicle's flight: what its log says of each thing that happened, and the numbers it hung on."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from agents.control.lmpc import QpStatus
from agents.tape import Autopilot
from estimation.state import Telemetry
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import Decision
from gcs.flightlog.run import mission_of
from gcs.replay.playback import (
    Gap,
    Turn,
    config_of,
    turns,
)
from gcs.replay.scene import Neighbour, Scene
from gcs.replay.witnesses import (
    AutopilotWitness,
    GuardWitness,
    Line,
    LoopWitness,
    Notes,
    Peers,
    Plans,
    Ring,
    Target,
    TelemetryGaps,
    Witness,
    changed_setpoint,
)

FOLDED_FROM, KEPT = 5, 2
"""So many lines that are alike are folded: the first few stay, one stands for the rest."""


@dataclass(slots=True)
class Summary:
    """A flight in figures: ticks, seconds by tactic, the nearest that anybody came, and what went wrong how often."""

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
class Story:
    """Of one vehicle: lines in the order of time, on a core's clock on which the mission began at `start_s`."""

    mission: str
    vehicle_id: int
    start_s: float | None
    lines: tuple[Line, ...]
    summary: Summary


def story_of(log: FlightLog, vehicle_id: int) -> Story:
    """Tell the story of a recorded vehicle; raises LogError where the log does not say what was flown."""
    config = config_of(log, mission_of(log), vehicle_id)
    witnesses: tuple[Witness, ...] = (
        AutopilotWitness(),
        Peers(),
        Target(),
        Notes(),
        Ring(),
        GuardWitness(),
        Plans(),
        TelemetryGaps(),
        LoopWitness(),
    )
    scene, count, lines, now_s = Scene(), _Counts(1.0 / config.rate_hz), list[Line](), 0.0
    for turn in turns(log, vehicle_id):
        if isinstance(turn, Gap):
            lines.append(Line(now_s, "log", f"{turn.reason}: what happened there is not known"))
            continue
        now_s = now_s if turn.tick is None else turn.tick.now_s
        scene.take(turn)
        count.take(turn, scene)
        for witness in witnesses:
            lines += witness.see(turn, scene)
    for witness in witnesses:
        lines += witness.end()
    if scene.last is not None:
        lines.append(Line(now_s, "log", f"the record ends: {scene.last.tactic}"))
    lines.sort(key=lambda line: line.time_s)
    return Story(log.run.mission, vehicle_id, scene.start_s, tuple(folded(lines, scene.start_s)), count.summary)


def folded(lines: Sequence[Line], start_s: float | None) -> Iterator[Line]:
    """Return lines in which those that are alike are told a few times, and then counted."""
    alike: defaultdict[str, list[Line]] = defaultdict(list)
    for line in lines:
        alike[_key(line)].append(line)
    seen: Counter[str] = Counter()
    for line in lines:
        group, key = alike[_key(line)], _key(line)
        seen[key] += 1
        if len(group) < FOLDED_FROM or seen[key] <= KEPT:
            yield line
        elif seen[key] == KEPT + 1:
            until = f"until {group[-1].time_s - (start_s or 0.0):.1f} s"
            yield line._replace(text=f"... {len(group) - KEPT} more like these {until}, the first of them: {line.text}")


def _key(line: Line) -> str:
    return line.key or f"{line.kind} {line.text}"


class _Counts:
    """Counts along the way what a summary says."""

    def __init__(self, period_s: float) -> None:
        self.summary = Summary()
        self._period_s = period_s
        self._before: Decision | None = None
        self._telemetry_s: float | None = None

    def take(self, turn: Turn, scene: Scene) -> None:
        for item in turn.inputs:
            if isinstance(item, Telemetry):
                gap_s = 0.0 if self._telemetry_s is None else item.time_s - self._telemetry_s
                self.summary.telemetry_gap_max_s = max(self.summary.telemetry_gap_max_s, gap_s)
                self._telemetry_s = item.time_s
            elif isinstance(item, Autopilot) and item.status.battery is not None:
                self.summary.battery = (*self.summary.battery[:1], item.status.battery)
        if turn.tick is not None:
            self.summary.skipped += scene.late_ticks
        if turn.decision is not None:
            self._decide(turn.decision, scene)

    def _decide(self, decision: Decision, scene: Scene) -> None:
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
        nearest = scene.nearest(decision)
        if nearest and (summary.nearest is None or nearest.distance_m < summary.nearest.distance_m):
            summary.nearest, summary.nearest_s = nearest, decision.time_s
        self._before = decision
