"""State of a running team from its bus messages: each vehicle's latest messages, and events."""

from collections import OrderedDict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

from msgspec.structs import replace

from agents.flight_end import LastPosition
from agents.ports import VehicleRefusedError
from agents.safety.fence import Area
from agents.team.messages import (
    BusMessage,
    CommandAnswer,
    MemberState,
    MissionIdentity,
    OperatorCommand,
    StartProposal,
    VehicleReport,
)
from agents.team.verbs import AUTO, VERBS
from estimation.frames import MissionFrame
from gcs.console.advice import Severity, severity
from gcs.console.rings import ring_text
from gcs.console.vehicle_view import (
    TeamRow,
    may_fly,
    with_alert,
    with_outlook,
    with_state,
    with_surroundings,
    with_unaccounted,
)
from gcs.metrics.ending import UNACCOUNTED, Unaccounted
from gcs.mission.geometry import Place
from gcs.mission.mission import Mission


class TeamMissions:
    """The missions that the vehicles on the bus report, compared with the operator's.

    One vehicle with the right mission is enough: a wrong report of another one must not lock operators out.
    """

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._flown: dict[int, MissionIdentity] = {}

    @property
    def is_same(self) -> bool:
        """Whether a vehicle has reported the mission of this name."""
        return any(each.name == self._mission.mission.name for each in self._flown.values())

    @property
    def is_other(self) -> bool:
        """Whether every vehicle of the mission has reported one of another name."""
        return self._flown.keys() >= set(self._mission.ids) and not self.is_same

    def receive(self, message: BusMessage) -> None:
        """Process a message from the bus."""
        if isinstance(message, StartProposal) and message.mission is not None:
            self._flown[message.sender] = message.mission

    def refuse_other(self) -> None:
        """Raise VehicleRefusedError if every vehicle of the mission has reported another one."""
        if self.is_other:
            raise self._refusal()

    def require_version(self, verb: str) -> None:
        """Raise VehicleRefusedError unless a vehicle flies the mission that a command or sighting depends on."""
        if not self._flown:
            raise VehicleRefusedError(
                "no vehicle has reported its mission yet", "try again: a flight reports it once its vehicles are found"
            )
        if not self.is_same:
            raise self._refusal()
        if self._mission.identity not in self._flown.values():
            raise VehicleRefusedError(
                f"{verb}: {self.difference}",
                "give by --mission the file as it was at the start of the flight, with the same --set",
            )

    @property
    def difference(self) -> str:
        """How the missions reported differ from the operator's, with the vehicles; empty if they do not."""
        ours, name = self._mission.identity, self._mission.mission.name
        others = {vehicle: flown for vehicle, flown in sorted(self._flown.items()) if flown != ours}
        if others and ours not in self._flown.values() and all(flown.name == name for flown in others.values()):
            return f"the team flies another version of the mission {name!r}"
        return "; ".join(
            f"vehicle {vehicle} reports "
            + (f"another version of the mission {name!r}" if flown.name == name else f"{flown.name!r}, not {name!r}")
            for vehicle, flown in others.items()
        )

    def _refusal(self) -> VehicleRefusedError:
        names = ", ".join(sorted({repr(each.name) for each in self._flown.values()}))
        return VehicleRefusedError(
            f"team {self._mission.network.team} flies the mission {names}, not {self._mission.mission.name!r}",
            "give the mission that it flies by --mission",
        )


SILENT_AFTER_S = 1.0
"""Vehicles send at least five messages per second of mission time, which runs at least as fast as wall time."""
EVENTS_KEPT, COMMANDS_KEPT = 100, 1000
"""Maximum number of events shown at a time, and of commands and answers recognised as repeated."""


@dataclass(frozen=True, slots=True)
class TeamEvent:
    """A change in the team's messages, or their loss; `vehicle_id` is None for a command to all."""

    vehicle_id: int | None
    text: str
    severity: Severity = "information"

    @property
    def line(self) -> str:
        """The event as text, with its vehicle."""
        return self.text if self.vehicle_id is None else f"vehicle {self.vehicle_id}: {self.text}"


@dataclass(slots=True)
class _LatestMessages:
    """The latest messages of one vehicle, and their time of reception [wall s]."""

    state: MemberState
    received_s: float
    silence_reported: bool = False


