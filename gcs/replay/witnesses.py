"""Who tells the story of a vehicle: each witness looks at one thing, turn by turn, and says what is worth a line."""

from collections.abc import Iterator, Sequence
from math import degrees, hypot
from typing import NamedTuple, Protocol

from agents.control.lmpc import QpStatus
from agents.ports import VehicleStatus
from agents.safety.interventions import QUIET_S
from agents.tape import (
    Autopilot,
    Bus,
    Message,
    TacticEvent,
)
from agents.team.messages import TargetPackage
from estimation.state import Sighting, Telemetry
from gcs.flightlog.records import Decision
from gcs.replay.playback import Turn
from gcs.replay.scene import Neighbour, Scene, heard
from gcs.replay.words import place

TELEMETRY_GAP_S = 0.5
"""On the wall's clock: several samples are missing."""
"""What comes again within this time is the same episode."""


class Line(NamedTuple):
    """A line of the story: when on the core's clock, of what kind, what happened, and the numbers it hung on.

    Lines of one `key` are alike: many of them are folded into one.
    """

    time_s: float
    kind: str
    text: str
    because: str = ""
    key: str = ""


class Witness(Protocol):
    """Looks at one thing."""

    def see(self, turn: Turn, scene: Scene, /) -> Iterator[Line]:
        """Look at a turn, after the scene has taken it in."""
        ...

    def end(self) -> Iterator[Line]:
        """Tell what was still going on when the log ended."""
        ...


class Instant:
    """A witness of what happens at one moment: nothing goes on when the log ends."""

    def end(self) -> Iterator[Line]:
        """Tell nothing."""
        return iter(())


class Notes(Instant):
    """What the vehicle noted itself: tactics, commands, failsafes; and where it was when its tactic changed."""

    def see(self, turn: Turn, scene: Scene) -> Iterator[Line]:
        """See Witness."""
        decision = turn.decision
        if decision is None:
            return
        told = [item.event.value for item in turn.inputs if isinstance(item, TacticEvent)]
        for note in decision.notes:
            if note.kind == "guard":
                continue  # its own witness knows how it went on
            because = [note.because] if note.because else []
            if note.kind == "tactic":
                if note.text.rpartition(": ")[2] in told:
                    because.append("told by the program that flies it")
                if decision.own is not None:
                    because.append(f"at {place(decision.own.mean[:2])} m, {scene.height_m:.1f} m high")
            yield Line(note.time_s, note.kind, note.text, "; ".join(because))


class Ring(Instant):
    """How many are on the ring, and where the vehicle stands among them."""

    def __init__(self) -> None:
        self._members = 0

    def see(self, turn: Turn, _: Scene) -> Iterator[Line]:
        """See Witness."""
        decision = turn.decision
        if decision is None:
            return
        spot = decision.place
        members = 0 if spot is None else spot.members
        if members != self._members and spot is not None and decision.polar is not None:
            verb = "enters" if not self._members else "is now in"
            around = (
                "alone"
                if spot.lead_rad is None or spot.lag_rad is None
                else f"{degrees(spot.lead_rad):.1f}° to the one ahead, {degrees(spot.lag_rad):.1f}° to the one behind, "
                f"{360.0 / members:.0f}° would be even"
            )
            because = f"{around}; {decision.polar.radius_m:.2f} m from the target"
            yield Line(decision.time_s, "ring", f"{verb} a ring of {members}", because)
        self._members = members


class Peers(Instant):
    """Whom the vehicle counts on."""

    def __init__(self) -> None:
        self._peers: frozenset[int] = frozenset()

    def see(self, turn: Turn, scene: Scene) -> Iterator[Line]:
        """See Witness."""
        decision = turn.decision
        if decision is None or self._peers.symmetric_difference(decision.peers) == set():
            return
        peers = frozenset(decision.peers)
        new, gone = sorted(peers - self._peers), sorted(self._peers - peers)
        if new:
            yield Line(decision.time_s, "team", f"counts on {_vehicles(new)}", _whereabouts(new, scene))
        if gone:
            text = f"does not count on {_vehicles(gone)} any more"
            yield Line(decision.time_s, "team", text, _last_words(gone, scene, decision.time_s))
        self._peers = peers


