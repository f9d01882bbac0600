"""The MAVLink message ids and results that the stub uses, as types; it takes other constants from pymavlink."""

from enum import IntEnum
from typing import Any

Fields = tuple[Any, ...]


class MessageId(IntEnum):
    """The messages that stubs of all autopilots send."""

    HEARTBEAT = 0
    SYS_STATUS = 1
    PING = 4
    PARAM_VALUE = 22
    GPS_RAW_INT = 24
    ATTITUDE = 30
    LOCAL_POSITION_NED = 32
    GLOBAL_POSITION_INT = 33
    MISSION_COUNT = 44
    MISSION_ACK = 47
    GPS_GLOBAL_ORIGIN = 49
    MISSION_REQUEST_INT = 51
    MISSION_ITEM_INT = 73
    COMMAND_ACK = 77
    TIMESYNC = 111
    ALTITUDE = 141
    BATTERY_STATUS = 147
    AUTOPILOT_VERSION = 148
    HOME_POSITION = 242
    MESSAGE_INTERVAL = 244
    EXTENDED_SYS_STATE = 245
    STATUSTEXT = 253
    GIMBAL_MANAGER_INFORMATION = 280
    GIMBAL_MANAGER_STATUS = 281
    GIMBAL_DEVICE_INFORMATION = 283
    GIMBAL_DEVICE_ATTITUDE_STATUS = 285


Outgoing = tuple[int, Fields]
"""The id of a message, and its fields."""


class Result(IntEnum):
    """The MAV_RESULT values that are used."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
