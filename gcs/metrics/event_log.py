"""What happens to a team, for people: the notes of the vehicles here, and what those elsewhere show of themselves."""

from collections.abc import Iterable

from agents.notes import Note
from agents.outputs import CoreStatus
from agents.team.messages import CommandAnswer, MemberState
from gcs.metrics.record import FlightEvent


class EventLog:
    """Collects events on the team's clock, each once, whoever tells of it."""

    def __init__(self) -> None:
        self.events: list[FlightEvent] = []
        self._here: set[int] = set()
        self._last: dict[int, MemberState] = {}
        self._answered: set[tuple[int, int, str]] = set()
        self._told = 0

    def note(self, status: CoreStatus) -> None:
        """Take what a vehicle of this process has noted, and what it heard of the others."""
        self.take(status.vehicle_id, status.notes)
        for peer in status.peers:
            self.watch(peer)
        for answer in status.answers:
            self.hear(answer)

    def take(self, vehicle_id: int, notes: Iterable[Note]) -> None:
        """Take what a vehicle of this process has noted."""
        self._here.add(vehicle_id)
        self.events += [FlightEvent(note.time_s, vehicle_id, note.kind, note.text) for note in notes]

    def news(self) -> list[FlightEvent]:
        """Return the events since the last time."""
        news, self._told = self.events[self._told :], len(self.events)
        return news

    def watch(self, peer: MemberState) -> None:
        """Note what changed about a vehicle of another process, by what it says."""
        if peer.sender in self._here:
            return
        before = self._last.get(peer.sender)
        if before is not None and peer.time_s < before.time_s:
            return
        self._last[peer.sender] = peer
        if before is not None and peer.tactic != before.tactic:
            self._add(peer, "tactic", f"{before.tactic} -> {peer.tactic}")
        alert = "" if before is None else before.alert
        if peer.alert != alert:
            self._add(peer, "failsafe", f"alert: {peer.alert}" if peer.alert else f"no alert any more: {alert}")

    def hear(self, answer: CommandAnswer) -> None:
        """Note what a vehicle of another process answered to an operator."""
        if answer.sender in self._here:
            return
        key = (answer.sender, answer.number, answer.did)
        if key not in self._answered:
            self._answered.add(key)
            self._add(answer, "command", f"answers: {answer.did}")

    def _add(self, message: MemberState | CommandAnswer, kind: str, text: str) -> None:
        self.events.append(FlightEvent(message.time_s, message.sender, kind, text))


def event_line(event: FlightEvent, start_s: float | None) -> str:
    """Return an event for people; `start_s` is the mission's start on the team's clock, None while it is not known."""
    since_s = -1.0 if start_s is None else event.time_s - start_s
    when = f"{since_s:.1f} s" if since_s >= 0.0 else "before the start"
    return f"{when}: vehicle {event.vehicle}: {event.text}"