class Target(Instant):
    """When the target was seen and lost, and by whom."""

    def __init__(self) -> None:
        self._known = False
        self._ever = False
        self._sighted_s = 0.0

    def see(self, turn: Turn, _: Scene) -> Iterator[Line]:
        """See Witness."""
        decision = turn.decision
        if decision is None:
            return
        if decision.target is not None:
            self._sighted_s = decision.target.sighted_s
        if (decision.target is not None) == self._known:
            return
        belief, self._known = decision.target, not self._known
        if belief is None:
            because = f"last believable sighting {decision.time_s - self._sighted_s:.1f} s before"
            yield Line(decision.time_s, "target", "the target is lost", because)
            return
        again, self._ever = " again" if self._ever else "", True
        sigma_m = max(belief.covariance[0], belief.covariance[5]) ** 0.5
        away = ""
        if decision.own is not None:
            x, y = decision.own.mean[:2]
            away = f", {hypot(belief.mean[0] - x, belief.mean[1] - y):.2f} m away"
        because = (
            f"{_sighted_by(turn)}: at {place(belief.mean[:2])} m to {sigma_m:.2f} m{away}; "
            f"importance {belief.importance:.3f}, threat {belief.threat:.3f}"
        )
        yield Line(decision.time_s, "target", f"the target is known{again}", because)


class GuardWitness:
    """When the guard changed setpoints, why, for how long, and who was near."""

    def __init__(self) -> None:
        self._begin_s = self._last_s = 0.0
        self._changed = 0
        self._causes: dict[str, None] = {}
        self._gravest = ""
        self._moved = ""
        self._nearest: Neighbour | None = None

    def see(self, turn: Turn, scene: Scene) -> Iterator[Line]:
        """See Witness."""
        decision = turn.decision
        if decision is None or decision.guard is None or not decision.guard.causes:
            return
        if self._changed and decision.time_s - self._last_s > QUIET_S:
            yield from self.end()
        if not self._changed:
            self._begin_s, self._nearest, self._gravest, self._causes = decision.time_s, None, "", {}
            self._moved = next((note.because for note in decision.notes if note.kind == "guard"), "")
        self._changed += 1
        self._last_s = decision.time_s
        self._causes |= dict.fromkeys(decision.guard.causes)
        if decision.guard.status in ("yielded", "braked"):
            yielded = f"not all demands could be kept, up to {decision.guard.yielded}"
            self._gravest = "it stopped the vehicle" if decision.guard.status == "braked" else yielded
        nearest = scene.nearest(decision)
        if nearest and (self._nearest is None or nearest.distance_m < self._nearest.distance_m):
            self._nearest = nearest

    def end(self) -> Iterator[Line]:
        """See Witness."""
        if not self._changed:
            return
        lasting_s, causes = self._last_s - self._begin_s, ", ".join(self._causes)
        near = self._nearest and f"nearest: vehicle {self._nearest.vehicle_id}, {self._nearest.distance_m:.2f} m away"
        because = "; ".join(filter(None, (self._moved, near, self._gravest)))
        many = "1 setpoint" if self._changed == 1 else f"{self._changed} setpoints in {lasting_s:.1f} s"
        yield Line(self._begin_s, "guard", f"{causes}: changes {many}", because, f"guard {causes}")
        self._changed = 0


class Plans:
    """When planning failed, and the substitute flew."""

    def __init__(self) -> None:
        self._times_s: list[float] = []

    def see(self, turn: Turn, _: Scene) -> Iterator[Line]:
        """See Witness."""
        decision = turn.decision
        if decision is None or decision.qp != QpStatus.FALLBACK.value:
            return
        if self._times_s and decision.time_s - self._times_s[-1] > QUIET_S:
            yield from self.end()
        self._times_s.append(decision.time_s)

    def end(self) -> Iterator[Line]:
        """See Witness."""
        if self._times_s:
            lasting_s = self._times_s[-1] - self._times_s[0]
            text = f"no plan within the bounds: the substitute flies, {len(self._times_s)} ticks in {lasting_s:.1f} s"
            yield Line(self._times_s[0], "plan", text, key="plan")
        self._times_s = []


