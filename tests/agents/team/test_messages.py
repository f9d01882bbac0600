"""Peer messages: what goes in comes out, and nothing else gets in."""

from math import inf, nan

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from agents.team.codec import decode, encode
from agents.team.messages import (
    TOPICS,
    BusMessage,
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    StartProposal,
    TargetPackage,
)
from agents.team.text import printable as printable_text

printable = st.characters(exclude_categories=("Cc", "Cf", "Cs", "Zl", "Zp"))
ids, times = st.integers(1, 254), st.floats(0.0, 1e12)
places = st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
speeds = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
variances, fractions = st.floats(-1e8, 1e8), st.floats(0.0, 1.0)
messages = st.one_of(
    st.builds(MemberState, ids, times, st.text(printable, max_size=32), places, speeds, places, speeds),
    st.builds(NeighbourAngle, ids, times, st.floats(-7.0, 7.0), st.floats(-1e3, 1e3), st.floats(0.0, 1e6)),
    st.builds(
        TargetPackage,
        ids,
        times,
        places,
        st.tuples(variances, variances, variances),
        fractions,
        fractions,
        st.lists(ids, max_size=5).map(tuple),
    ),
    st.builds(StartProposal, ids, times, st.none() | times, st.booleans()),
)

MEMBER = MemberState(2, 10.0, "formation", (1.0, 2.0), (0.1, 0.2), (3.0, 4.0), (0.2, 0.0))
ANGLE = NeighbourAngle(2, 10.0, 0.5, 0.05, 10.0)
TARGET = TargetPackage(2, 10.0, (35.0, -5.0), (0.1, 0.0, 0.1), 0.8, 0.2, (1, 3))
MUSTER = StartProposal(2, 10.0, 12.0)
COMMAND = OperatorCommand(12.5, "resume", 2, "pat", 7)
ANSWER = CommandAnswer(2, 12.6, 7, "resumed")
EXAMPLES: list[BusMessage] = [MEMBER, ANGLE, TARGET, MUSTER, COMMAND, ANSWER]


def fields(message: BusMessage) -> list[object]:
    unpacked: list[object] = msgspec.msgpack.decode(encode(message))
    return unpacked


def refused(payload: bytes) -> bool:
    """Whether a payload is refused; anything but ValueError is a failure."""
    try:
        decode(payload)
    except ValueError:
        return True
    return False


@given(messages)
def test_what_goes_in_comes_out(message: BusMessage) -> None:
    again = decode(encode(message))
    assert type(again) is type(message)
    assert again == message


@given(st.binary(max_size=200))
def test_arbitrary_bytes_never_raise_anything_but_value_error(payload: bytes) -> None:
    if not refused(payload):
        assert type(decode(payload)) in TOPICS


@given(messages, st.data())
def test_a_mutated_message_never_raises_anything_but_value_error(message: BusMessage, data: st.DataObject) -> None:
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    refused(bytes(payload))
    assert refused(bytes(encode(message)[: data.draw(st.integers(0, len(payload) - 1))]))


# An array of one field more, and that one nested without end: to skip it takes recursion.
BOTTOMLESS = b"\x96" + encode(MUSTER)[1:] + b"\x91" * 100_000


@pytest.mark.parametrize(
    "payload", [b"", b"\x91" * 100_000, b"\xc1", b"\x81" * 5000, msgspec.msgpack.encode(["start"]), BOTTOMLESS]
)
def test_hostile_bytes_are_refused(payload: bytes) -> None:
    assert refused(payload)


def test_every_number_is_bounded(subtests: pytest.Subtests) -> None:
    for message in EXAMPLES:
        for wrong in [nan, inf, -inf, 1e13, "1", {}, -3e8]:
            with subtests.test(message=message, wrong=wrong):
                tag, *values = fields(message)
                for index, value in enumerate(values):
                    if not isinstance(value, str) and wrong != value:
                        assert refused(msgspec.msgpack.encode([tag, *values[:index], wrong, *values[index + 1 :]]))
                    if isinstance(value, list):
                        for inner in range(len(value)):
                            spoilt = [*value[:inner], wrong, *value[inner + 1 :]]
                            assert refused(msgspec.msgpack.encode([tag, *values[:index], spoilt, *values[index + 1 :]]))


def test_bounds_by_hand(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[BusMessage, int, object], ...] = (
        (MEMBER, 1, 0),
        (MEMBER, 1, 255),
        (MEMBER, 2, -0.1),
        (MEMBER, 3, "x" * 33),
        (MEMBER, 4, [1.0]),
        (MEMBER, 4, [1.0, 2.0, 3.0]),
        (MEMBER, 5, [1001.0, 0.0]),
        (ANGLE, 3, 7.01),
        (ANGLE, 5, -0.01),
        (TARGET, 5, 1.01),
        (TARGET, 6, -0.01),
        (TARGET, 7, [0]),
        (MUSTER, 0, "mustard"),
    )
    for message, index, wrong in rows:
        with subtests.test(message=message, index=index, wrong=wrong):
            values = fields(message)
            values[index] = wrong
            assert refused(msgspec.msgpack.encode(values))


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_fields_that_a_later_version_appends_are_ignored(message: BusMessage) -> None:
    assert decode(msgspec.msgpack.encode([*fields(message), "new", {"more": [1, nan]}])) == message


def test_every_kind_of_message_has_a_topic_of_its_own() -> None:
    assert set(TOPICS) == {type(message) for message in EXAMPLES}
    assert len({topic.name for topic in TOPICS.values()}) == len(TOPICS)
    assert all(0.0 < topic.period_s < topic.age_max_s for topic in TOPICS.values())


ESCAPES = ("\x1b[2J", "a\n", "\n", "\x00", "\x7f", "\x9b31m", "a\u202eb", "a\u2028", "\r")


@pytest.mark.parametrize("text", ESCAPES)
def test_no_text_holds_control_characters(text: str) -> None:
    assert printable_text(text) != text
    for message in (
        structs.replace(MEMBER, tactic=text),
        structs.replace(MEMBER, alert=text),
        structs.replace(COMMAND, origin=text),
        structs.replace(ANSWER, did=text),
    ):
        assert refused(encode(message)), message


def test_text_of_all_languages_is_left_as_it_is() -> None:
    for text in ("", "holds", "höher als 120 m: σ = 3", "保持"):
        assert printable_text(text) == text
        assert decode(encode(structs.replace(ANSWER, did=text))) == structs.replace(ANSWER, did=text)
