"""What the gate passes on where heartbeats are lost."""

from itertools import pairwise
from math import inf, nan
from typing import Any

import pytest
from pymavlink.dialects.v10 import common as dialect_v1
from pymavlink.dialects.v20 import common as dialect

from gcs.link.rates import ATTITUDE as ATTITUDE_NUMBER
from gcs.link.rates import LOCAL_POSITION_NED
from gcs.link.relay.frames import header, timed_numbers
from gcs.link.relay.gate import ADDRESSES_MAX, REPEAT_FOR_S, Claim, FrameGate
from gcs.link.relay.signing import Signing

VEHICLE = ("127.0.0.1", 14540)
MAVSDK_TIMEOUT_S = 3.0


def packed(message: dialect.MAVLink_message, system_id: int = 1) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, srcSystem=system_id, srcComponent=1)))


def heartbeat(system_id: int = 1, mode: int = 0, state: int = 3) -> bytes:
    return packed(dialect.MAVLink_heartbeat_message(2, 12, 0, mode, state, 3), system_id)


ATTITUDE = packed(dialect.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6))


def of_vehicles(*system_ids: int) -> FrameGate:
    gate = FrameGate()
    for system_id in system_ids:
        gate.claims[system_id] = Claim()
        gate.claims[system_id].verify(VEHICLE, 0.0)
    return gate


def heartbeats_s(last_s: float, attitude_until_s: float, until_s: float) -> list[float]:
    """Return when heartbeats come out: they come in once a second until one time, attitudes ten times until another."""
    gate, out = of_vehicles(1), []
    for tick in range(round(10 * until_s)):
        now_s, passed = tick / 10, b""
        if tick % 10 == 0 and now_s <= last_s:
            passed += gate.admit(heartbeat(), VEHICLE, now_s)
        if now_s <= attitude_until_s:
            passed += gate.admit(ATTITUDE, VEHICLE, now_s)
        out += [now_s] * passed.count(heartbeat())
    return out


def test_lost_heartbeats_of_a_vehicle_that_is_heard_are_made_up_for_but_not_for_ever() -> None:
    at_s = heartbeats_s(5.0, inf, 30.0)
    assert max(later - earlier for earlier, later in pairwise(at_s)) < MAVSDK_TIMEOUT_S - 1.0
    assert at_s[-1] == pytest.approx(5.0 + REPEAT_FOR_S, abs=1.6)


def test_a_vehicle_that_is_silent_is_lost_at_once() -> None:
    assert heartbeats_s(5.0, 5.0, 30.0) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_after_a_break_the_vehicle_itself_has_to_say_its_mode() -> None:
    gate = of_vehicles(1)
    gate.admit(heartbeat(), VEHICLE, 0.0)
    gate.admit(ATTITUDE, VEHICLE, 0.9)
    assert gate.admit(ATTITUDE, VEHICLE, 2.0) == ATTITUDE


def test_what_is_heard_of_one_vehicle_is_no_life_of_another() -> None:
    gate = of_vehicles(1, 2)
    for system_id in (1, 2):
        gate.admit(heartbeat(system_id), VEHICLE, 0.0)
    gate.admit(ATTITUDE, VEHICLE, 0.9)
    assert gate.admit(ATTITUDE, VEHICLE, 1.8) == ATTITUDE + heartbeat(1)


ACTIVE, CRITICAL, EMERGENCY = 4, 5, 6
OFFBOARD, HOLD, LANDS = 6 << 16, 3 << 24 | 4 << 16, 6 << 24 | 4 << 16


@pytest.mark.parametrize("acts", [CRITICAL, EMERGENCY])
def test_a_failsafe_changed_the_mode_only_if_it_begins_with_the_change(acts: int) -> None:
    gate = of_vehicles(1, 2)

    def failsafe(mode: int, state: int, system_id: int = 1) -> bool:
        gate.admit(heartbeat(system_id, mode, state), VEHICLE, 0.0)
        return gate.claims[1].report().failsafe

    assert not failsafe(OFFBOARD, ACTIVE)
    assert not failsafe(LANDS, acts, system_id=2)
    assert failsafe(LANDS, acts)
    assert failsafe(LANDS, ACTIVE), "the mode is the same"
    assert not failsafe(OFFBOARD, ACTIVE)
    assert not failsafe(OFFBOARD, acts)
    assert not failsafe(HOLD, acts), "critical before: someone else may have changed it"


