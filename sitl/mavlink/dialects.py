"""The differences between the MAVLink dialects of the simulated autopilots, PX4 and ArduCopter."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

from sitl.autopilot.modes import NavMode
from sitl.mavlink_constants import PX4_RATES_HZ, MessageId, Result


class AutopilotKind(Enum):
    """The simulated autopilot of a stub."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


@dataclass(frozen=True, slots=True)
class Dialect:
    """One autopilot's MAVLink.

    `autopilot` is its MAV_AUTOPILOT, `modes` each mode's number in heartbeats and its two parameters of DO_SET_MODE,
    `rates_hz` the default streams, `streams` the messages of REQUEST_DATA_STREAM by stream, `estimator_message` the
    message of the estimator's status, `truth_message` the message of the simulator's true motion.
    """

    autopilot: int
    system_id_parameter: str
    firmware_version: int
    capabilities: int
    refused: Result
    modes: Mapping[NavMode, tuple[int, float, float]]
    rates_hz: Mapping[int, float]
    estimator_message: MessageId
    truth_message: MessageId
    streams: Mapping[int, tuple[MessageId, ...]] = field(default_factory=dict)
    acknowledges_mode_first: bool = False
    tells_checks_in_heartbeat: bool = False
    parameters_bytewise: bool = False
    take_off_from_home: bool = False

    def custom_mode(self, mode: NavMode) -> int:
        """Return the heartbeat's custom_mode field."""
        return self.modes[mode][0]

    def mode_of(self, main: float, sub: float) -> NavMode | None:
        """Return the mode of DO_SET_MODE's second and third parameters, None if there is none."""
        return next((mode for mode, (_, *numbers) in self.modes.items() if tuple(numbers) == (main, sub)), None)


PX4 = Dialect(
    autopilot=12,
    system_id_parameter="MAV_SYS_ID",
    firmware_version=1 << 24 | 17 << 16 | 0 << 8 | 255,
    # Mission and command items as integers, parameters bytewise, local setpoints, MAVLink 2, fences.
    capabilities=2 | 4 | 8 | 16 | 128 | 8192 | 16384,
    refused=Result.TEMPORARILY_REJECTED,
    modes=MappingProxyType({mode: (mode.custom_mode, float(mode.value[0]), float(mode.value[1])) for mode in NavMode}),
    rates_hz=PX4_RATES_HZ,
    estimator_message=MessageId.ESTIMATOR_STATUS,
    truth_message=MessageId.HIL_STATE_QUATERNION,
    acknowledges_mode_first=True,
    tells_checks_in_heartbeat=True,
    parameters_bytewise=True,
)

_COPTER_MODES = {
    NavMode.STABILIZED: 0,
    NavMode.ALTITUDE: 2,
    NavMode.OFFBOARD: 4,
    NavMode.POSITION: 5,
    NavMode.RETURN: 6,
    NavMode.LAND: 9,
    NavMode.HOLD: 17,
}
"""STABILIZE, ALT_HOLD, GUIDED, LOITER, RTL, LAND, BRAKE."""

_EXTENDED_STATUS = (MessageId.SYS_STATUS, MessageId.GPS_RAW_INT)
_POSITION = (MessageId.GLOBAL_POSITION_INT, MessageId.LOCAL_POSITION_NED)
_ATTITUDE = (MessageId.ATTITUDE,)
_BATTERY = (MessageId.BATTERY_STATUS,)

ARDUCOPTER = Dialect(
    autopilot=3,
    system_id_parameter="SYSID_THISMAV",
    firmware_version=4 << 24 | 7 << 16 | 0 << 8 | 0,
    # Mission and command items as integers, local setpoints, MAVLink 2, fences, parameters as numbers.
    capabilities=1 | 2 | 4 | 8 | 128 | 8192 | 16384 | 131072,
    refused=Result.FAILED,
    modes=MappingProxyType({mode: (number, float(number), 0.0) for mode, number in _COPTER_MODES.items()}),
    rates_hz=MappingProxyType({MessageId.HEARTBEAT: 1.0}),
    estimator_message=MessageId.EKF_STATUS_REPORT,
    truth_message=MessageId.SIM_STATE,
    streams=MappingProxyType(
        {
            0: (*_EXTENDED_STATUS, *_POSITION, *_ATTITUDE, *_BATTERY),
            2: _EXTENDED_STATUS,
            6: _POSITION,
            10: _ATTITUDE,
            12: _BATTERY,
        }
    ),
    take_off_from_home=True,
)
