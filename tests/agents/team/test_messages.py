"""Peer messages: what goes in comes out, as far as its units tell, and nothing else gets in."""

from math import inf, nan

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from agents.drops import Drops
from agents.tactics import Tactic
from agents.team.codec import decode, encode
from agents.team.messages import (
    BIDS_LIMIT,
    MISSION_RING,
    RINGS_MAX,
    TOPICS,
    AutopilotReport,
    BusMessage,
    CommandAnswer,
    CommandedRing,
    MemberState,
    NeighbourAngle,
    NextChange,
    OperatorCommand,
    Outlook,
    RingChoice,
    StartProposal,
    TargetPackage,
    TargetReport,
    VehicleReport,
)
from agents.team.packing import Packing
from agents.team.text import printable as printable_text
from estimation.state import Sighting

printable = st.characters(exclude_categories=("Cc", "Cf", "Cs", "Zl", "Zp"))
ids, times = st.integers(1, 254), st.floats(0.0, 1e12)
places = st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
speeds = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
fractions = st.floats(0.0, 1.0)
messages = st.builds(StartProposal, ids, times, st.none() | times, st.booleans())

spans = st.tuples(st.floats(1.0, 100.0), st.floats(-0.9, 0.9), st.floats(1.0, 100.0))
covariances = spans.map(lambda span: (span[0] ** 2, span[0] * span[1] * span[2], span[2] ** 2))
shares = st.floats(1.0, 10.0)
angles = st.builds(
    NeighbourAngle, ids, times, st.floats(-7.0, 7.0), speeds.map(max), st.floats(0.0, 1e6), fractions, shares,
    st.none() | st.floats(-7.0, 7.0), speeds.map(min),
)  # fmt: skip
packages = st.builds(
    TargetPackage, ids, st.floats(0.0, 900.0), places, covariances, fractions, fractions,
    st.lists(ids, max_size=5).map(tuple), st.none() | st.floats(-1e6, 1e6), st.floats(1e-3, 1e3),
    st.floats(0.0, 100.0), st.floats(0.0, 1e6),
)  # fmt: skip
states = st.builds(
    MemberState, ids, st.floats(0.0, 900.0), st.sampled_from([each.value for each in Tactic]), places, speeds, places,
    speeds, st.floats(-1e6, 1e6), st.floats(0.0, 1e3), st.text(printable, max_size=32), st.none() | st.just("wedge"),
    times, st.builds(Drops, malformed=st.integers(0, 9)), st.none() | angles, st.lists(packages, max_size=3).map(tuple),
)  # fmt: skip

ages = st.floats(0.0, 1e6)
estimates = st.builds(TargetReport, places, speeds, covariances, ages)
autopilots = st.builds(
    AutopilotReport, st.none() | fractions, st.none() | ages, st.none() | st.integers(0, 3),
    st.none() | st.integers(0, 255),
)  # fmt: skip
reports = st.builds(
    VehicleReport, ids, times, st.text(printable, max_size=32), st.booleans(), st.booleans(), st.none() | ages,
    st.none() | st.floats(-7.0, 7.0), autopilots, st.text(printable, max_size=32), st.none() | times, ages,
    st.text(printable, max_size=120), st.none() | estimates,
)  # fmt: skip

ANGLE = NeighbourAngle(2, 10.0, 0.5, 0.05, 10.0)
TARGET = TargetPackage(2, 10.0, (35.0, -5.0), (0.1, 0.0, 0.1), 0.8, 0.2, (1, 3))
MEMBER = MemberState(2, 10.0, "formation", (1.0, 2.0), (0.1, 0.2), (3.0, 4.0), (0.2, 0.0))
ON_RING = structs.replace(MEMBER, tactic="encircle", angle=ANGLE, sightings=(TARGET,))
MUSTER = StartProposal(2, 10.0, 12.0)
COMMAND = OperatorCommand(12.5, "resume", 2, "pat", 7)
ANSWER = CommandAnswer(2, 12.6, 7, "resumed", "resume", "pat", "obeyed")
SEEN = TargetReport((35.0, -5.0), (0.1, 0.0), (0.1, 0.0, 0.1), 0.5)
AUTOPILOT = AutopilotReport(0.8, 600.0, 3, 12)
REPORT = VehicleReport(
    2, 12.7, "offboard", True, True, 0.1, 1.5, AUTOPILOT, "good", 10.0, 200.0, "", SEEN, "no fix", 0.1
)  # fmt: skip
EXAMPLES: list[BusMessage] = [MEMBER, ON_RING, MUSTER, COMMAND, ANSWER, REPORT]


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


