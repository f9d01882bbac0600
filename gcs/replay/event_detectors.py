"""Detectors of the events in a vehicle's timeline: each one follows one quantity turn by turn."""

from collections.abc import Iterator, Sequence
from math import degrees, hypot, inf
from typing import NamedTuple, Protocol

from agents.control.lmpc import QpStatus
from agents.inputs import AutopilotStatus, Bus, LateTicks, Message, Start, TacticEvent, TimeScale
from agents.ports import VehicleStatus
from agents.safety.guard import QUIET_S, GuardStatus
from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.state import Sighting, Telemetry, place_text
from gcs.flightlog.records import Decision
from gcs.replay.playback import Turn


class Neighbour(NamedTuple):
    """A peer and its distance, extrapolated with the velocity that the peer reported."""

    vehicle_id: int
    distance_m: float


class ReceivedInputs:
    """Accumulates a vehicle's inputs turn by turn."""

    def __init__(self) -> None:
        self.start_s: float | None = None
        self.time_scale = 1.0
        self.height_m = 0.0
        self.late_ticks = 0
        self.last: Decision | None = None
        self.members: dict[int, MemberState] = {}

    def take(self, turn: Turn) -> None:
        """Add the next turn."""
        for item in turn.inputs:
            match item:
                case Start():
                    self.start_s = item.at_s
                case TimeScale():
                    self.time_scale = item.factor
                case LateTicks():
                    self.late_ticks = item.count
                case Telemetry():
                    self.height_m = item.position_m[2]
                case Message(message=MemberState() as state):
                    self.members[state.sender] = state
        if self.last is not None and self.last.tactic == Tactic.LAND.value:
            self.late_ticks = 0  # ticks during a landing have no fixed rate: late ones are not counted
        self.last = turn.decision or self.last

    def nearest(self, decision: Decision) -> Neighbour | None:
        """Return the nearest member among the peers of a decision, None without peers or without an own estimate."""
        if decision.own is None:
            return None
        x, y = decision.own.mean[:2]
        nearest = None
        for member in (self.members[peer] for peer in decision.peers if peer in self.members):
            age_s = decision.time_s - member.time_s
            away_x, away_y = (
                there + rate * age_s - here
                for there, rate, here in zip(member.position_m, member.velocity_m_s, (x, y), strict=True)
            )
            distance_m = hypot(away_x, away_y, member.altitude_m - self.height_m)
            if distance_m < (nearest.distance_m if nearest else inf):
                nearest = Neighbour(member.sender, distance_m)
        return nearest


TELEMETRY_GAP_S = 0.5
"""Wall seconds: at this gap several samples are missing."""


class TimelineEntry(NamedTuple):
    """An entry of the timeline: its time on the core's clock, kind, text, and the values that caused it.

    Entries of one `key` are alike: many of them are folded into one.
    """

    time_s: float
    kind: str
    text: str
    because: str = ""
    key: str = ""


class EventDetector(Protocol):
    """Detects one kind of event."""

    def update(self, turn: Turn, received: ReceivedInputs, /) -> Iterator[TimelineEntry]:
        """Return the events of a turn; `received` already includes it."""
        ...

    def end(self) -> Iterator[TimelineEntry]:
        """Return the events that were still active at the end of the log."""
        ...


class MomentaryDetector:
    """A detector of momentary events: none is active at the end of the log."""

    def end(self) -> Iterator[TimelineEntry]:
        """Return no event."""
        return iter(())


