"""What waits for a slow connection: at what rate it leaves, in what order, and how old it is."""

from itertools import pairwise
from math import inf

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs.link.relay.frames import buffer_free, header, target_system
from gcs.link.relay.gate import Sequences
from gcs.link.relay.relay import TransmitQueue

PLACE = ("line", 57600)
SENDER = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)


def setpoint(vehicle: int, north_m: float) -> bytes:
    fields = (1, vehicle, 1, 1, 0, north_m, 0.0, -5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0)
    return bytes(SENDER.set_position_target_local_ned_encode(*fields).pack(SENDER))


def command(vehicle: int) -> bytes:
    return bytes(SENDER.command_long_encode(vehicle, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(SENDER))


def parameter(vehicle: int) -> bytes:
    return bytes(SENDER.param_request_read_encode(vehicle, 1, b"MAV_SYS_ID", -1).pack(SENDER))


def north_m(frame: bytes) -> float:
    decoded = mavlink.MAVLink(None).parse_buffer(frame)
    assert decoded is not None
    return float(decoded[0].x)


def drained(queue: TransmitQueue, until_s: float, step_s: float = 0.001) -> list[tuple[float, bytes]]:
    """Return what leaves from time 0 on, with its time."""
    steps = (index * step_s for index in range(round(until_s / step_s)))
    return [(now_s, frame) for now_s in steps for frame, _ in queue.due(now_s)]


def test_no_more_leaves_than_the_connection_carries() -> None:
    queue = TransmitQueue(bytes_s=1000.0)
    for _ in range(50):
        queue.put(parameter(1), PLACE)
    sent = drained(queue, 1.0)
    assert sum(len(frame) for _, frame in sent) == pytest.approx(1000.0, abs=30.0 + 2 * len(parameter(1)))


def test_signatures_take_room_too() -> None:
    plain, signed = TransmitQueue(bytes_s=1000.0), TransmitQueue(bytes_s=1000.0, extra_bytes=13)
    for _ in range(80):
        plain.put(parameter(1), PLACE)
        signed.put(parameter(1), PLACE)
    longer = (len(parameter(1)) + 13) / len(parameter(1))
    assert len(drained(plain, 1.0)) / len(drained(signed, 1.0)) == pytest.approx(longer, rel=0.1)


def test_setpoints_leave_at_their_rate_whatever_is_repeated_and_the_newest_does() -> None:
    queue, sent = TransmitQueue(bytes_s=5760.0, setpoint_hz=5.0), list[tuple[float, float]]()
    for index in range(200):  # a new one each 100 ms, repeated each 10 ms
        now_s = index * 0.01
        queue.put(setpoint(1, now_s // 0.1), PLACE)
        sent += [(now_s, north_m(frame)) for frame, _ in queue.due(now_s)]
    assert len(sent) == pytest.approx(10, abs=1)
    assert all(value == now_s // 0.1 for now_s, value in sent)


@pytest.mark.parametrize(("setpoint_hz", "copies"), [(25.0, 3), (15.0, 2)])
def test_copies_of_a_setpoint_leave_apart_in_time_and_only_until_they_are_used_up(
    setpoint_hz: float, copies: int
) -> None:
    queue, sent = TransmitQueue(setpoint_hz=setpoint_hz), list[tuple[float, float]]()
    queue.copies = copies
    for index in range(2000):  # a new one each 100 ms, for a second
        now_s = index * 0.001
        if now_s <= 1.0 and index % 100 == 0:
            queue.put(setpoint(1, now_s), PLACE)
        sent += [(now_s, north_m(frame)) for frame, _ in queue.due(now_s)]
    assert sum(now_s < 1.0 for now_s, _ in sent) == pytest.approx(setpoint_hz, abs=1.0)
    assert all(later - earlier >= 0.7 / setpoint_hz for (earlier, _), (later, _) in pairwise(sent))
    assert all(now_s - value < 0.1 for now_s, value in sent[: -copies + 1])
    assert [value for _, value in sent].count(1.0) == copies
    assert queue.due_s() == inf


def test_a_tick_that_is_a_little_early_is_not_skipped() -> None:
    queue, sent = TransmitQueue(setpoint_hz=10.0), 0
    for index in range(100):
        early_s = 0.015 * (index % 2)
        queue.put(setpoint(1, index), PLACE)
        sent += len(queue.due(index * 0.1 - early_s))
    assert sent == 100


def test_commands_go_before_setpoints_and_both_before_the_rest() -> None:
    queue = TransmitQueue(bytes_s=100.0)
    for frame in (parameter(1), setpoint(1, 1.0), command(1)):
        queue.put(frame, PLACE)
    assert [header(frame).message for _, frame in drained(queue, 3.0)] == [76, 84, 20]


def test_vehicles_take_turns_where_there_is_not_room_for_all() -> None:
    queue, counts = TransmitQueue(bytes_s=650.0, setpoint_hz=50.0), dict.fromkeys((1, 2, 3), 0)
    for index in range(500):
        for vehicle in counts:
            queue.put(setpoint(vehicle, index), PLACE)
        for frame, _ in queue.due(index * 0.01):
            counts[target_system(frame)] += 1
    assert sum(counts.values()) == pytest.approx(50, abs=2)
    assert max(counts.values()) - min(counts.values()) <= 1


def test_parameters_that_nobody_takes_are_dropped_and_counted() -> None:
    queue = TransmitQueue(bytes_s=1.0)
    for _ in range(1000):
        queue.put(parameter(1), PLACE)
    assert queue.dropped == 1000 - 4096 // len(parameter(1))


def test_the_next_time_is_that_of_what_waits() -> None:
    queue = TransmitQueue(bytes_s=100.0, setpoint_hz=10.0)
    assert queue.due_s() == inf
    queue.put(setpoint(1, 0.0), PLACE)
    assert queue.due_s() <= 5.0
    assert queue.due(5.0)
    queue.put(setpoint(1, 0.0), PLACE)  # a repetition: a whole period later, and after 65 bytes at 100 a second
    assert queue.due_s() == pytest.approx(5.0 - 0.03 + 0.65)


def test_addressed_systems_and_a_radios_buffer_are_read_from_the_bytes() -> None:
    assert [target_system(frame) for frame in (setpoint(7, 1.0), command(9), parameter(3))] == [7, 9, 0]
    radio = mavlink.MAVLink(None, srcSystem=51, srcComponent=68)
    for free in (100, 37, 0):
        status = radio.radio_status_encode(200, 200, free, 0, 0, 0, 0)
        assert buffer_free(bytes(status.pack(radio))) == free / 100.0
    assert buffer_free(command(1)) is None


def pointing(vehicle: int, pitch: float) -> bytes:
    fields = (vehicle, 1, 16, 1, [pitch, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
    return bytes(SENDER.gimbal_manager_set_attitude_encode(*fields).pack(SENDER))


def test_of_each_gimbals_directions_the_newest_leaves_and_after_everything_else() -> None:
    queue = TransmitQueue(bytes_s=1000.0, setpoint_hz=10.0)
    for number in range(100):
        queue.put(pointing(1, float(number)), PLACE)
        queue.put(pointing(2, float(-number)), PLACE)
    assert target_system(pointing(2, 1.0)) == 2
    queue.put(parameter(1), PLACE)
    queue.put(setpoint(1, 3.0), PLACE)
    queue.put(command(1), PLACE)
    sent = [frame for _, frame in drained(queue, 1.0)]
    assert [header(frame).message for frame in sent] == [76, 84, 20, 282, 282]
    decoded = [(mavlink.MAVLink(None).parse_buffer(frame) or [])[0] for frame in sent[3:]]
    assert [(each.target_system, each.q[0]) for each in decoded] == [(1, 99.0), (2, -99.0)]
    assert queue.due_s() == float("inf")


def test_one_sender_counts_on_and_gaps_are_what_was_lost() -> None:
    one = Sequences()
    for number in [*range(250, 256), *range(10), 13, 14]:
        one.take(1, number)
    assert (one.received, one.missed, one.bursts, one.is_doubled) == (18, 3, 1, False)


@pytest.mark.parametrize("apart", [0, 1, 100])
def test_two_senders_with_one_id_count_forth_and_back(apart: int) -> None:
    two = Sequences()
    for number in range(20):
        two.take(1, number)
        two.take(1, (apart + number) % 256)
    assert two.is_doubled


def test_components_count_for_themselves_and_a_restart_is_one_step_back() -> None:
    system = Sequences()
    for number in range(40):
        system.take(1, 100 + number)
        system.take(2, number)
    system.take(1, 20)
    assert not system.is_doubled
    assert system.missed == 0