@given(states)
def test_a_decoded_state_is_within_half_a_unit_and_encodes_unchanged(state: MemberState) -> None:
    again = decode(encode(state))
    assert isinstance(again, MemberState)
    assert decode(encode(again)) == again, "what a log keeps is what was received"
    assert (again.sender, again.time_s, again.tactic, again.alert) == (
        state.sender,
        state.time_s,
        state.tactic,
        state.alert,
    )
    assert (again.shape, again.drops) == (state.shape, state.drops)
    near(again, state, "position_m", "velocity_m_s", "aim_rate_m_s", "altitude_m", within=5e-4)
    near(again, state, "aim_m", "position_sigma_m", within=1.1e-3)
    assert again.position_sigma_m >= state.position_sigma_m - 1e-9
    assert (again.angle is None) == (state.angle is None)
    if again.angle is not None and state.angle is not None:
        assert (again.angle.sender, again.angle.time_s) == (state.sender, state.time_s)
        near(again.angle, state.angle, "bearing_rad", within=5e-6)
        near(again.angle, state.angle, "angular_rate_rad_s", "reference_rate_rad_s", within=5e-7)
        near(again.angle, state.angle, "radius_m", "rate_share", "radius_share", within=5e-4)
        assert (again.angle.reference_rad is None) == (state.angle.reference_rad is None)
    for seen, sent in zip(again.sightings, state.sightings, strict=True):
        assert (seen.sender, seen.recipients) == (state.sender, sent.recipients)
        near(seen, sent, "time_s", "position_m", "importance", "threat", within=6e-4)
        near(seen, sent, "covariance_m2", within=1.1e-6)
        Sighting(seen.time_s, 1, seen.position_m, seen.covariance_m2, 0.5, 0.5)  # still positive definite


def near(one: msgspec.Struct, other: msgspec.Struct, *names: str, within: float) -> None:
    for name in names:
        assert np.allclose(getattr(one, name), getattr(other, name), rtol=1e-12, atol=within), name


@given(reports)
def test_a_decoded_report_is_within_half_a_unit(report: VehicleReport) -> None:
    again = decode(encode(report))
    assert isinstance(again, VehicleReport)
    assert decode(encode(again)) == again
    exact = ("sender", "time_s", "mode", "armed", "in_air", "estimator", "start_s", "ended")
    assert [getattr(again, name) for name in exact] == [getattr(report, name) for name in exact]
    (own, got), (theirs, sent) = ((each, each.autopilot) for each in (again, report))
    assert (got.gps_dimensions, got.satellites) == (sent.gps_dimensions, sent.satellites)
    for name, within, one, other in (
        ("link_age_s", 6e-4, own, theirs),
        ("yaw_rad", 6e-4, own, theirs),
        ("battery", 6e-5, got, sent),
        ("endurance_s", 0.5, got, sent),
    ):
        assert (getattr(one, name) is None) == (getattr(other, name) is None)
        if getattr(other, name) is not None:
            near(one, other, name, within=within)
    near(again, report, "duration_s", within=6e-4)
    assert (again.target is None) == (report.target is None)
    if again.target is not None and report.target is not None:
        near(again.target, report.target, "position_m", "velocity_m_s", "sighting_age_s", within=6e-4)
        near(again.target, report.target, "covariance_m2", within=1.1e-6)
        Sighting(0.0, 1, again.target.position_m, again.target.covariance_m2, 0.5, 0.5)  # still positive definite


def test_a_state_fits_a_slow_radio() -> None:
    """Eight vehicles that send ten times a second share 57600 baud, of ten bits a byte."""
    here, still = (-123.456, 78.901), (-1.234, 0.567)
    angle = NeighbourAngle(8, 1.7e9, -2.345, 0.123, 40.0, 1.0, 1.0, 1.234, 0.12)
    state = MemberState(8, 1.7e9, "encircle", here, still, here, still, 12.3, 0.12, angle=angle)
    assert len(encode(state)) <= 80


def test_a_report_is_no_larger_than_two_states() -> None:
    seen = TargetReport((-123.456, 78.901), (-1.234, 0.567), (0.123456, -0.012345, 0.234567), 12.345)
    told = AutopilotReport(0.1234, 1234.0, 3, 12)
    report = VehicleReport(8, 1.7e9, "offboard", True, True, 0.045, -2.345, told, "good", 1.7e9, 600.0, "", seen)
    assert len(encode(report)) <= 110


