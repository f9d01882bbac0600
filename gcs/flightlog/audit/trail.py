"""Makes the entries of the audit log from the inputs and outputs of the vehicles' cores."""

from collections import OrderedDict
from collections.abc import Iterator

from agents.outputs import TickOutput
from agents.tape import Command, Message
from agents.team.codec import decode
from agents.team.messages import TOPICS, CommandAnswer, OperatorCommand, key_of
from gcs.flightlog.audit.entry import AuditEntry, Event, Source, sealed

_REMEMBERED = 1000
"""Commands and answers to remember, so that repetitions make no entries: they come within seconds."""
_ANSWERS = TOPICS[CommandAnswer].name


class AuditTrail:
    """The chain of entries of one log."""

    def __init__(self) -> None:
        self._previous = ""
        self._commands: OrderedDict[tuple[int, int], tuple[Source, str, str]] = OrderedDict()
        self._answers: OrderedDict[tuple[int, int, str], None] = OrderedDict()

    def take(self, vehicle_id: int, time_s: float, item: object) -> Iterator[AuditEntry]:
        """Return the entries for an item on a vehicle's tape."""
        match item:
            case Message(message=OperatorCommand() as command) if command.vehicle in (None, vehicle_id):
                yield from self._received(vehicle_id, time_s, command, "bus", key_of(command))
            case Command(command=command):
                yield from self._received(vehicle_id, time_s, command, "keyboard", key_of(command))
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