@dataclass(slots=True)
class TeamState:
    """The state of a team from its bus messages, and the events since the last call of `new_events`.

    `areas` are those of the vehicles that have limits. `frame` is the mission's: positions of vehicles that are
    unaccounted for are shown in degrees. `rings` are the names of the mission's rings, none if it has one.
    """

    vehicle_ids: Sequence[int]
    areas: Mapping[int, Area] = field(default_factory=dict)
    frame: MissionFrame = field(default_factory=lambda: MissionFrame(None))
    rings: Sequence[str] = ()
    _reports: dict[int, tuple[VehicleReport, float]] = field(default_factory=dict)
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
            case VehicleReport():
                self._receive_report(message, now_s)
            case OperatorCommand() | CommandAnswer():
                self._receive_command(message)
            case _:
                pass

    def end(self, vehicle_id: int) -> None:
        """Record that a vehicle's flight has ended: the loss of its messages is then no event."""
        self._latest.pop(vehicle_id, None)

    def rows(self, now_s: float, *, is_over: bool = False) -> list[TeamRow]:
        """Return a row for each vehicle of the mission; no flight runs if it `is_over`."""
        places_m = {each: latest.state.position_m for each, latest in self._latest.items()}
        return [self._row(each, now_s, places_m, is_over=is_over) for each in sorted(self.vehicle_ids)]

    def ring_members(self, now_s: float) -> int:
        """Return how many vehicles fly on the ring, without those whose messages have stopped."""
        received = (each for each in self._latest.values() if now_s - each.received_s <= SILENT_AFTER_S)
        return sum(each.state.angle is not None for each in received)

    def new_events(self, now_s: float) -> list[TeamEvent]:
        """Return the events since the last call."""
        for vehicle_id, latest in sorted(self._latest.items()):
            is_silent = now_s - latest.received_s > SILENT_AFTER_S and not self._ended(vehicle_id)
            if is_silent and not latest.silence_reported:
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

    def _receive_report(self, report: VehicleReport, now_s: float) -> None:
        before, _ = self._reports.get(report.sender, (None, 0.0))
        self._reports[report.sender] = report, now_s
        if before is None or not report.ended:
            return
        if report.unaccounted_m is not None and before.unaccounted_m is None:
            self._events.append(TeamEvent(report.sender, f"{UNACCOUNTED}: {report.ended}", "alarm"))
        elif report.ended != before.ended:
            level: Severity = "information" if report.is_completed else "warning"
            self._events.append(TeamEvent(report.sender, f"flight ended: {report.ended}", level))

    def _ended(self, vehicle_id: int) -> str:
        """Return how a vehicle's flight ended, empty before."""
        return self._reports[vehicle_id][0].ended if vehicle_id in self._reports else ""

    def _add(self, state: MemberState, text: str, level: Severity = "information") -> None:
        self._events.append(TeamEvent(state.sender, text, level))

    def _receive_command(self, message: OperatorCommand | CommandAnswer) -> None:
        """Add commands and answers once; they are repeated on the bus."""
        if isinstance(message, OperatorCommand):
            key: tuple[object, ...] = (message.key,)
            receiver = "all vehicles" if message.vehicle is None else f"vehicle {message.vehicle}"
            text = f"command from {message.origin} to {receiver}: {self._command_text(message)}"
            event = TeamEvent(None, text, "warning" if VERBS[message.verb].is_dangerous else "information")
        else:
            key = (message.key, message.sender, message.did)
            level: Severity = "warning" if message.is_refused else "information"
            answered = f"{message.verb} by {message.origin}" if message.verb else "answers"
            event = TeamEvent(message.sender, f"{answered}: {message.did}", level)
        if key not in self._known:
            self._known[key] = None
            self._events.append(event)
            if len(self._known) > COMMANDS_KEPT:
                self._known.popitem(last=False)

    def _command_text(self, command: OperatorCommand) -> str:
        """Return the verb, in missions of several rings with the ring that is changed or assigned."""
        ring = ring_text(command.ring_number, self.rings)
        if command.verb == "assign" and self.rings:
            ring = ring or AUTO
        if VERBS[command.verb].takes in ("place", "view"):
            return f"{command.verb} {command.argument}"
        return f"{command.verb} {ring}" if ring else command.verb

    def _row(self, vehicle_id: int, now_s: float, places_m: Mapping[int, Place], *, is_over: bool) -> TeamRow:
        latest = self._latest.get(vehicle_id)
        if latest is None:
            last = self._last_position(vehicle_id, now_s, is_over=is_over)
            if last is None and vehicle_id in self._reports and self._reports[vehicle_id][0].in_reserve:
                return TeamRow(vehicle_id, is_stale=False, has_ended=True, in_reserve=True)
            if last is None:
                return TeamRow(vehicle_id, note="not received")
            return with_unaccounted(TeamRow(vehicle_id), Unaccounted.of(vehicle_id, last, self.frame))
        state, age_s, ending = latest.state, now_s - latest.received_s, self._ended(vehicle_id)
        is_stale = age_s > SILENT_AFTER_S
        silent = f"no messages for {age_s:.0f} s, last tactic {state.tactic}" if is_stale and not ending else ""
        dropped = f"messages dropped: {state.drops.text()}" if state.drops.total else ""
        note = ", ".join(filter(None, [silent, dropped]))
        row = with_state(TeamRow(vehicle_id, age_s=age_s, is_stale=is_stale, note=note), state, self.rings)
        report = self._reports[vehicle_id][0] if vehicle_id in self._reports else None
        if report is not None:
            row = with_outlook(row, report.outlook, state.time_s + age_s)
        row = with_surroundings(row, places_m, self.areas)
        last = self._last_position(vehicle_id, now_s, is_over=is_over)
        if last is not None:
            return with_unaccounted(row, Unaccounted.of(vehicle_id, last, self.frame))
        return replace(row, has_ended=True, ending=ending) if ending else with_alert(row, state.alert)

    def _last_position(self, vehicle_id: int, now_s: float, *, is_over: bool) -> LastPosition | None:
        """Return where a vehicle was last that is unaccounted for: by its report, or silent and no flight runs.

        In take-off it sends no states, but its position in its reports.
        """
        report, reported_s = self._reports.get(vehicle_id, (None, -inf))
        latest = self._latest.get(vehicle_id)
        reported_m = None if report is None else report.unaccounted_m
        if reported_m is None:
            is_silent = now_s - (reported_s if latest is None else latest.received_s) > SILENT_AFTER_S
            if not (is_over and is_silent and may_fly(report)) or self._ended(vehicle_id):
                return None
            if latest is not None:
                x, y = latest.state.position_m
                return LastPosition((x, y, latest.state.altitude_m), now_s - latest.received_s)
            reported_m = None if report is None else report.position_m
        if report is None or reported_m is None:
            return None
        return LastPosition(reported_m, (report.link_age_s or 0.0) + now_s - reported_s)