ANGLE_FIELDS = 7
STATE_BYTES = bytes.fromhex(
    "a17302cb402400000000000002cd03e8cd07d064ccc8cd07d0cd07d0ccc8000000a0c08097cdc350cdc350cd2710cd2710cd2710c000919b"
    "00cd88b8d1ec78ce000186a000ce000186a0cd1f40cd07d0920103c0c0"
)
REPORT_BYTES = bytes.fromhex(
    "a17202cb4029666666666666a86f6666626f617264c3c364cd05dccd1f40cd0258030ca4676f6f64cb4024000000000000ce00030d40a098"
    "cd88b8d1ec786400ce000186a000ce000186a0cd01f4a66e6f2066697864"
)


def test_what_is_due_takes_a_byte_while_nothing_is_and_is_as_exact_as_a_count_down_needs() -> None:
    known = structs.replace(REPORT, is_completed=False)
    due = Outlook(NextChange("land", 12.7 + 18.2504, "not following"), "not following", also=("link degraded",))
    again = decode(encode(structs.replace(known, outlook=due)))
    assert isinstance(again, VehicleReport)
    assert again.outlook is not None
    assert again.outlook.next is not None
    assert again.outlook.next.at_s == pytest.approx(12.7 + 18.2504, abs=6e-4)
    assert structs.replace(again.outlook, next=due.next) == due
    assert len(encode(structs.replace(known, outlook=due))) - len(encode(known)) <= 60


def test_the_bytes_of_a_state_and_a_report_are_those_that_earlier_versions_send() -> None:
    """After the length of the array, up to what has been added since."""
    earlier = [each[:ANGLE_FIELDS] if isinstance(each, list) else each for each in fields(ON_RING)]
    assert msgspec.msgpack.encode(earlier)[3:].startswith(STATE_BYTES)
    assert decode(msgspec.msgpack.encode(earlier)) == ON_RING
    assert encode(REPORT)[3:].startswith(REPORT_BYTES)


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


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_fields_that_a_later_version_appends_are_ignored(message: BusMessage) -> None:
    values = fields(message)
    if isinstance(
        message, MemberState | VehicleReport
    ):  # those at its end that have their defaults, None, are not sent
        values += [None] * (1 + len(structs.fields(Packing(type(message)).wire)) - len(values))
    assert decode(msgspec.msgpack.encode([*values, "new", {"more": [1, nan]}])) == message


def test_a_choice_among_several_rings_takes_few_bytes_and_arrives_as_it_was_sent() -> None:
    commanded = (MISSION_RING, CommandedRing(12.5, 7.25, None, 0.0, 14.0, 9.5, -12.0, 9.5))
    for choice, most_bytes in (
        (RingChoice(None), 6),
        (RingChoice(2, b"0123456789"), 16),
        (RingChoice(1, b"", commanded), 60),
    ):
        state = structs.replace(MEMBER, choice=choice)
        assert decode(encode(state)) == structs.replace(decode(encode(MEMBER)), choice=choice)
        assert len(encode(state)) - len(encode(MEMBER)) <= most_bytes
    for wrong in (RingChoice(RINGS_MAX), RingChoice(-1), RingChoice(0, bytes(BIDS_LIMIT + 1))):
        assert refused(encode(structs.replace(MEMBER, choice=wrong)))


def test_every_kind_of_message_has_a_topic_of_its_own() -> None:
    assert set(TOPICS) == {type(message) for message in EXAMPLES}
    assert len({topic.name for topic in TOPICS.values()}) == len(TOPICS)
    assert all(0.0 < topic.period_s < topic.age_max_s for topic in TOPICS.values())


ESCAPES = ("\x1b[2J", "a\n", "\n", "\x00", "\x7f", "\x9b31m", "a\u202eb", "a\u2028", "\r")


@pytest.mark.parametrize("text", ESCAPES)
def test_no_text_holds_control_characters(text: str) -> None:
    assert printable_text(text) != text
    for message in (
        structs.replace(MEMBER, alert=text),
        structs.replace(COMMAND, origin=text),
        structs.replace(ANSWER, did=text),
        structs.replace(REPORT, mode=text),
        structs.replace(REPORT, estimator=text),
        structs.replace(REPORT, ended=text),
    ):
        assert refused(encode(message)), message
