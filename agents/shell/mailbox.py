"""The mailbox between the bus's threads and the event loop: bounded in length, rate and number of senders.

Messages with an invalid key or length are dropped before they are copied or decoded. The mailbox keeps the newest state
of each sender, and the last few of messages that do not supersede each other.
"""

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Collection

from agents.drops import DropCounter, Drops, Reason, Refusals
from agents.team.messages import (
    HEAD_TOPIC,
    OPERATOR_TOPIC,
    OPERATORS_TOPIC,
    PEER_TOPICS,
    PRESENCE_TOPIC,
    ROSTER_TOPIC,
    TOPICS,
    CommandAnswer,
    MemberState,
    StartProposal,
)
from agents.team.participant import SENSOR_TOPICS, is_name, is_vehicle
from agents.team.verbs import VERBS

PAYLOAD_LIMIT_BYTES = 4096
ROSTER_LIMIT_BYTES = 15 * PAYLOAD_LIMIT_BYTES
"""Of a roster, which has an entry for each holder of keys: enough for 254 vehicles."""
KEY_LENGTH = 128
KEY_RATE_HZ = 1000.0
"""Zenoh drops messages that follow the one before on their key in less time, the newest of a burst as well. The limit
is therefore far above the rate of any vehicle, and set only on topics whose messages are repeated.
"""
_KEPT = {TOPICS[MemberState].name: 4, TOPICS[CommandAnswer].name: 16}
"""The number of messages kept per peer on topics where older ones matter as well, for their sightings; else one."""
_OPERATOR_KEPT, _OPERATOR_RATE_HZ = 8, 50.0
_SENSOR_KEPT, _SENSOR_RATE_HZ = 32, 200.0
_ROSTER_RATE_HZ = 5.0
_HEAD_RATE_HZ = 1.0
_GUESTS = 32
"""The largest number of operators, and of sensors, that are distinguished at a time."""
_NEW_GUESTS_HZ = 20.0
_BURST_S = 0.5
"""The burst of a sender: what its rate allows in this time."""
_BURST_MIN = 10.0
_ROSTERS, _OPERATORS = f"{ROSTER_TOPIC}/", f"{OPERATORS_TOPIC}/"
_START_TOPIC = TOPICS[StartProposal].name

Read = Callable[[], bytes]


class _RateLimit:
    """Allows `rate_hz` messages a second, and a burst of half a second's at once."""

    __slots__ = ("_at_s", "_burst", "_left", "_rate_hz")

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._left = self._burst = max(rate_hz * _BURST_S, _BURST_MIN)
        self._at_s = 0.0

    def allows(self, now_s: float) -> bool:
        """Take one message at `now_s` [s]."""
        self._left = min(self._left + (now_s - self._at_s) * self._rate_hz, self._burst)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class _Box:
    """The waiting messages of one sender on one topic: key and payload of the newest ones."""

    __slots__ = ("limit", "waiting")

    def __init__(self, kept: int, rate_hz: float) -> None:
        self.waiting: deque[tuple[str, bytes]] = deque(maxlen=kept)
        self.limit = _RateLimit(rate_hz)


class _Guests:
    """The boxes of senders whose names are not known in advance: those received last."""

    def __init__(self, kept: int, rate_hz: float) -> None:
        self._kept = kept
        self._rate_hz = rate_hz
        self._boxes: OrderedDict[str, _Box] = OrderedDict()
        self._newcomers = _RateLimit(_NEW_GUESTS_HZ)

    def box(self, name: str, now_s: float) -> _Box | None:
        """Return the box of a sender, None if there are too many new senders."""
        box = self._boxes.get(name)
        if box is None:
            if not self._newcomers.allows(now_s):
                return None
            if len(self._boxes) >= _GUESTS:
                self._boxes.popitem(last=False)
            box = self._boxes[name] = _Box(self._kept, self._rate_hz)
        self._boxes.move_to_end(name)
        return box


