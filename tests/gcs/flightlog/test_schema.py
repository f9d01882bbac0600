"""Records as Protobuf: what is written is read back to the last bit, by this code and by somebody else's."""

import math
import sys
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from agents.inputs import AutopilotStatus, Command, CoreInput, Ground, Message
from agents.notes import GuardAction, Notes
from agents.outputs import CoreStatus, TickOutput
from agents.ports import FlightMode, Setpoint, VehicleStatus
from agents.tactics import Tactic
from agents.team.messages import NextChange, Outlook
from estimation.state import Telemetry
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import VEHICLE_TOPICS, Decision, decision_of, notes_of, outlook_of
from gcs.flightlog.schema import Codec, Decoder, codec_of
from tests.support.flight_logs import engaging, record_simulation

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
TRIPLES = st.tuples(NUMBERS, NUMBERS, NUMBERS)
LARGEST = (0.0, 0.0, sys.float_info.max)
"""Finite, while the sum of two such numbers is not."""


def back(record: Any, number: int = 7) -> Any:
    codec = Codec(type(record))
    decoded = Decoder(codec.name, codec.schema).decode(codec.encode(record, number))
    assert decoded["number"] == number
    return msgspec.convert(decoded, type(record))


def bits(values: tuple[float, ...]) -> list[str]:
    return [value.hex() for value in values]


@example(0.0, LARGEST, LARGEST)
@given(NUMBERS, TRIPLES, TRIPLES)
def test_numbers_keep_every_bit(time_s: float, position: Any, velocity: Any) -> None:
    again = back(Telemetry(time_s, position, velocity))
    assert bits((again.time_s, *again.position_m, *again.velocity_m_s)) == bits((time_s, *position, *velocity))


@pytest.mark.parametrize(
    "outlook",
    [
        None,
        Outlook(NextChange("land", 118.25, "not following"), "tilt too large", True, ("a", "b"), ("fence",), (2, 3)),
    ],
)
def test_what_comes_next_and_what_the_guard_did_are_read_as_they_were_written(outlook: Outlook | None) -> None:
    """By the quick way, which the page and the report take."""
    action = GuardAction(("separation", "fence"), (2, 3))
    notes = Notes()
    notes.add(99.0, action)
    output = TickOutput(None, (), CoreStatus(vehicle_id=1, time_s=100.0, tactic=Tactic.HOLD, outlook=outlook))
    decision = msgspec.structs.replace(decision_of(output), notes=notes.drained())
    codec = codec_of(Decision)
    read = Decoder(codec.name, codec.schema).message(codec.encode(decision, 1))
    assert outlook_of(read) == outlook == back(decision).outlook
    assert [each.guard for each in notes_of(read)] == [action]


def test_every_input_of_a_core_has_a_channel() -> None:
    """Messages and commands are recorded as others: as the messages that were taken, and as what was commanded here."""
    assert set(get_args(CoreInput)) - set(VEHICLE_TOPICS) == {Message, Command}


def test_nothing_is_told_from_nought(subtests: pytest.Subtests) -> None:
    for battery in [None, 0.0, 0.25]:
        with subtests.test(battery=battery):
            status = VehicleStatus(connected=True, mode=FlightMode.LAND, battery=battery)
            assert back(AutopilotStatus(status)) == AutopilotStatus(status)


def test_a_record_of_before_a_field_with_a_default_is_read_with_that() -> None:
    """Setpoints have had velocities only since there is feed-forward; what has no default is never dispensable."""
    before = msgspec.defstruct(
        "Setpoint", [("position_m", tuple[float, float, float]), ("yaw_rad", float)], frozen=True
    )
    kept = [(each.encode_name, each.type) for each in msgspec.structs.fields(Decision)]
    older = msgspec.defstruct(
        "Decision", [(name, before | None if name == "setpoint" else kind) for name, kind in kept], frozen=True
    )
    values = dict.fromkeys(name for name, _ in kept) | {"time_s": 1.0, "tactic": "hold", "mixing": 0.0, "alert": ""}
    values |= dict.fromkeys(("notes", "sent", "peers", "answers"), ()) | {"messages_dropped": 0}
    codec = Codec(older)
    decoder = Decoder(codec.name, codec.schema)
    decoder.require(Decision)
    decoded = decoder.decode(codec.encode(older(**values | {"setpoint": before((1.0, 2.0, 3.0), 0.5)}), 1))
    assert msgspec.convert(decoded, Decision).setpoint == Setpoint((1.0, 2.0, 3.0), 0.5, ())
    bare = Codec(msgspec.defstruct("Decision", [(name, kind) for name, kind in kept if name != "tactic"], frozen=True))
    with pytest.raises(ValueError, match="Decision has no tactic"):
        Decoder(bare.name, bare.schema).require(Decision)


def test_a_field_with_a_former_name_is_read_with_its_present_one() -> None:
    former = msgspec.defstruct("Ground", [("lacks", str)])
    written = Codec(former)
    decoder = Decoder(written.name, written.schema)
    decoder.require(Ground)
    assert msgspec.convert(decoder.decode(written.encode(former("GPS: no fix"), 1)), Ground) == Ground("GPS: no fix")


def test_a_log_is_read_by_others_as_well(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    record_simulation(engaging(), path, duration_s=5.0)
    ours = {vehicle: list(read_log(path).of_kind(vehicle, Decision)) for vehicle in (1, 2, 3)}
    theirs: dict[int, list[Any]] = {1: [], 2: [], 3: []}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic.endswith("/decision"):
                theirs[int(channel.topic.split("/")[2])].append((message, decoded))
    for vehicle, decisions in ours.items():
        assert len(theirs[vehicle]) == len(decisions) == 51
        for (message, decoded), decision in zip(theirs[vehicle], decisions, strict=True):
            assert math.isclose(message.log_time * 1e-9, decision.time_s, abs_tol=1e-9)
            assert decoded.tactic == decision.tactic
            assert decision.own is not None
            assert tuple(decoded.own.mean) == decision.own.mean
            assert [(each.topic, each.payload) for each in decoded.sent] == [
                (each.topic, each.payload) for each in decision.sent
            ]
            assert decoded.HasField("place") == (decision.place is not None)
