"""The audit log: its entries, made from the inputs and outputs of the vehicles' cores, and its heads in other logs."""

import hashlib
from base64 import b64decode
from collections import OrderedDict
from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from typing import Annotated, Literal, NamedTuple

import msgspec

from agents.inputs import Bus, Command, Message
from agents.outputs import TickOutput
from agents.team.codec import decode
from agents.team.messages import ROSTER_TOPIC, TOPICS, CommandAnswer, CommandKey, OperatorCommand, VehicleId, key_of
from agents.team.text import printable
from gcs.checklist import Ticked

Event = Literal["received", "answered", "revoked", "head", "refused", "ticked", "closed"]
Source = Literal["bus", "keyboard", ""]


class AuditEntry(msgspec.Struct, frozen=True, omit_defaults=True):
    """A command received by a vehicle, its answer, keys revoked in flight, refusals, a head of another log, an item of
    the checklist, or the end.

    `operator` is the name in its key, and with keys that of the certificate. `did` is the answer, the effect of a
    revocation, the reason, or the head's digest; `command` also the number of refusals, or of the head's entries;
    `proof` the signed head (base64). `previous` is the digest of the entry before, empty in the first; `digest` is the
    SHA-256 of all other fields, without an empty `proof`.
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
    proof: str = ""


class AuditHead(msgspec.Struct, frozen=True, array_like=True, tag="head"):
    """The number of entries of the log of a vehicle's process, the digest of the last one, and when it was so."""

    vehicle: VehicleId
    time_s: float
    entries: Annotated[int, msgspec.Meta(ge=1, lt=2**53)]
    digest: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$")]


def ticked(time_s: float, number: int, tick: Ticked, text: str) -> AuditEntry:
    """Return the entry of a ticked item of the checklist, with its number and the Unix time of the tick."""
    when = datetime.fromtimestamp(tick.wall_s, UTC).isoformat(timespec="seconds")
    return AuditEntry(time_s, "ticked", 0, "", tick.by, "", number, printable(f"{text} ({when})"), "", "")


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
        self.length = 0
        self._commands: OrderedDict[tuple[int, CommandKey], tuple[Source, str, str]] = OrderedDict()
        self._answers: OrderedDict[tuple[int, CommandKey, str], None] = OrderedDict()
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
            case AuditEntry():
                yield self._chained(item)
            case TickOutput(messages=messages):
                for each in messages:
                    if each.topic == _ANSWERS:
                        yield from self._answered(vehicle_id, time_s, decode(each.payload))

    def head(self, time_s: float) -> AuditHead:
        """Return what shows later whether the entries so far were changed."""
        return AuditHead(0, time_s, self.length, self._previous)

    def _received(
        self, vehicle_id: int, time_s: float, command: OperatorCommand, source: Source, key: str
    ) -> Iterator[AuditEntry]:
        known = (vehicle_id, command.key)
        if known in self._commands:
            return
        self._commands[known] = source, key.rpartition("/")[2], key
        if len(self._commands) > _REMEMBERED:
            self._commands.popitem(last=False)
        yield self._entry(vehicle_id, time_s, "received", command.key, "")

    def _answered(self, vehicle_id: int, time_s: float, answer: object) -> Iterator[AuditEntry]:
        if not isinstance(answer, CommandAnswer) or (vehicle_id, answer.key) not in self._commands:
            return
        known = (vehicle_id, answer.key, answer.did)
        if known in self._answers:
            return
        self._answers[known] = None
        if len(self._answers) > _REMEMBERED:
            self._answers.popitem(last=False)
        yield self._entry(vehicle_id, time_s, "answered", answer.key, answer.did)

    def _entry(self, vehicle_id: int, time_s: float, event: Event, command: CommandKey, did: str) -> AuditEntry:
        source, operator, key = self._commands[vehicle_id, command]
        return self._chained(AuditEntry(time_s, event, vehicle_id, source, operator, key, command.number, did, "", ""))

    def _chained(self, entry: AuditEntry) -> AuditEntry:
        chained = sealed(entry, self._previous)
        self._previous = chained.digest
        self.length += 1
        return chained


def signer_and_head(authority_pem: bytes, payload: bytes) -> tuple[str, AuditHead]:
    """Return the common name of who signed a head, and the head; raises ValueError unless it is signed."""
    from gcs.keys.certificates import signer_and_content  # noqa: PLC0415

    signer, content = signer_and_content(authority_pem, payload)
    try:
        return signer, msgspec.msgpack.decode(content, type=AuditHead)
    except msgspec.MsgspecError as error:
        raise ValueError(f"{signer} has signed no audit head") from error


def is_signed_head(entry: AuditEntry, authority_pem: bytes) -> bool:
    """Return whether the vehicle whose head an entry holds has signed it."""
    try:
        signer, head = signer_and_head(authority_pem, b64decode(entry.proof))
    except ValueError:
        return False
    is_own = signer.partition("~")[0] == f"vehicle-{entry.vehicle}"
    return is_own and (head.vehicle, head.entries, head.digest) == (entry.vehicle, entry.command, entry.did)


class AuditedLog(NamedTuple):
    """The audit log of a file: its name, its vehicles, its entries, and among them the heads of other logs to trust."""

    name: str
    vehicles: Collection[int]
    entries: Sequence[AuditEntry]
    heads: Sequence[AuditEntry]

    def holds(self, head: AuditEntry) -> bool:
        """Return whether it has the entries up to a head that another log holds."""
        return 0 < head.command <= len(self.entries) and self.entries[head.command - 1].digest == head.did


def rewritten(logs: Sequence[AuditedLog]) -> Iterator[str]:
    """Return where logs of one flight contradict the heads that others of them hold, each pair of logs once."""
    for witness in logs:
        for vehicle in sorted({each.vehicle for each in witness.heads}):
            accused = [each for each in logs if vehicle in each.vehicles]
            held = [each for each in witness.heads if each.vehicle == vehicle]
            wrong = [each for each in held if not any(log.holds(each) for log in accused)]
            if accused and wrong:
                names = " or ".join(each.name for each in accused)
                fits = max((each.command for each in held if each not in wrong), default=0)
                yield (
                    f"{names}: rewritten after its entry {fits}: {witness.name} holds the head that vehicle {vehicle}"
                    f" sent of {wrong[0].command} entries at {_time(wrong[0].time_s)}, digest {wrong[0].did}"
                )


def unwitnessed(logs: Sequence[AuditedLog]) -> Collection[int]:
    """Return the vehicles whose heads these logs hold, but none of which is a log of them."""
    held = {each.vehicle for log in logs for each in log.heads}
    return sorted(held.difference(*(log.vehicles for log in logs)))


def audit_line(entry: AuditEntry) -> str:
    """Return an entry as one printable line: time, vehicle, operator, key, and the vehicle's answer."""
    who = f"operator {entry.operator}" if entry.source == "bus" else f"keyboard of {entry.operator}"
    if entry.event == "revoked":
        who = "authority"
    did = "received" if entry.event == "received" else entry.did
    if entry.event == "refused":
        return printable(f"{_time(entry.time_s)}  bus  {entry.operator}  refused {entry.command} times: {did}")
    if entry.event == "ticked":
        return printable(f"{_time(entry.time_s)}  checklist  {entry.operator}  ticked: {did}")
    return printable(f"{_time(entry.time_s)}  vehicle {entry.vehicle}  {who}  {entry.key}  {did}")


def _time(time_s: float) -> str:
    """Return the team's time: UTC, except in simulations that run faster than real time, whose clock is ahead."""
    try:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3]
    except (OverflowError, ValueError, OSError):
        return f"{time_s:.3f} s"
