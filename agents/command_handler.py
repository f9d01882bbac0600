"""The operators' commands for one vehicle: the event that each triggers, and its answer.

Operators repeat a command until it is answered. Repeats, which have the same origin, verb and number, act once and are
answered again.
"""

from collections import OrderedDict
from collections.abc import Collection, Sequence
from math import inf
from typing import NamedTuple

import msgspec

from agents.notes import CommandOutcome, Notes
from agents.settings.shapes import Shape
from agents.tactics import Event, Tactic, next_tactic
from agents.team.messages import (
    DID_LIMIT,
    MISSION_RING,
    TOPICS,
    CommandAnswer,
    CommandedRing,
    CommandKey,
    Goal,
    OperatorCommand,
    Outcome,
    RingValues,
)
from agents.team.text import printable
from agents.team.verbs import VERBS, VerbRow

COMMANDS_KEPT = 2048
"""The number of commands kept to recognise repeats. They are sent for 12 s at most, in which three operators can send
this many more at the rate that the mailbox allows each (50 a second).
"""
_WHY_NOT = {
    Tactic.RETURN_AND_LAND: "it is on its way to land",
    Tactic.LAND: "it is landing",
    Tactic.PILOT_OVERRIDE: "cordon has handed it over: resume takes it back, kill cuts its motors",
}
_ENDS = "the operator ends the flight: rtl brings it home"
_GOES_FROM = (Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.ASIDE, Tactic.HOLD)
_CHOOSES_NO_RING = (Tactic.STANDBY, Tactic.ASIDE, Tactic.HOLD, Tactic.PILOT_OVERRIDE)
AGE_MAX_S, AHEAD_MAX_S = TOPICS[OperatorCommand].age_max_s, 1.0
_DISARMED = "it is on the ground, disarmed: it takes off by rejoin"


class Circumstances(NamedTuple):
    """What decides, beside the tactic, whether and when a vehicle carries out a command.

    `age_s` is the time since the command was sent [wall s], by the vehicle's clock: negative if dated ahead of it.
    `resume_refused` is why the vehicle must not resume, empty if it may; `ring_refused` why it cannot fly the commanded
    ring, `place_refused` why it must not go to the commanded place. It `is_down` if it was armed and no longer is, and
    `follows` setpoints unless it takes off or was handed over. `rejoin_refused` is why it must not take off again,
    empty if it may. `ring` is the number of the ring that it flies on, None off the rings. The flight `ends` once the
    operator has stopped it; its mission `is_over` from the return on.
    """

    age_s: float = 0.0
    resume_refused: str = ""
    ring_refused: str = ""
    rejoin_refused: str = ""
    place_refused: str = ""
    ring: int | None = None
    is_down: bool = False
    follows: bool = True
    link_lost: bool = False
    ends: bool = False
    is_over: bool = False


IN_FLIGHT = Circumstances()


class CommandEffect(NamedTuple):
    """What the vehicle does after a command: the event for its tactic, and whether a way to a place begins or ends.

    It goes to the place `goes_to`, None if it is sent to none; if it `stays`, a way to a place is over.
    """

    event: Event | None = None
    goes_to: Goal | None = None
    stays: bool = False


UNCHANGED = CommandEffect()


class _Answer(NamedTuple):
    """What the vehicle did, as text and as an outcome."""

    did: str
    outcome: Outcome = "obeyed"


class Reshaping(msgspec.Struct, frozen=True, order=True):
    """A change of the formation's shape, and when it was commanded; the newest applies, from any operator."""

    time_s: float
    shape: Shape


