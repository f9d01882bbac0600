"""A flight by pymavlink: arm, take off to a place in offboard, land."""

from math import dist

from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

PX4_OFFBOARD = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 6, 0)
POSITION_ONLY = 0b1101_1111_1000


def fly(url: str, north_m: float, east_m: float, height_m: float) -> None:
    """Fly the vehicle at `url` to a place relative to its start, and land there."""
    link = mavutil.mavlink_connection(url)
    try:
        link.wait_heartbeat()
        place_m = (north_m, east_m, -height_m)
        # PX4 is in offboard, and arms there, only while setpoints arrive.
        command(link, mavlink.MAV_CMD_DO_SET_MODE, *PX4_OFFBOARD, place_m=place_m)
        command(link, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, place_m=place_m)
        while dist(position_m(link), place_m) > 0.3:
            send_setpoint(link, place_m)
        command(link, mavlink.MAV_CMD_NAV_LAND)
        while link.recv_match(type="HEARTBEAT", blocking=True).base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
            pass
    finally:
        link.close()


def command(link, number, *parameters, place_m=None):
    """Send a command, after a setpoint if there is one, until it is accepted.

    All messages are read meanwhile: unread ones would fill the socket, and the answer would be lost.
    """
    padded = (*parameters, *[0.0] * 7)[:7]
    while True:
        if place_m is not None:
            send_setpoint(link, place_m)
        link.mav.command_long_send(link.target_system, link.target_component, number, 0, *padded)
        answer = link.recv_match(
            condition=f"COMMAND_ACK.command == {number}", type="COMMAND_ACK", blocking=True, timeout=1.0
        )
        if answer is not None and answer.result == mavlink.MAV_RESULT_ACCEPTED:
            return


def send_setpoint(link, place_m):
    """Send a position in the vehicle's local NED."""
    link.mav.set_position_target_local_ned_send(
        0,
        link.target_system,
        link.target_component,
        mavlink.MAV_FRAME_LOCAL_NED,
        POSITION_ONLY,
        *place_m,
        *[0.0] * 8,
    )


def position_m(link):
    """Wait for the next position, in the vehicle's local NED."""
    message = link.recv_match(type="LOCAL_POSITION_NED", blocking=True)
    return message.x, message.y, message.z
