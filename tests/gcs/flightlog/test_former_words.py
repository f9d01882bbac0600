"""Logs of format 1 are read in today's words."""

import msgspec
import pytest

from agents.inputs import Ground, TacticEvent
from agents.team.codec import decode
from agents.team.messages import MemberState, StartProposal
from gcs.flightlog.reader import read_log, topic_of
from gcs.flightlog.records import Decision, FormerMessage
from gcs.flightlog.schema import Codec, Decoder
from tests.support.paths import DATA

FORMER = ("come down", "stood down", "foreign mode")
MEMBER = ["member", 3, 1.0, "stood down", [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], 8.0, 0.0, "foreign mode"]


def reread(record: object) -> object:
    codec = Codec(type(record))
    fields = Decoder(codec.name, codec.schema).decode(codec.encode(record, 1))
    return msgspec.convert(fields, type(record))


def test_a_recorded_flight_of_format_1_is_read_in_todays_words() -> None:
    path = DATA / "stub-excitation.mcap"
    log = read_log(path)
    assert log.run.format == 1
    assert b"come down" in b"".join(each.payload for each in log.vehicles[1]), "the file itself keeps the former word"
    decisions = list(log.of_kind(1, Decision))
    texts = [note.text for decision in decisions for note in decision.notes]
    assert not [text for text in (*texts, *(each.tactic for each in decisions)) if text in FORMER]
    assert "excite -> return and land: end" in texts
    assert {"excite", "return and land"} <= {each.tactic for each in decisions}


def test_messages_to_peers_are_renewed_and_nothing_else_in_them_changes() -> None:
    received = reread(FormerMessage(1.0, msgspec.msgpack.encode(MEMBER)))
    assert isinstance(received, FormerMessage)
    state = decode(received.payload)
    assert isinstance(state, MemberState)
    assert (state.tactic, state.alert) == ("pilot override", "pilot took over")
    assert (state.sender, state.time_s, state.altitude_m) == (3, 1.0, 8.0)


def test_start_proposals_keep_their_fields() -> None:
    received = reread(FormerMessage(1.0, msgspec.msgpack.encode(["muster", 2, 5.0, 7.5, True])))
    assert isinstance(received, FormerMessage)
    assert decode(received.payload) == StartProposal(2, 5.0, 7.5, ready=True)


@pytest.mark.parametrize("payload", [b"foreign mode", b"\xa9come down", b"\x91" * 100_000 + b"stood down"])
def test_what_is_no_message_is_left_as_it_is(payload: bytes) -> None:
    assert reread(FormerMessage(1.0, payload)) == FormerMessage(1.0, payload)


def test_topics_of_format_1_are_known() -> None:
    assert topic_of("/vehicle/2/patience") == topic_of("/vehicle/2/time_scale")
    assert topic_of("/vehicle/2/patience") is not None
    assert topic_of("/vehicle/2/event") == (TacticEvent, 2)


def test_a_field_with_a_former_name_is_read_with_its_present_one() -> None:
    former = msgspec.defstruct("Ground", [("lacks", str)])
    written = Codec(former)
    decoder = Decoder(written.name, written.schema)
    decoder.require(Ground)
    assert msgspec.convert(decoder.decode(written.encode(former("GPS: no fix"), 1)), Ground) == Ground("GPS: no fix")