class CommandHandler:
    """The commands that one vehicle has received, its pending abort, and the answers to send."""

    def __init__(
        self,
        vehicle_id: int,
        abort_hover_s: float,
        shapes: Collection[Shape],
        notes: Notes,
        rings: Sequence[str] = (),
        *,
        has_gimbal: bool = False,
    ) -> None:
        """Take the vehicle, the time that an abort hovers before it lands, and the shapes that the formation can take.

        `rings` are the names of the mission's rings, none if it has one. The outcome of each command is added to
        `notes`.
        """
        self._vehicle_id = vehicle_id
        self._hover_s = abort_hover_s
        self._shapes = shapes
        self.reshaping: Reshaping | None = None
        """The newest change of the formation that this vehicle has received."""
        self._rings = rings
        self.commanded_rings: list[CommandedRing] = [MISSION_RING] * max(len(rings), 1)
        """The newest values of each ring that this vehicle has received from operators, by the ring's number."""
        self.assigned: int | None = None
        """The number of the ring that operators have assigned to this vehicle, None for none."""
        self._has_gimbal = has_gimbal
        self.looks_at: Goal | None = None
        """The place at which operators point the camera, None for the target."""
        self._assigned_s = self._looks_s = -inf
        self.start_blockers: str | None = None
        """While the vehicle waits on the ground: what forbids its start, empty if nothing does."""
        self.starts = False
        """Whether an operator has started the vehicle."""
        self._done: OrderedDict[CommandKey, tuple[OperatorCommand, _Answer]] = OrderedDict()
        self._unanswered: dict[CommandKey, None] = {}
        self._abort: tuple[float, str] | None = None
        self._kills: list[OperatorCommand] = []
        self._rejoins: list[OperatorCommand] = []
        self._rejoined: list[OperatorCommand] = []
        self._notes = notes

    @property
    def kills(self) -> bool:
        """Whether the motors are to be cut: from the command until the shell reports its outcome."""
        return bool(self._kills)

    @property
    def rejoins(self) -> bool:
        """Whether the vehicle is to take off again: from the command until the shell reports what became of it."""
        return bool(self._rejoins)

    @property
    def abort_lands_s(self) -> float | None:
        """When the landing after an abort's hover is due, None without one."""
        return None if self._abort is None else self._abort[0]

    def take(
        self, command: OperatorCommand, tactic: Tactic, now_s: float, circumstances: Circumstances = IN_FLIGHT
    ) -> CommandEffect:
        """Take a command in the present tactic; return what the vehicle does after it."""
        if command.vehicle not in (None, self._vehicle_id):
            return UNCHANGED
        _, before = self._done.get(command.key, (command, None))
        misdated = _misdated(VERBS[command.verb], circumstances.age_s)
        effect = UNCHANGED
        if before is None or (before.outcome == "misdated" and not misdated):
            if misdated:
                answer = _refused(misdated, "misdated")
            else:
                answer, effect = self._carry_out(command, tactic, now_s, circumstances)
            if circumstances.link_lost and answer.outcome == "obeyed":
                answer = answer._replace(did=f"{answer.did}; its link is lost")
            self._record(command, answer, now_s)
        self._unanswered[command.key] = None
        return effect

    def due(self, tactic: Tactic, now_s: float) -> Event | None:
        """Return the event of an abort whose hover is over; a pilot override cancels an abort."""
        if self._abort is None:
            return None
        lands_s, origin = self._abort
        if tactic in (Tactic.LAND, Tactic.PILOT_OVERRIDE):
            self._abort = None
        elif now_s >= lands_s:
            self._abort = None
            self._notes.add(now_s, CommandOutcome("abort", origin, "lands, no resume was received"))
            return Event.LAND
        return None

    def on_killed(self, refusal: str, now_s: float) -> None:
        """Take the outcome of a kill as the vehicle reports it: why it failed, empty if it did not."""
        answer = _refused(refusal) if refusal else _Answer(VERBS["kill"].done)
        for command in self._kills:
            self._record(command, answer, now_s)
            self._unanswered[command.key] = None
        self._kills.clear()

    def on_rejoined(self, refusal: str, now_s: float) -> None:
        """Take what became of a rejoin: why it was refused, empty if the vehicle takes off again.

        A refusal after that is why it did not.
        """
        answer = _refused(refusal) if refusal else _Answer(VERBS["rejoin"].done)
        if not refusal:
            self._abort, self.starts = None, False
            self._unanswered.clear()  # what came after its flight was answered without a tick
        commands = self._rejoins or self._rejoined
        for command in commands:
            self._record(command, answer, now_s)
            self._unanswered[command.key] = None
        self._rejoins, self._rejoined = [], [] if refusal else commands

    def answers(self, now_s: float) -> tuple[CommandAnswer, ...]:
        """Return and remove the answers since the last call."""
        if not self._unanswered:
            return ()
        answers = tuple(self._answer(*self._done[key], now_s) for key in self._unanswered)
        self._unanswered.clear()
        return answers

    def answer(self, key: CommandKey, now_s: float) -> CommandAnswer | None:
        """Return the newest answer to a command, None before it was taken."""
        return self._answer(*self._done[key], now_s) if key in self._done else None

    def _answer(self, command: OperatorCommand, answer: _Answer, now_s: float) -> CommandAnswer:
        verb, origin = command.verb, command.origin
        return CommandAnswer(self._vehicle_id, now_s, command.number, answer.did, verb, origin, answer.outcome)

    def _carry_out(
        self, command: OperatorCommand, tactic: Tactic, now_s: float, circumstances: Circumstances
    ) -> tuple[_Answer, CommandEffect]:
        row = VERBS[command.verb]
        match command.verb:
            case "kill":
                self._kills.append(command)
                self._abort = None
                return _Answer(row.did, "begun"), CommandEffect(row.event)
            case "start" | "rejoin":
                starts = command.verb == "start"
                return self._start(row) if starts else self._rejoin(command, row, circumstances), UNCHANGED
            case _ if hindrance := self._hindrance(circumstances):
                return _refused(hindrance), UNCHANGED
            case _:
                return self._move(command, tactic, now_s, circumstances)

    def _move(
        self, command: OperatorCommand, tactic: Tactic, now_s: float, circumstances: Circumstances
    ) -> tuple[_Answer, CommandEffect]:
        """Carry out a command of a vehicle that flies."""
        match command.verb:
            case "goto":
                return self._go(command, tactic, circumstances)
            case "abort":
                return self._abort_or_land(command.origin, tactic, now_s, circumstances)
            case "formation" | "ring" | "assign" | "look":
                changes = {
                    "formation": self._reshape,
                    "ring": self._change_ring,
                    "assign": self._assign,
                    "look": self._look,
                }
                return changes[command.verb](command, tactic, circumstances), UNCHANGED
            case _:
                return self._steer(VERBS[command.verb], tactic, circumstances)

    def _hindrance(self, circumstances: Circumstances) -> str:
        """Return why the vehicle carries out no command but a start or a kill, empty if it does."""
        if self.start_blockers is not None:
            return "it waits on the ground for its start"
        if self._kills:
            return "its motors are being cut"
        return _DISARMED if circumstances.is_down else ""

    def _start(self, row: VerbRow) -> _Answer:
        if self.start_blockers is None:
            return _Answer("did not wait for its start" if not self.starts else "was started already")
        if self.start_blockers:
            return _refused(self.start_blockers)
        self.starts, self.start_blockers = True, None
        return _Answer(row.did)

    def _rejoin(self, command: OperatorCommand, row: VerbRow, circumstances: Circumstances) -> _Answer:
        """Begin to rejoin: the shell checks the vehicle, and reports what became of it."""
        if command.vehicle is None:
            return _refused("the command names no vehicle that has landed")
        if self.start_blockers is not None:
            return _refused("it waits on the ground for its start")
        if circumstances.rejoin_refused:
            return _refused(circumstances.rejoin_refused)
        self._rejoins.append(command)
        return _Answer(row.did, "begun")

    def _abort_or_land(
        self, origin: str, tactic: Tactic, now_s: float, circumstances: Circumstances
    ) -> tuple[_Answer, CommandEffect]:
        """Hover at once and land later; a second abort during the hover lands at once."""
        if self._abort is not None or tactic is Tactic.LAND:
            return self._steer(VERBS["land"], tactic, circumstances)
        if tactic is Tactic.PILOT_OVERRIDE:
            return _refused(_WHY_NOT[tactic]), UNCHANGED
        self._abort = (now_s + self._hover_s, origin)
        answer, effect = self._steer(VERBS["hold"], tactic, circumstances)
        unless = "" if circumstances.ends else " unless resumed"
        return answer._replace(did=f"{answer.did}, lands in {self._hover_s:g} s{unless}"), effect

    def _go(
        self, command: OperatorCommand, tactic: Tactic, circumstances: Circumstances
    ) -> tuple[_Answer, CommandEffect]:
        """Send the vehicle to a place; it keeps its height, and holds or lands there."""
        place = command.place
        if place is None or command.vehicle is None:
            why = "names no place" if place is None else "sends the whole team: send each vehicle"
            return _refused(f"the command {why}"), UNCHANGED
        if tactic not in _GOES_FROM:
            return _refused(_over(tactic, circumstances) or f"not while its tactic is {tactic.value}"), UNCHANGED
        reason = _over(tactic, circumstances) or circumstances.resume_refused or circumstances.place_refused
        if not circumstances.follows:
            reason = reason or "it is not in offboard"
        if reason:
            return _refused(reason), UNCHANGED
        self._abort = None
        there = "lands" if place.lands else "holds"
        effect = CommandEffect(None if tactic is Tactic.HOLD else Event.HOLD, place)
        return _Answer(f"goes to {place.text}, and {there} there"), effect

    def _reshape(self, command: OperatorCommand, tactic: Tactic, circumstances: Circumstances) -> _Answer:
        """Change the shape of the formation; a vehicle in another tactic takes its place once it is back."""
        shape = command.shape
        if shape is None or shape not in self._shapes:
            known = ", ".join(self._shapes) or "none"
            return _refused(f"the mission's formation cannot be '{shape}' (shapes: {known})")
        if reason := _over(tactic, circumstances):
            return _refused(reason)
        self.reshaping = Reshaping(command.time_s, shape)
        in_formation = tactic is Tactic.FORMATION and circumstances.follows
        place = "takes its place" if in_formation else "will take its place, once in formation,"
        return _Answer(f"{place} in the shape '{shape}'")

    def _change_ring(self, command: OperatorCommand, tactic: Tactic, circumstances: Circumstances) -> _Answer:
        """Change the ring; a vehicle that is not on it flies the changed one once it comes to it."""
        values = command.ring
        if values is None or values == RingValues():
            return _refused("the command names no value of the ring")
        number = command.ring_number or 0
        if number >= len(self.commanded_rings):
            return _refused(self._no_ring(number))
        if reason := _over(tactic, circumstances) or circumstances.ring_refused:
            return _refused(reason)
        self.commanded_rings[number] = self.commanded_rings[number].commanded(values, command.time_s)
        if self._rings:
            return _Answer(f"changes the ring '{self._rings[number]}' to {values.text}")
        on_ring = tactic is Tactic.ENCIRCLE and circumstances.follows
        return _Answer(f"{'changes to' if on_ring else 'will fly, once it encircles,'} a ring of {values.text}")

    def _assign(self, command: OperatorCommand, tactic: Tactic, circumstances: Circumstances) -> _Answer:
        """Assign the vehicle to a ring, or end that; one that is not on its mission goes there once it is."""
        number = command.ring_number
        if reason := self._unassignable(command) or _over(tactic, circumstances):
            return _refused(reason)
        self.assigned, self._assigned_s = number, command.time_s
        if number is None:
            return _Answer("chooses its ring by itself")
        if circumstances.ring == number:
            return _Answer(f"is on the ring '{self._rings[number]}' already, and stays there")
        goes = circumstances.follows and tactic not in _CHOOSES_NO_RING
        return _Answer(f"{'goes' if goes else 'will go, once on its mission,'} to the ring '{self._rings[number]}'")

    def _look(self, command: OperatorCommand, tactic: Tactic, _circumstances: Circumstances) -> _Answer:
        """Point the camera at a place, or at the target again; in a team some vehicles may have no gimbal."""
        if not self._has_gimbal:
            return _Answer("has no gimbal to point") if command.vehicle is None else _refused("it has no gimbal")
        if tactic is Tactic.PILOT_OVERRIDE:
            return _refused(_WHY_NOT[tactic])
        if command.time_s < self._looks_s:
            return _refused("a newer command points its camera")
        self.looks_at, self._looks_s = command.place, command.time_s
        return _Answer(f"looks at {'the target' if command.place is None else command.place.text}")

    def _unassignable(self, command: OperatorCommand) -> str:
        """Return why a command assigns nothing, whatever the tactic; empty if it does."""
        number = command.ring_number
        if not self._rings:
            return "the mission has one ring, which every vehicle flies"
        if command.vehicle is None:
            return "the command assigns the whole team: assign each vehicle"
        if number is not None and number >= len(self._rings):
            return self._no_ring(number)
        return "a newer command assigns its ring" if command.time_s < self._assigned_s else ""

    def _no_ring(self, number: int) -> str:
        known = ", ".join(self._rings) or "one without a name"
        return f"the mission has no ring of number {number} (rings: {known})"

    def _steer(self, row: VerbRow, tactic: Tactic, circumstances: Circumstances) -> tuple[_Answer, CommandEffect]:
        resumes = row.event is Event.RESUME
        if resumes and (why := _ENDS if circumstances.ends else circumstances.resume_refused):
            return _refused(why), UNCHANGED
        changes = row.event is not None and next_tactic(tactic, row.event) is not tactic
        if not changes and tactic not in row.already:
            return _refused(_WHY_NOT.get(tactic, f"not while its tactic is {tactic.value}")), UNCHANGED
        if changes and row.event is not Event.HOLD:
            self._abort = None  # the operator has decided what comes after the hover
        # Until the vehicle follows setpoints it has not begun what its tactic is; only landing needs none.
        waits = not circumstances.follows and row.event is not Event.LAND and (changes or tactic is not Tactic.STANDBY)
        did = row.did if changes or waits else row.already[tactic]
        if resumes and changes and circumstances.is_over:
            did = "continues its return"
        when = ", once it is in offboard" if waits else ""
        return _Answer(did + when), CommandEffect(row.event if changes else None, stays=True)

    def _record(self, command: OperatorCommand, answer: _Answer, now_s: float) -> None:
        answer = answer._replace(did=printable(answer.did))  # it may hold text from the autopilot
        self._done[command.key] = command, answer
        while len(self._done) > COMMANDS_KEPT:
            dropped, _ = self._done.popitem(last=False)
            self._unanswered.pop(dropped, None)
        is_refused, place = answer.outcome in ("refused", "misdated"), command.place
        looks_at_m = () if place is None or command.verb != "look" else (place.x_m, place.y_m)
        self._notes.add(now_s, CommandOutcome(command.verb, command.origin, answer.did, is_refused, looks_at_m))


def _over(tactic: Tactic, circumstances: Circumstances) -> str:
    """Return why nothing of the mission can be changed any more, empty if it can."""
    if circumstances.ends or circumstances.is_over:
        return "its mission is over"
    return _WHY_NOT[tactic] if tactic in (Tactic.RETURN_AND_LAND, Tactic.LAND) else ""


def _misdated(row: VerbRow, age_s: float) -> str:
    """Return why a command of this age is too old, or dated too far ahead; empty if it is neither."""
    if row.acts_late or -AHEAD_MAX_S <= age_s <= AGE_MAX_S:
        return ""
    if age_s < 0.0:
        return f"it is dated {-age_s:.0f} s ahead of this vehicle's clock: send it again"
    return f"it is {age_s:.0f} s old, and {AGE_MAX_S:g} s at most are allowed: send it again"


def _refused(why: str, outcome: Outcome = "refused") -> _Answer:
    return _Answer(f"refused: {why}"[:DID_LIMIT], outcome)
