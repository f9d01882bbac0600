"""The event log of a team: notes of the vehicles in this process, and changes in the messages of the others."""

from collections.abc import Iterable

from agents.notes import AlertChange, CommandOutcome, Note
from agents.orders import obeyed
from agents.outputs import CoreStatus
from agents.team.messages import CommandAnswer, MemberState
from gcs.metrics.record import FlightEvent


class EventLog:
    """Collects events on the team's clock, each of them once, from any source."""

    def __init__(self) -> None:
        self.events: list[FlightEvent] = []
        self._local_ids: set[int] = set()
        self._last: dict[int, MemberState] = {}
        self._answered: set[tuple[int, int, str]] = set()
        self._reported = 0

    def note(self, status: CoreStatus) -> None:
        """Add the notes of a vehicle in this process, and the changes in the messages that it received."""
        self.add_notes(status.vehicle_id, status.notes)
        for peer in status.peers:
            if peer.sender not in self._local_ids:
                self.add_peer(peer)
        for answer in status.answers:
            self.add_answer(answer)

    def add_notes(self, vehicle_id: int, notes: Iterable[Note]) -> None:
        """Add the notes of a vehicle in this process."""
        self._local_ids.add(vehicle_id)
        self.events += [FlightEvent.of(vehicle_id, note) for note in notes]

    def new_events(self) -> list[FlightEvent]:
        """Return the events since the last call."""
        events, self._reported = self.events[self._reported :], len(self.events)
        return events

    def add_peer(self, peer: MemberState) -> None:
        """Add the changes in the state that a vehicle of another process sent."""
        if peer.sender in self._local_ids:
            return
        before = self._last.get(peer.sender)
        if before is not None and peer.time_s < before.time_s:
            return
        self._last[peer.sender] = peer
        time_s, sender = peer.time_s, peer.sender
        if before is not None and peer.tactic != before.tactic:
            self.events.append(FlightEvent(time_s, sender, "tactic", f"{before.tactic} -> {peer.tactic}"))
        alert = "" if before is None else before.alert
        if peer.alert != alert:
            text = f"alert: {peer.alert}" if peer.alert else f"alert cleared: {alert}"
            change = AlertChange(peer.alert or alert, is_over=not peer.alert)
            self.events.append(FlightEvent(time_s, sender, "failsafe", text, alert=change))

    def add_answer(self, answer: CommandAnswer) -> None:
        """Add the answer of a vehicle in another process to an operator."""
        if answer.sender in self._local_ids:
            return
        key = (answer.sender, answer.number, answer.did)
        if key not in self._answered:
            self._answered.add(key)
            outcome = CommandOutcome(answer.verb or "", answer.origin, answer.did, not obeyed(answer.did))
            text = f"answers: {answer.did}"
            self.events.append(FlightEvent(answer.time_s, answer.sender, "command", text, command=outcome))


def event_line(event: FlightEvent, start_s: float | None) -> str:
    """Return an event as text; `start_s` is the mission's start on the team's clock, None while it is unknown."""
    since_s = -1.0 if start_s is None else event.time_s - start_s
    when = f"{since_s:.1f} s" if since_s >= 0.0 else "before the start"
    return f"{when}: vehicle {event.vehicle}: {event.text}"
