"""Makes the entries of the audit log from the inputs and outputs of the vehicles' cores."""

import hashlib
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Literal

import msgspec

from agents.inputs import Bus, Command, Message
from agents.outputs import TickOutput
from agents.team.codec import decode
from agents.team.messages import ROSTER_TOPIC, TOPICS, CommandAnswer, OperatorCommand, key_of

Event = Literal["received", "answered", "revoked", "closed"]
Source = Literal["bus", "keyboard", ""]


class AuditEntry(msgspec.Struct, frozen=True):
    """A command received by a vehicle, its answer, keys revoked in flight, or the closing of the log after all entries.

    `operator` is the name in its key, and on a bus with keys that of the certificate. `did` is the vehicle's answer, or
    the effect of a revocation. `previous` is the digest of the entry before, empty in the first; `digest` is the
    SHA-256 of all other fields.
    """

    time_s: float
    event: Event
    vehicle: int
    source: Source
    operator: str
    key: str
    command: int
    did: str
    previous: str
    digest: str


def sealed(entry: AuditEntry, previous: str) -> AuditEntry:
    """Return an entry chained to the one before."""
    chained = msgspec.structs.replace(entry, previous=previous, digest="")
    digest = hashlib.sha256(msgspec.json.encode(chained)).hexdigest()
    return msgspec.structs.replace(chained, digest=digest)


def chain_fault(entries: Iterable[AuditEntry]) -> str:
    """Return the fault of a chain of entries, empty if it is intact."""
    previous, last = "", None
    for number, entry in enumerate(entries, start=1):
        if last is not None and last.event == "closed":
            return f"entry {number}: it follows the closing entry"
        if entry.previous != previous:
            return f"entry {number}: entries before it are missing or were changed"
        if sealed(entry, previous) != entry:
            return f"entry {number}: it was changed"
        previous, last = entry.digest, entry
    if last is None or last.event != "closed":
        return "its closing entry is missing: the log was not closed, or entries were removed from its end"
    return ""


_REMEMBERED = 1000
"""Commands and answers to remember, so that repetitions make no entries: they come within seconds."""
_ANSWERS = TOPICS[CommandAnswer].name


class AuditTrail:
    """The chain of entries of one log."""

    def __init__(self) -> None:
        self._previous = ""
        self._commands: OrderedDict[tuple[int, int], tuple[Source, str, str]] = OrderedDict()
        self._answers: OrderedDict[tuple[int, int, str], None] = OrderedDict()
        self._revoked: dict[int, tuple[str, ...]] = {}

    def take(self, vehicle_id: int, time_s: float, item: object) -> Iterator[AuditEntry]:
        """Return the entries for an input or output of a vehicle's core."""
        match item:
            case Message(message=OperatorCommand() as command) if command.vehicle in (None, vehicle_id):
                yield from self._received(vehicle_id, time_s, command, "bus", key_of(command))
            case Command(command=command):
                yield from self._received(vehicle_id, time_s, command, "keyboard", key_of(command))
            case Bus(revoked=revoked) if revoked != self._revoked.get(vehicle_id, ()):
                self._revoked[vehicle_id] = revoked
                did = f"accepts nothing from {', '.join(revoked)}"
                yield self._chained(AuditEntry(time_s, "revoked", vehicle_id, "bus", "", ROSTER_TOPIC, 0, did, "", ""))
            case TickOutput(messages=messages):
                for each in messages:
                    if each.topic == _ANSWERS:
                        yield from self._answered(vehicle_id, time_s, decode(each.payload))

    def closed(self, time_s: float) -> AuditEntry:
        """Return the closing entry, which shows that no entries were removed from the end."""
        return self._chained(AuditEntry(time_s, "closed", 0, "", "", "", 0, "", "", ""))

    def _received(
        self, vehicle_id: int, time_s: float, command: OperatorCommand, source: Source, key: str
    ) -> Iterator[AuditEntry]:
        known = (vehicle_id, command.number)
        if known in self._commands:
            return
        self._commands[known] = source, key.rpartition("/")[2], key
        if len(self._commands) > _REMEMBERED:
            self._commands.popitem(last=False)
        yield self._entry(vehicle_id, time_s, "received", command.number, "")

    def _answered(self, vehicle_id: int, time_s: float, answer: object) -> Iterator[AuditEntry]:
        if not isinstance(answer, CommandAnswer) or (vehicle_id, answer.number) not in self._commands:
            return
        known = (vehicle_id, answer.number, answer.did)
        if known in self._answers:
            return
        self._answers[known] = None
        if len(self._answers) > _REMEMBERED:
            self._answers.popitem(last=False)
        yield self._entry(vehicle_id, time_s, "answered", answer.number, answer.did)

    def _entry(self, vehicle_id: int, time_s: float, event: Event, number: int, did: str) -> AuditEntry:
        source, operator, key = self._commands[vehicle_id, number]
        return self._chained(AuditEntry(time_s, event, vehicle_id, source, operator, key, number, did, "", ""))

    def _chained(self, entry: AuditEntry) -> AuditEntry:
        chained = sealed(entry, self._previous)
        self._previous = chained.digest
        return chained


def audit_line(entry: AuditEntry) -> str:
    """Return an entry as a line: time, vehicle, operator, key, and the vehicle's answer."""
    who = f"operator {entry.operator}" if entry.source == "bus" else f"keyboard of {entry.operator}"
    if entry.event == "revoked":
        who = "authority"
    did = "received" if entry.event == "received" else entry.did
    return f"{_time(entry.time_s)}  vehicle {entry.vehicle}  {who}  {entry.key}  {did}"


def _time(time_s: float) -> str:
    """Return the team's time: UTC, except in simulations that run faster than real time, whose clock is ahead."""
    try:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3]
    except (OverflowError, ValueError, OSError):
        return f"{time_s:.3f} s"