class Mailbox:
    """Takes messages on any thread and returns them on another; `drops` counts the dropped ones by reason.

    `members` are the team's vehicles, `own` those that this process flies; `rate_hz` is the largest rate of each
    vehicle on each topic. Others are received on the topic on which they announce themselves, until `admit`.
    """

    def __init__(self, own: Collection[int], members: Collection[int], rate_hz: float) -> None:
        self._lock = threading.Lock()
        self._ids = {str(member): member for member in members}
        self._own_names = frozenset(map(str, own))
        self._rate_hz = rate_hz
        boxes = dict[str, _Box]()
        for name in self._ids:
            boxes |= self._boxes_of(name)
        self._own = {key: box for key, box in boxes.items() if key.partition("/")[2] in self._own_names}
        self._peers = {key: box for key, box in boxes.items() if key not in self._own}
        self._strangers = _Guests(1, rate_hz)
        self._present_strangers: set[str] = set()
        self._operators = _Guests(_OPERATOR_KEPT, _OPERATOR_RATE_HZ)
        self._sensors = _Guests(_SENSOR_KEPT, _SENSOR_RATE_HZ)
        self._rosters = _Guests(1, _ROSTER_RATE_HZ)
        self._blocked: frozenset[str] = frozenset()
        self._filled: dict[int, _Box] = {}
        self._presence: dict[int, bool] = {}
        self._present_operators: set[str] = set()
        self.operators_seen = 0
        """How often an operator has come so far."""
        self._awaited = False
        self._dropped = DropCounter()

    def _boxes_of(self, name: str) -> dict[str, _Box]:
        boxes = {f"{topic}/{name}": _Box(_KEPT.get(topic, 1), self._rate_hz) for topic in PEER_TOPICS}
        return boxes | {f"{HEAD_TOPIC}/{name}": _Box(1, _HEAD_RATE_HZ)}

    def admit(self, vehicle_id: int) -> bool:
        """Receive a vehicle that joins in flight; returns as `put`."""
        with self._lock:
            name = str(vehicle_id)
            if name not in self._ids:
                self._ids[name] = vehicle_id
                self._peers |= self._boxes_of(name)
                self._presence[vehicle_id] = name in self._present_strangers
            return self._calls()

    @property
    def drops(self) -> Drops:
        """The messages dropped so far."""
        with self._lock:
            return self._dropped.drops

    @property
    def refusals(self) -> Refusals:
        """What was refused so far, by sender."""
        with self._lock:
            return self._dropped.refusals

    def count(self, reason: Reason, key: str = "") -> None:
        """Count a message that was dropped elsewhere, by its key also for its sender."""
        with self._lock:
            self._dropped.add(reason, key)

    def refuse(self, sender: str, why: str) -> None:
        """Count what was refused elsewhere and is no message."""
        with self._lock:
            self._dropped.refuse(sender, why)

    def put(self, key: str, length: int, read: Read, now_s: float, *, own: bool = False) -> bool:
        """Take a message of `length` bytes on a key below the team's, or drop it; `read` returns its payload.

        `own` is whether a vehicle of this process sent it. Returns whether `take` has to be called; False while a call
        is already pending.
        """
        with self._lock:
            box = (self._own if own else self._peers).get(key) or self._guest_box(key, now_s)
            if key in self._blocked:
                self._dropped.add(Reason.NOT_A_MEMBER, key)
            elif isinstance(box, Reason):
                self._dropped.add(box, key)
            elif length > (ROSTER_LIMIT_BYTES if key.startswith(_ROSTERS) else PAYLOAD_LIMIT_BYTES):
                self._dropped.add(Reason.TOO_LONG, key)
            elif not box.limit.allows(now_s):
                self._dropped.add(Reason.TOO_MANY, key)
            else:
                if len(box.waiting) == box.waiting.maxlen:
                    self._dropped.add(Reason.SUPERSEDED)
                box.waiting.append((key, read()))
                self._filled[id(box)] = box
                return self._calls()
            return False

    def put_presence(self, name: str, present: bool) -> bool:
        """Take a change of a vehicle's presence; returns the same as `put`."""
        with self._lock:
            vehicle_id = self._ids.get(name)
            if vehicle_id is None and self._note_stranger(name, present):
                return False
            if vehicle_id is None or (present and f"{PRESENCE_TOPIC}/{name}" in self._blocked):
                self._dropped.add(Reason.NOT_A_MEMBER, f"{PRESENCE_TOPIC}/{name}")
                return False
            self._presence[vehicle_id] = present
            return self._calls()

    def _note_stranger(self, name: str, present: bool) -> bool:
        """Take the presence of a vehicle that may join later; return False for any other name, or for too many."""
        if not present:
            self._present_strangers.discard(name)
        elif is_vehicle(name) and len(self._present_strangers) < _GUESTS:
            self._present_strangers.add(name)
        return is_vehicle(name) and (not present or name in self._present_strangers)

    def put_operator(self, name: str, present: bool) -> None:
        """Take a change of an operator's presence; operators beyond the limit are ignored."""
        with self._lock:
            if not present or f"{OPERATORS_TOPIC}/{name}" in self._blocked:
                self._present_operators.discard(name)
            elif is_name(name) and len(self._present_operators) < _GUESTS:
                self._present_operators.add(name)
                self.operators_seen += 1

    def block(self, keys: frozenset[str]) -> bool:
        """Drop from now on what comes on these keys, waiting messages and presence included; returns as `put`."""
        with self._lock:
            self._blocked = keys
            for box in self._filled.values():
                box.waiting = deque((each for each in box.waiting if each[0] not in keys), maxlen=box.waiting.maxlen)
            for name, member in self._ids.items():
                if f"{PRESENCE_TOPIC}/{name}" in keys:
                    self._presence[member] = False
            self._present_operators -= {key.partition("/")[2] for key in keys if key.startswith(_OPERATORS)}
            return self._calls()

    @property
    def operated(self) -> bool:
        """Whether an operator is present."""
        return bool(self._present_operators)

    def take(self) -> tuple[dict[int, bool], list[tuple[str, bytes]]]:
        """Return and remove all that waits: presence of vehicles, and messages with their keys, oldest sender first."""
        with self._lock:
            self._awaited = False
            presence, self._presence = self._presence, {}
            filled, self._filled = self._filled, {}
            messages = [message for box in filled.values() for message in box.waiting]
            for box in filled.values():
                box.waiting.clear()
        return presence, messages

    def _calls(self) -> bool:
        awaited, self._awaited = self._awaited, True
        return not awaited

    def _guest_box(self, key: str, now_s: float) -> _Box | Reason:
        """Return the box of an operator or a sensor, or the reason why a key has none."""
        parts = key.split("/", 3) if len(key) <= KEY_LENGTH else []
        match parts:
            case [topic, verb, name] if topic == OPERATOR_TOPIC and verb in VERBS and is_name(name):
                return self._operators.box(name, now_s) or Reason.TOO_MANY
            case [topic, name] if topic in SENSOR_TOPICS and is_name(name):
                return self._sensors.box(f"{topic}/{name}", now_s) or Reason.TOO_MANY
            case [topic, name] if topic == ROSTER_TOPIC and is_name(name):
                return self._rosters.box(name, now_s) or Reason.TOO_MANY
            case [topic, name] if topic == _START_TOPIC and name not in self._own_names and is_vehicle(name):
                return self._strangers.box(name, now_s) or Reason.TOO_MANY
            case [topic, name] if topic in PEER_TOPICS or topic == HEAD_TOPIC:
                return Reason.OWN_ID if name in self._own_names else Reason.NOT_A_MEMBER
        return Reason.UNKNOWN_KEY