class TelemetryGaps(Instant):
    """When the vehicle's own telemetry stayed away."""

    def __init__(self) -> None:
        self._heard_s: float | None = None

    def see(self, turn: Turn, scene: Scene) -> Iterator[Line]:
        """See Witness."""
        for item in turn.inputs:
            if isinstance(item, Telemetry):
                if self._heard_s is not None and item.time_s - self._heard_s > TELEMETRY_GAP_S * scene.time_scale:
                    text = f"no telemetry for {item.time_s - self._heard_s:.2f} s"
                    yield Line(self._heard_s, "link", text, key="telemetry")
                self._heard_s = item.time_s


class LoopWitness:
    """When ticks came too late, and whether the bus worked."""

    def __init__(self) -> None:
        self._begin_s = self._last_s = 0.0
        self._skipped: list[int] = []

    def see(self, turn: Turn, scene: Scene) -> Iterator[Line]:
        """See Witness."""
        if turn.tick is None:
            return
        now_s = turn.tick.now_s
        for item in turn.inputs:
            if isinstance(item, Bus):
                yield Line(now_s, "link", "the bus works again" if item.alive else "the bus does not work")
        if scene.late_ticks:
            if self._skipped and now_s - self._last_s > QUIET_S * scene.time_scale:
                yield from self.end()
            if not self._skipped:
                self._begin_s = now_s
            self._skipped.append(scene.late_ticks)
            self._last_s = now_s

    def end(self) -> Iterator[Line]:
        """See Witness."""
        if self._skipped:
            total, lasting_s = sum(self._skipped), self._last_s - self._begin_s
            many = "1 tick" if total == 1 else f"{total} ticks"
            worst = f", {max(self._skipped)} at once at most" if len(self._skipped) > 1 else ""
            text = f"the computer was late: {many} skipped in {lasting_s:.1f} s{worst}"
            yield Line(self._begin_s, "loop", text, key="late")
        self._skipped = []


class AutopilotWitness(Instant):
    """What the autopilot said of itself beside its motion; the battery is told with it, not by itself."""

    def __init__(self) -> None:
        self._before: tuple[str, ...] = ()

    def see(self, turn: Turn, _: Scene) -> Iterator[Line]:
        """See Witness."""
        for item in turn.inputs:
            if isinstance(item, Autopilot) and turn.tick is not None:
                facts = _facts(item.status)
                changed = [fact for fact in facts if fact and fact not in self._before]
                if changed:
                    battery = item.status.battery
                    because = "" if battery is None else f"battery {battery:.0%}"
                    yield Line(turn.tick.now_s, "autopilot", ", ".join(changed), because)
                self._before = facts


def _facts(status: VehicleStatus) -> tuple[str, ...]:
    return (
        "connected" if status.connected else "connection lost",
        "armed" if status.armed else "disarmed",
        "in the air" if status.in_air else "on the ground",
        f"mode {status.mode.value}",
        f"{status.restarts} restarts" if status.restarts else "",
    )


def _vehicles(ids: Sequence[int]) -> str:
    return f"vehicle {ids[0]}" if len(ids) == 1 else f"vehicles {', '.join(map(str, ids))}"


def _whereabouts(ids: Sequence[int], scene: Scene) -> str:
    known = [scene.members[each] for each in ids if each in scene.members]
    return ", ".join(f"{each.sender} in {each.tactic} at {place(each.position_m)} m" for each in known)


def _last_words(ids: Sequence[int], scene: Scene, now_s: float) -> str:
    known = [scene.members[each] for each in ids if each in scene.members]
    return ", ".join(f"{each.sender} said {each.tactic} {now_s - each.time_s:.2f} s ago" for each in known)


def _sighted_by(turn: Turn) -> str:
    """Return who saw what made a target known."""
    if any(isinstance(item, Sighting) for item in turn.inputs):
        return "seen by itself"
    messages = (heard(item) for item in turn.inputs if isinstance(item, Message))
    senders = {message.sender for message in messages if isinstance(message, TargetPackage)}
    return f"told by {_vehicles(sorted(senders))}" if senders else "from before"


def changed_setpoint(decision: Decision) -> bool:
    """Return whether the guard changed what was wished for."""
    return decision.guard is not None and bool(decision.guard.causes)