class NoteEvents(MomentaryDetector):
    """Notes of the vehicle: tactics, commands, failsafes; a change of tactic with the vehicle's position."""

    def update(self, turn: Turn, received: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        decision = turn.decision
        if decision is None:
            return
        events = [item.event.value for item in turn.inputs if isinstance(item, TacticEvent)]
        for note in decision.notes:
            if note.kind == "guard":
                continue  # GuardEvents covers these
            because = [note.because] if note.because else []
            if note.kind == "tactic":
                if note.tactic is not None and note.tactic.event in events:
                    because.append("requested outside the control core")
                if decision.own is not None:
                    because.append(f"at {place_text(decision.own.mean[:2])} m, height {received.height_m:.1f} m")
            yield TimelineEntry(note.time_s, note.kind, note.text, "; ".join(because))


class RingEvents(MomentaryDetector):
    """Changes of the number of vehicles on the ring, and the vehicle's spacing to its neighbours."""

    def __init__(self) -> None:
        self._members = 0

    def update(self, turn: Turn, _: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        decision = turn.decision
        if decision is None:
            return
        spot = decision.place
        members = 0 if spot is None else spot.members
        if members != self._members and spot is not None and decision.polar is not None:
            verb = "joins" if not self._members else "is now on"
            around = (
                "alone"
                if spot.lead_rad is None or spot.lag_rad is None
                else f"spacing {degrees(spot.lead_rad):.1f}° ahead, {degrees(spot.lag_rad):.1f}° behind "
                f"(even: {360.0 / members:.0f}°)"
            )
            because = f"{around}; radius {decision.polar.radius_m:.2f} m"
            yield TimelineEntry(decision.time_s, "ring", f"{verb} a ring of {members}", because)
        self._members = members


class PeerEvents(MomentaryDetector):
    """Changes of the peers that the vehicle takes into account."""

    def __init__(self) -> None:
        self._peers: frozenset[int] = frozenset()

    def update(self, turn: Turn, received: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        decision = turn.decision
        if decision is None or self._peers.symmetric_difference(decision.peers) == set():
            return
        peers = frozenset(decision.peers)
        new, gone = sorted(peers - self._peers), sorted(self._peers - peers)
        if new:
            yield TimelineEntry(
                decision.time_s, "team", f"{_vehicles(new)} added to the peers", _positions(new, received)
            )
        if gone:
            text = f"{_vehicles(gone)} removed from the peers"
            yield TimelineEntry(decision.time_s, "team", text, _last_messages(gone, received, decision.time_s))
        self._peers = peers


class TargetEvents(MomentaryDetector):
    """The target's estimate, available and lost, with the source of the sightings."""

    def __init__(self) -> None:
        self._known = False
        self._ever = False
        self._sighted_s = 0.0

    def update(self, turn: Turn, _: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        decision = turn.decision
        if decision is None:
            return
        if decision.target is not None:
            self._sighted_s = decision.target.sighted_s
        if (decision.target is not None) == self._known:
            return
        target, self._known = decision.target, not self._known
        if target is None:
            because = f"last accepted sighting {decision.time_s - self._sighted_s:.1f} s ago"
            yield TimelineEntry(decision.time_s, "target", "target lost", because)
            return
        again, self._ever = " again" if self._ever else "", True
        sigma_m = max(target.covariance[0], target.covariance[5]) ** 0.5
        away = ""
        if decision.own is not None:
            x, y = decision.own.mean[:2]
            away = f", distance {hypot(target.mean[0] - x, target.mean[1] - y):.2f} m"
        because = (
            f"{_sighted_by(turn)}: at {place_text(target.mean[:2])} m (σ {sigma_m:.2f} m){away}; "
            f"importance {target.importance:.3f}, threat {target.threat:.3f}"
        )
        yield TimelineEntry(decision.time_s, "target", f"target estimate available{again}", because)


class GuardEvents:
    """Interventions of the guard: causes, duration, and the closest peer."""

    def __init__(self) -> None:
        self._begin_s = self._last_s = 0.0
        self._changed = 0
        self._causes: dict[str, None] = {}
        self._most_severe = ""
        self._moved = ""
        self._nearest: Neighbour | None = None

    def update(self, turn: Turn, received: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        decision = turn.decision
        if decision is None or decision.guard is None or not decision.guard.causes:
            return
        if self._changed and decision.time_s - self._last_s > QUIET_S:
            yield from self.end()
        if not self._changed:
            self._begin_s, self._nearest, self._most_severe, self._causes = decision.time_s, None, "", {}
            self._moved = next((note.because for note in decision.notes if note.kind == "guard"), "")
        self._changed += 1
        self._last_s = decision.time_s
        self._causes |= dict.fromkeys(decision.guard.causes)
        match decision.guard.status:
            case GuardStatus.YIELDED.value:
                self._most_severe = f"the guard relaxed constraints, up to {decision.guard.yielded}"
            case GuardStatus.BRAKED.value:
                self._most_severe = "the guard braked to a stop"
        nearest = received.nearest(decision)
        if nearest and (self._nearest is None or nearest.distance_m < self._nearest.distance_m):
            self._nearest = nearest

    def end(self) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        if not self._changed:
            return
        lasting_s, causes = self._last_s - self._begin_s, ", ".join(self._causes)
        near = self._nearest and f"closest peer: vehicle {self._nearest.vehicle_id}, {self._nearest.distance_m:.2f} m"
        because = "; ".join(filter(None, (self._moved, near, self._most_severe)))
        many = "1 setpoint" if self._changed == 1 else f"{self._changed} setpoints in {lasting_s:.1f} s"
        yield TimelineEntry(self._begin_s, "guard", f"guard moved {many} ({causes})", because, f"guard {causes}")
        self._changed = 0


class PlanFailures:
    """Failed plans, during which the fallback plan was flown."""

    def __init__(self) -> None:
        self._times_s: list[float] = []

    def update(self, turn: Turn, _: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        decision = turn.decision
        if decision is None or decision.qp != QpStatus.FALLBACK.value:
            return
        if self._times_s and decision.time_s - self._times_s[-1] > QUIET_S:
            yield from self.end()
        self._times_s.append(decision.time_s)

    def end(self) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        if self._times_s:
            lasting_s = self._times_s[-1] - self._times_s[0]
            text = f"no feasible plan: fallback plan for {len(self._times_s)} ticks in {lasting_s:.1f} s"
            yield TimelineEntry(self._times_s[0], "plan", text, key="plan")
        self._times_s = []


class TelemetryGaps(MomentaryDetector):
    """Gaps in the vehicle's telemetry."""

    def __init__(self) -> None:
        self._received_s: float | None = None

    def update(self, turn: Turn, received: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        for item in turn.inputs:
            if isinstance(item, Telemetry):
                if (
                    self._received_s is not None
                    and item.time_s - self._received_s > TELEMETRY_GAP_S * received.time_scale
                ):
                    text = f"no telemetry for {item.time_s - self._received_s:.2f} s"
                    yield TimelineEntry(self._received_s, "link", text, key="telemetry")
                self._received_s = item.time_s


class LoopEvents:
    """Late ticks, and the state of the bus."""

    def __init__(self) -> None:
        self._begin_s = self._last_s = 0.0
        self._skipped: list[int] = []

    def update(self, turn: Turn, received: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        if turn.tick is None:
            return
        now_s = turn.tick.now_s
        for item in turn.inputs:
            if isinstance(item, Bus):
                yield TimelineEntry(now_s, "link", "bus connected" if item.alive else "bus lost")
        if received.late_ticks:
            if self._skipped and now_s - self._last_s > QUIET_S * received.time_scale:
                yield from self.end()
            if not self._skipped:
                self._begin_s = now_s
            self._skipped.append(received.late_ticks)
            self._last_s = now_s

    def end(self) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        if self._skipped:
            total, lasting_s = sum(self._skipped), self._last_s - self._begin_s
            many = "1 tick" if total == 1 else f"{total} ticks"
            worst = f", at most {max(self._skipped)} in a row" if len(self._skipped) > 1 else ""
            text = f"control loop late: {many} skipped in {lasting_s:.1f} s{worst}"
            yield TimelineEntry(self._begin_s, "loop", text, key="late")
        self._skipped = []


class AutopilotEvents(MomentaryDetector):
    """Changes of the autopilot's status; the battery is added to them, and is not an event of its own."""

    def __init__(self) -> None:
        self._before: tuple[str, ...] = ()

    def update(self, turn: Turn, _: ReceivedInputs) -> Iterator[TimelineEntry]:
        """See EventDetector."""
        for item in turn.inputs:
            if isinstance(item, AutopilotStatus) and turn.tick is not None:
                facts = _facts(item.status)
                changed = [fact for fact in facts if fact and fact not in self._before]
                if changed:
                    battery = item.status.battery
                    because = "" if battery is None else f"battery {battery:.0%}"
                    yield TimelineEntry(turn.tick.now_s, "autopilot", ", ".join(changed), because)
                self._before = facts


def _facts(status: VehicleStatus) -> tuple[str, ...]:
    return (
        "connected" if status.connected else "connection lost",
        "armed" if status.armed else "disarmed",
        "in the air" if status.in_air else "on the ground",
        f"mode {status.mode.value}",
        f"{status.restarts} restarts" if status.restarts else "",
        "" if status.reference.is_known else "origin of its positions is read again",
    )


def _vehicles(ids: Sequence[int]) -> str:
    return f"vehicle {ids[0]}" if len(ids) == 1 else f"vehicles {', '.join(map(str, ids))}"


def _positions(ids: Sequence[int], received: ReceivedInputs) -> str:
    known = [received.members[each] for each in ids if each in received.members]
    return ", ".join(f"{each.sender} in {each.tactic} at {place_text(each.position_m)} m" for each in known)


def _last_messages(ids: Sequence[int], received: ReceivedInputs, now_s: float) -> str:
    known = [received.members[each] for each in ids if each in received.members]
    return ", ".join(f"{each.sender} sent {each.tactic} {now_s - each.time_s:.2f} s ago" for each in known)


def _sighted_by(turn: Turn) -> str:
    """Return the source of the sightings in a turn."""
    if any(isinstance(item, Sighting) for item in turn.inputs):
        return "own sensor"
    messages = (item.message for item in turn.inputs if isinstance(item, Message))
    senders = {each.sender for each in messages if isinstance(each, MemberState) and each.sightings}
    return f"sighted by {_vehicles(sorted(senders))}" if senders else "earlier sightings"


def changed_setpoint(decision: Decision) -> bool:
    """Return whether the guard moved the planned setpoint."""
    return decision.guard is not None and bool(decision.guard.causes)