def test_forgers_at_many_addresses_keep_no_signed_vehicle_out() -> None:
    key, gate = bytes(range(32)), FrameGate()
    claim = gate.claims[1] = Claim(Signing(key))
    for port in range(2 * ADDRESSES_MAX):
        gate.admit(heartbeat(), ("192.0.2.1", port), 0.0)
    behind = Signing(key, lambda: 0)
    gate.admit(behind.sign(heartbeat()), VEHICLE, 0.0)
    assert claim.to_set_in_time() == [VEHICLE]
    assert gate.is_vehicle(VEHICLE)
    gate.admit(Signing(key).sign(heartbeat()), VEHICLE, 0.0)
    assert list(claim.candidates) == [VEHICLE]
    assert len(claim.rejected) <= ADDRESSES_MAX


def motion(component: int = 1, sender: int = 1) -> bytes:
    message = dialect.MAVLink_local_position_ned_message(70_000, 1.5, -2.25, -3.0, 0.5, 0.0, 0.0)
    return bytes(message.pack(dialect.MAVLink(None, srcSystem=sender, srcComponent=component)))


def test_what_listens_to_the_autopilot_gets_its_motion_instead_of_mavsdk_and_its_attitude_beside_it() -> None:
    gate, heard = of_vehicles(1, 2), list[bytes]()
    gate.claims[1].listeners = {LOCAL_POSITION_NED: heard.append, ATTITUDE_NUMBER: heard.append}
    others = motion(component=191) + motion(sender=2) + heartbeat()
    assert gate.admit(motion() + ATTITUDE + others, VEHICLE, 0.0) == ATTITUDE + others
    assert heard == [motion(), ATTITUDE]
    assert gate.claims[1].messages[LOCAL_POSITION_NED] == 2


def test_motion_that_mavsdk_does_not_get_shows_life_nevertheless() -> None:
    gate = of_vehicles(1)
    gate.claims[1].listeners = {LOCAL_POSITION_NED: lambda _frame: None}
    gate.admit(heartbeat(), VEHICLE, 0.0)
    gate.admit(motion(), VEHICLE, 0.9)
    assert gate.admit(motion(), VEHICLE, 1.8) == heartbeat()


def test_the_newest_heartbeat_of_a_verified_sender_is_kept() -> None:
    gate = FrameGate()
    claim = gate.claims[1] = Claim()
    gate.admit(heartbeat(mode=1), VEHICLE, 0.0)
    assert claim.verify(VEHICLE, 0.1) == claim.heartbeat == heartbeat(mode=1)
    gate.admit(heartbeat(mode=2), VEHICLE, 1.0)
    assert claim.heartbeat == heartbeat(mode=2)


@pytest.mark.parametrize("version", [dialect, dialect_v1])
def test_motion_and_attitude_are_read_as_pymavlink_writes_them(version: Any) -> None:
    sender = version.MAVLink(None, srcSystem=1, srcComponent=1)
    numbers = (0.1, -2.5, 3e4, 0.0, nan, 0.0)
    for make in (version.MAVLink_local_position_ned_message, version.MAVLink_attitude_message):
        frame = bytes(make(70_123, *numbers).pack(sender))
        read = timed_numbers(frame)
        assert read is not None
        assert read.time_ms == 70_123
        assert read[1:] == pytest.approx(numbers, rel=1e-7, nan_ok=True)
        for at in range(2, len(frame)):  # the length, before, decides what the frame is
            damaged = frame[:at] + bytes((frame[at] ^ 1,)) + frame[at + 1 :]
            assert _is_refused(damaged), at


def _is_refused(frame: bytes) -> bool:
    """Return whether a damaged frame is, which may seem to be another message."""
    return header(frame).message not in (LOCAL_POSITION_NED, ATTITUDE_NUMBER) or timed_numbers(frame) is None
