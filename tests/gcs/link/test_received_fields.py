"""Each number that marks a value as unknown, sent and received as MAVLink bytes, is None."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs.link.received_fields import RECEIVED_FIELDS, ReceivedField

KNOWN = 42
KINDS = {kind.msgname: kind for kind in mavlink.mavlink_map.values()}


def received(message: str, name: str, value: float) -> Any:
    """Return a field as a decoder finds it in the bytes of a message; all other fields are 0."""
    kind = KINDS[message]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    zeros = {each: b"" if types[each] == "char" else [0] * lengths[each] or 0 for each in kind.fieldnames}
    fields = zeros | {name: value}
    data = kind(*(fields[each] for each in kind.fieldnames)).pack(mavlink.MAVLink(None, 1, 1))
    (decoded,) = mavlink.MAVLink(None).parse_buffer(data)
    return getattr(decoded, name)


@pytest.mark.parametrize("field", RECEIVED_FIELDS, ids=lambda field: f"{field.messages[0]}.{field.name}")
def test_the_mark_of_each_field_is_unknown_and_another_value_is_known(field: ReceivedField) -> None:
    for message in field.messages:
        assert field.known(received(message, field.name, field.unknown)) is None
        assert field.known(received(message, field.name, KNOWN)) == KNOWN


def test_what_is_out_of_range_or_no_number_is_unknown() -> None:
    field = ReceivedField(("ANY",), "any", -1, 0.0, 100.0)
    assert [field.known(value) for value in (-0.5, 100.5, float("inf"), None, "7")] == [None] * 5
    assert [field.known(value) for value in (0, 0.0, 100)] == [0, 0.0, 100]
