"""The receiving end of MAVLink's mission protocol: missions (type 0), fences (1) and rally points (2).

The stub stores plans and returns them; only the fence affects its flight.
"""

from dataclasses import dataclass, field
from typing import Any

from sitl.mavlink_constants import Fields, MessageId, Outgoing

PLAN_TYPES = frozenset({0, 1, 2})
FENCE_PLAN, ALL_PLANS = 1, 255
ITEMS_MAX = 500
ACCEPTED, ERROR, NO_SPACE, INVALID_SEQUENCE = 0, 1, 4, 13
"""The MAV_MISSION_RESULT values that are used."""

Sender = tuple[int, int]
"""System and component id of the sender."""


@dataclass(slots=True)
class _Upload:
    plan_type: int
    count: int
    items: list[Fields] = field(default_factory=list)


class Plans:
    """Stored plans by type, and at most one upload in progress."""

    def __init__(self) -> None:
        """Start without plans."""
        self._stored: dict[int, tuple[Fields, ...]] = {}
        self._upload: _Upload | None = None

    def items(self, plan_type: int) -> tuple[Fields, ...]:
        """Return a stored plan: (frame, command, current, autocontinue, param1..4, x, y, z) per item."""
        return self._stored.get(plan_type, ())

    def clear(self, plan_type: int, sender: Sender) -> list[Outgoing]:
        """Clear one plan, or all."""
        if plan_type == ALL_PLANS:
            self._stored.clear()
        self._stored.pop(plan_type, None)
        return [_ack(sender, ACCEPTED, plan_type)]

    def begin_upload(self, plan_type: int, count: int, sender: Sender) -> list[Outgoing]:
        """Request the first of `count` items; a count of 0 clears the plan."""
        if plan_type not in PLAN_TYPES:
            return [_ack(sender, ERROR, plan_type)]
        if count > ITEMS_MAX:
            return [_ack(sender, NO_SPACE, plan_type)]
        if count == 0:
            return self.clear(plan_type, sender)
        self._upload = _Upload(plan_type, count)
        return [(MessageId.MISSION_REQUEST_INT, (*sender, 0, plan_type))]

    def receive_item(self, plan_type: int, seq: int, item: Fields, sender: Sender) -> list[Outgoing]:
        """Take an item, then request the next one, also after a repeated item, or acknowledge the plan."""
        upload = self._upload
        if upload is None or upload.plan_type != plan_type or seq > len(upload.items):
            return [_ack(sender, INVALID_SEQUENCE, plan_type)]
        if seq == len(upload.items):
            upload.items.append(item)
        if len(upload.items) < upload.count:
            return [(MessageId.MISSION_REQUEST_INT, (*sender, len(upload.items), plan_type))]
        self._stored[plan_type] = tuple(upload.items)
        self._upload = None
        return [_ack(sender, ACCEPTED, plan_type)]

    def count(self, plan_type: int, sender: Sender) -> list[Outgoing]:
        """Answer with the number of items of a plan."""
        return [(MessageId.MISSION_COUNT, (*sender, len(self.items(plan_type)), plan_type))]

    def item(self, plan_type: int, seq: int, sender: Sender) -> list[Outgoing]:
        """Answer with one item."""
        items: tuple[Any, ...] = self.items(plan_type)
        if seq >= len(items):
            return [_ack(sender, INVALID_SEQUENCE, plan_type)]
        return [(MessageId.MISSION_ITEM_INT, (*sender, seq, *items[seq], plan_type))]


def _ack(sender: Sender, result: int, plan_type: int) -> Outgoing:
    return MessageId.MISSION_ACK, (*sender, result, plan_type)
