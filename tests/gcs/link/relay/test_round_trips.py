"""Round trips: requests and answers as pymavlink reads and writes them, and which answers count."""

import pytest
from pymavlink.dialects.v20 import common as dialect

from gcs.link.relay.frames import timesync_answer, timesync_request
from gcs.link.relay.gate import KEPT, Claim, FrameGate, RoundTrips

VEHICLE = ("127.0.0.1", 14540)


def packed(message: dialect.MAVLink_message, system_id: int = 1) -> bytes:
    sender = dialect.MAVLink(None, srcSystem=system_id, srcComponent=1)
    return bytes(message.pack(sender))


def heartbeat() -> bytes:
    return packed(dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))


@pytest.mark.parametrize("time_ns", [1, 2**62 + 1])
def test_a_request_is_one_for_every_autopilot(time_ns: int) -> None:
    (message,) = dialect.MAVLink(None).parse_buffer(timesync_request(260, time_ns))
    assert (message.get_type(), message.tc1, message.ts1) == ("TIMESYNC", 0, time_ns)
    assert message.get_seq() == 260 % 256


@pytest.mark.parametrize("asked_ns", [1, 2**62])
def test_an_answer_returns_the_time_of_its_request(asked_ns: int) -> None:
    assert timesync_answer(packed(dialect.MAVLink_timesync_message(77, asked_ns))) == asked_ns
    assert timesync_answer(packed(dialect.MAVLink_timesync_message(0, asked_ns))) is None
    assert timesync_answer(heartbeat()) is None


def test_each_answer_counts_once_and_only_to_a_request_from_here() -> None:
    trips = RoundTrips()
    assert trips.median_s is None
    trips.asked(1_000_000_000)
    assert not trips.answered(999_999_999, 1_200_000_000)
    assert trips.answered(1_000_000_000, 1_200_000_000)
    assert not trips.answered(1_000_000_000, 1_900_000_000)
    assert trips.median_s == pytest.approx(0.2)


def test_old_round_trips_are_forgotten_and_single_late_ones_do_not_count() -> None:
    trips = RoundTrips()
    lasting_s = [1.0] * KEPT + [0.1] * (KEPT - 2) + [0.9] * 2
    for number, trip_s in enumerate(lasting_s, start=1):
        trips.asked(number)
        trips.answered(number, number + round(trip_s * 1e9))
    assert trips.median_s == pytest.approx(0.1)


def test_answers_to_own_requests_end_at_the_gate_and_those_to_others_pass() -> None:
    gate, claim = FrameGate(), Claim()
    gate.claims[1] = claim
    claim.verify(VEHICLE, 10.0)
    claim.round_trips.asked(10_000_000_000)
    own, other = (packed(dialect.MAVLink_timesync_message(5, ns)) for ns in (10_000_000_000, 4))
    assert gate.admit(own + heartbeat() + other, VEHICLE, 10.25) == heartbeat() + other
    assert claim.report().round_trip_s == pytest.approx(0.25)
