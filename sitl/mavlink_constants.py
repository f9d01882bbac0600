"""The MAVLink message ids, rates, flags and constants that the stub uses."""

from enum import IntEnum, IntFlag
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


Outgoing = tuple[int, Fields]
"""The id of a message, and its fields."""


class Result(IntEnum):
    """The MAV_RESULT values that are used."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class ModeFlag(IntFlag):
    """The MAV_MODE_FLAG values that are used."""

    CUSTOM_MODE_ENABLED = 1
    HIL_ENABLED = 32
    SAFETY_ARMED = 128


class SensorFlag(IntFlag):
    """The MAV_SYS_STATUS_SENSOR values that are used."""

    GYRO = 1
    ACCEL = 2
    MAG = 4
    PRESSURE = 8
    GPS = 32
    POSITION = 1 << 14
    BATTERY = 1 << 25
    PREARM_CHECK = 1 << 28


class EstimatorFlag(IntFlag):
    """The common values of ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS."""

    ATTITUDE = 1
    VELOCITY_HORIZ = 2
    VELOCITY_VERT = 4
    POS_HORIZ_REL = 8
    POS_HORIZ_ABS = 16
    POS_VERT_ABS = 32
    CONST_POS_MODE = 128
    PRED_POS_HORIZ_REL = 256
    PRED_POS_HORIZ_ABS = 512


QUADROTOR = 2
UID_OF_STUBS = 0x5354_5542_0000_0000
"""The unique id of system id 0: "STUB" in its upper half."""
UNINITIALISED, STANDBY, ACTIVE, CRITICAL = 0, 3, 4, 5
GPS_FIX_NONE, GPS_FIX_3D = 1, 3
CELLS = 4
CELL_EMPTY_V, CELL_FULL_V = 3.5, 4.2
LITHIUM_POLYMER, ALL_FUNCTIONS, CHARGE_OK = 1, 1, 1
"""MAV_BATTERY_TYPE, MAV_BATTERY_FUNCTION, and MAV_BATTERY_CHARGE_STATE."""
UNKNOWN_U8, UNKNOWN_I16, UNKNOWN_U16 = 255, 32767, 65535
