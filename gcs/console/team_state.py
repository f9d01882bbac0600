"""State of a running team from its bus messages: the latest of each vehicle, and the changes between them."""

from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from agents.drops import NO_DROPS, Drops
from agents.orders import REFUSED
from agents.team.messages import BusMessage, CommandAnswer, MemberState, OperatorCommand
from gcs.console.advice import Severity, severity

SILENT_AFTER_S = 1.0
"""Vehicles send five messages or more per second of mission time, which is at least as fast as the wall clock."""
EVENTS_KEPT, COMMANDS_KEPT = 100, 1000
"""At most so many events are shown at a time, and so many commands and answers recognised as repeated."""


@dataclass(frozen=True, slots=True)
class WatchRow:
    """The latest state that one vehicle sent; None where it sent none. `age_s` is the age of the message [wall s]."""

    vehicle_id: int
    age_s: float | None = None
    tactic: str = "-"
    position_m: tuple[float, float] | None = None
    altitude_m: float | None = None
    radius_m: float | None = None
    angular_rate_rad_s: float | None = None
    alert: str = ""
    drops: Drops = NO_DROPS

    @property
    def silent(self) -> bool:
        """Whether its messages have stopped."""
        return self.age_s is not None and self.age_s > SILENT_AFTER_S


@dataclass(frozen=True, slots=True)
class TeamEvent:
    """Something that the team's messages, or their absence, show; `vehicle_id` is None for a command to all."""

    vehicle_id: int | None
    text: str
    severity: Severity = "information"

    @property
    def line(self) -> str:
        """The event as text, with the vehicle that it is about."""
        return self.text if self.vehicle_id is None else f"vehicle {self.vehicle_id}: {self.text}"


@dataclass(slots=True)
class _LatestMessages:
    """The latest messages of one vehicle, and their time of reception [wall s]."""

    state: MemberState
    received_s: float
    silence_reported: bool = False


@dataclass(slots=True)
class TeamState:
    """The state of a team from its bus messages, and the events since the last call of `new_events`."""

    vehicle_ids: Sequence[int]
    _latest: dict[int, _LatestMessages] = field(default_factory=dict)
    _known: OrderedDict[tuple[object, ...], None] = field(default_factory=OrderedDict)
    _events: deque[TeamEvent] = field(default_factory=lambda: deque(maxlen=EVENTS_KEPT))

    @property
    def any_received(self) -> bool:
        """Whether any vehicle has been received."""
        return bool(self._latest)

    def receive(self, message: BusMessage, now_s: float) -> None:
        """Add a message received at `now_s` [wall s]."""
        match message:
            case MemberState():
                self._receive_state(message, now_s)
            case OperatorCommand() | CommandAnswer():
                self._receive_command(message)
            case _:
                pass

    def end(self, vehicle_id: int) -> None:
        """Take that a vehicle's flight has ended: that it falls silent is no event."""
        self._latest.pop(vehicle_id, None)

    def rows(self, now_s: float) -> list[WatchRow]:
        """Return a row for each vehicle of the mission."""
        return [self._row(each, now_s) for each in sorted(self.vehicle_ids)]

    def new_events(self, now_s: float) -> list[TeamEvent]:
        """Return the events since the last call."""
        for vehicle_id, latest in sorted(self._latest.items()):
            if now_s - latest.received_s > SILENT_AFTER_S and not latest.silence_reported:
                latest.silence_reported = True
                text = f"no messages, last tactic {latest.state.tactic}"
                self._events.append(TeamEvent(vehicle_id, text, "warning"))
        events = list(self._events)
        self._events.clear()
        return events

    def _receive_state(self, state: MemberState, now_s: float) -> None:
        last = self._latest.get(state.sender)
        self._latest[state.sender] = _LatestMessages(state, now_s)
        if last is None:
            self._add(state, f"connected, tactic {state.tactic}")
        elif last.silence_reported:
            self._add(state, "messages restored")
        if last is not None and state.tactic != last.state.tactic:
            self._add(state, f"{last.state.tactic} -> {state.tactic}")
        if state.alert != ("" if last is None else last.state.alert):
            self._add(state, f"alert: {state.alert}" if state.alert else "alert cleared", severity(state.alert))

    def _add(self, state: MemberState, text: str, how_grave: Severity = "information") -> None:
        self._events.append(TeamEvent(state.sender, text, how_grave))

    def _receive_command(self, message: OperatorCommand | CommandAnswer) -> None:
        """Add commands and answers once; they are repeated on the bus."""
        if isinstance(message, OperatorCommand):
            key: tuple[object, ...] = (message.number,)
            receiver = "all vehicles" if message.vehicle is None else f"vehicle {message.vehicle}"
            text = f"command from {message.origin} to {receiver}: {message.verb}"
            event = TeamEvent(None, text, "warning" if message.verb == "kill" else "information")
        else:
            key = (message.number, message.sender, message.did)
            how_grave: Severity = "warning" if message.did.startswith(REFUSED) else "information"
            asked = f"{message.verb} by {message.origin}" if message.verb else "answers"
            event = TeamEvent(message.sender, f"{asked}: {message.did}", how_grave)
        if key not in self._known:
            self._known[key] = None
            self._events.append(event)
            if len(self._known) > COMMANDS_KEPT:
                self._known.popitem(last=False)

    def _row(self, vehicle_id: int, now_s: float) -> WatchRow:
        latest = self._latest.get(vehicle_id)
        if latest is None:
            return WatchRow(vehicle_id)
        state, angle = latest.state, latest.state.angle
        return WatchRow(
            vehicle_id,
            now_s - latest.received_s,
            state.tactic,
            state.position_m,
            state.altitude_m,
            None if angle is None else angle.radius_m,
            None if angle is None else angle.angular_rate_rad_s,
            state.alert,
            state.drops,
        )
