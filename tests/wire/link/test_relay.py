"""The relay of the PX4 drills reads bytes by itself: held against pymavlink's."""

from struct import pack

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import custom_mode
from tests.support.relay import CURRENT_MODE, HEARTBEAT, SETPOINT, Message, flight_mode, is_armed, messages

SENDER = mavlink.MAVLink(None, 7, 1)
OFFBOARD = custom_mode(NavMode.OFFBOARD)


def packed(message: mavlink.MAVLink_message) -> bytes:
    return bytes(message.pack(SENDER))


def heartbeat(mode: int, base_mode: int) -> bytes:
    return packed(SENDER.heartbeat_encode(2, 12, base_mode, mode, 4))


def test_messages_are_told_apart_in_one_datagram() -> None:
    setpoint = packed(
        SENDER.set_position_target_local_ned_encode(0, 1, 1, 1, 0, 1.0, 2.0, -3.0, *[0.0] * 6, yaw=0.0, yaw_rate=0.0)
    )
    found = list(messages(heartbeat(OFFBOARD, 0) + setpoint + setpoint + heartbeat(0, 0)[:8]))
    assert [(each.sender, each.component, each.kind) for each in found] == [
        (7, 1, HEARTBEAT),
        (7, 1, SETPOINT),
        (7, 1, SETPOINT),
    ]


def test_modes_and_arming_are_read() -> None:
    for mode in NavMode:
        (message,) = messages(heartbeat(custom_mode(mode), 0b10000001))
        assert flight_mode(message) == custom_mode(mode)
        assert is_armed(message)
    (message,) = messages(heartbeat(0, 0b01010001))
    assert not is_armed(message)
    current = Message(7, 1, CURRENT_MODE, pack("<IIB", OFFBOARD, 0, 0).rstrip(b"\0"))  # pymavlink does not know it yet
    assert flight_mode(current) == OFFBOARD
