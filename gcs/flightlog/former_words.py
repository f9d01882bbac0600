"""The texts of cordon 0.1 in logs, of format 1, and the present ones.

A log holds names of tactics, events and conditions, and notes, as text in records and in the messages between vehicles.
The reader replaces earlier texts, so that these logs replay bit for bit.
"""

from collections.abc import Mapping
from typing import Any

import msgspec
from google.protobuf.message import Message

FORMER_WORDS: Mapping[str, str] = {
    "it is coming down": "it is returning to land",
    "was coming down already": "was returning to land already",
    "come down": "return and land",
    "stood down": "pilot override",
    ": stand down": ": hand over to the pilot",
    "foreign mode": "pilot took over",
    "somebody else has the vehicle": "a pilot has the vehicle",
    "the setpoint wished for, (": "the planned aim (",
    ") m, was moved by ": ") m was moved by ",
    "lands, nobody resumed it": "lands, no resume was received",
    "fly on, and say so": "fly on and report",
    ": over": ": cleared",
    "all sightings put it elsewhere": "all sightings disagree with the estimate",
    "the autopilot's position is elsewhere now": "the autopilot's position jumped",
    "too fast to be kept up with": "faster than the vehicles can follow",
    "ring as the mission asks for it": "ring as in the mission",
}
FORMER_TOPICS: Mapping[str, str] = {"patience": "time_scale"}
"""Names of topics of format 1, and the present ones."""
FORMER_FIELDS: Mapping[str, str] = {"lacks": "start_blockers"}
"""Earlier names of fields, and the present ones; a schema is read with the present ones, bytes hold numbers only."""
_FORMER_TAGS: Mapping[str, str] = {"muster": "start"}
_BYTES = tuple(word.encode() for word in (*FORMER_WORDS, *_FORMER_TAGS))


def holds_former_words(payload: bytes) -> bool:
    """Return whether a record may hold an earlier text."""
    return any(word in payload for word in _BYTES)


def renew(message: Message) -> None:
    """Replace earlier texts in a record, and in the messages to peers that it holds."""
    for field, value in message.ListFields():
        if field.is_repeated:
            _renew_each(value, is_message=field.message_type is not None)
        elif field.message_type is not None:
            renew(value)
        elif isinstance(value, str | bytes):
            setattr(message, field.name, _renewed(value))


def _renew_each(values: Any, *, is_message: bool) -> None:
    for index, value in enumerate(values):
        if is_message:
            renew(value)
        elif isinstance(value, str | bytes):
            values[index] = _renewed(value)


def _renewed(value: str | bytes) -> str | bytes:
    return _renewed_payload(value) if isinstance(value, bytes) else _renewed_text(value)


def _renewed_text(text: str) -> str:
    for former, today in FORMER_WORDS.items():
        text = text.replace(former, today)
    return text


def _renewed_payload(payload: bytes) -> bytes:
    """Return a message to peers with present texts; other payloads are unchanged, and refused later."""
    if not holds_former_words(payload):
        return payload
    try:
        tag, *fields = msgspec.msgpack.decode(payload, type=list)
    except (ValueError, TypeError, RecursionError):
        return payload
    renewed = [_renewed_text(each) if isinstance(each, str) else each for each in fields]
    return msgspec.msgpack.encode([_FORMER_TAGS.get(tag, tag) if isinstance(tag, str) else tag, *renewed])
