"""How many messages were dropped on receipt, by reason and by sender."""

from collections import Counter
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Annotated, ClassVar

import msgspec

_Count = Annotated[int, msgspec.Meta(ge=0, lt=2**53)]


class Reason(Enum):
    """Why a message is dropped. The values are the fields of `Drops`."""

    UNKNOWN_KEY = "unknown_key"
    NOT_A_MEMBER = "not_a_member"
    OWN_ID = "own_id"
    TOO_LONG = "too_long"
    TOO_MANY = "too_many"
    SUPERSEDED = "superseded"
    MALFORMED = "malformed"
    WRONG_TOPIC = "wrong_topic"
    WRONG_SENDER = "wrong_sender"
    TOO_OLD = "too_old"
    FROM_FUTURE = "from_future"
    NOT_SENT = "not_sent"


class Drops(msgspec.Struct, frozen=True, omit_defaults=True):
    """The messages dropped so far, by reason.

    Before decoding: an unknown key, a sender outside the team or with this vehicle's id, too long, above the sender's
    rate limit, or superseded by a newer one of the same sender before the control loop took it. After decoding:
    malformed, on the topic of another type, on the key of another sender, too old, from the future. `not_sent` are own
    messages that the bus could not send.
    """

    topic: ClassVar = "drops"
    lasts: ClassVar = True
    unknown_key: _Count = 0
    not_a_member: _Count = 0
    own_id: _Count = 0
    too_long: _Count = 0
    too_many: _Count = 0
    superseded: _Count = 0
    malformed: _Count = 0
    wrong_topic: _Count = 0
    wrong_sender: _Count = 0
    too_old: _Count = 0
    from_future: _Count = 0
    not_sent: _Count = 0

    @property
    def total(self) -> int:
        """The sum of all reasons."""
        return sum(msgspec.structs.astuple(self))

    @property
    def refused(self) -> int:
        """The messages that the bus refused before decoding, because of their sender, key, length or rate."""
        return self.unknown_key + self.not_a_member + self.own_id + self.too_long + self.too_many

    def plus(self, other: "Drops") -> "Drops":
        """Return the sums by reason."""
        pairs = zip(msgspec.structs.astuple(self), msgspec.structs.astuple(other), strict=True)
        return Drops(*(one + another for one, another in pairs))

    def text(self) -> str:
        """Return the reasons with their counts, such as "too many 7, malformed 1"; empty if there are none."""
        counts = msgspec.structs.asdict(self)
        return ", ".join(f"{reason.replace('_', ' ')} {count}" for reason, count in counts.items() if count)

    def describe(self, _time: Callable[[float], str]) -> str:
        """Return them as an input of a core, as text."""
        return f"bus: messages dropped since the start: {self.text() or 'none'}"


NO_DROPS = Drops()


Refusals = Mapping[tuple[str, str], int]
"""How often something was refused, by its sender, such as `command/anna` or `address 192.0.2.7`, and by why."""
_KEY_LENGTH = 128
_SENDERS_MAX = 64
_OTHERS = "others"


class DropCounter:
    """Counts drops; `drops` is made anew only when one has been added."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._refusals: Counter[tuple[str, str]] = Counter()
        self._drops = NO_DROPS
        self._changed = False

    def add(self, reason: Reason, key: str = "") -> None:
        """Count one message; one that was refused for what it is also for its sender, which `key` names."""
        self._counts[reason.value] += 1
        self._changed = True
        if key:
            (topic, _, _), (_, _, name) = key.partition("/"), key.rpartition("/")
            is_readable = len(key) <= _KEY_LENGTH and key.isprintable()
            self.refuse(f"{topic}/{name}" if is_readable else _OTHERS, reason.value.replace("_", " "))

    def refuse(self, sender: str, why: str) -> tuple[str, int]:
        """Count a refusal for its sender only; return the name it is counted under, and how many there are.

        Senders beyond a limit are counted together: they choose their names.
        """
        refusal = sender, why
        if refusal not in self._refusals and len(self._refusals) >= _SENDERS_MAX:
            refusal = _OTHERS, why
        self._refusals[refusal] += 1
        return refusal[0], self._refusals[refusal]

    @property
    def refusals(self) -> Refusals:
        """A copy of the refusals so far."""
        return dict(self._refusals)

    @property
    def drops(self) -> Drops:
        """The counts so far; the same object until one is added."""
        if self._changed:
            self._changed = False
            self._drops = Drops(**self._counts)
        return self._drops
