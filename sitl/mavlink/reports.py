"""The messages of the stub: the fields of each, in MAVLink units.

It converts from metres and the mission frame to north-east-down, degE7, millimetres and centidegrees.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import atan2, cos, degrees, nan, sin, sqrt, tau

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from estimation.frames import Geodetic, MissionFrame, Triple
from sitl.autopilot.airframe import GRAVITY_M_S2
from sitl.autopilot.autopilot import StubAutopilot
from sitl.autopilot.dialect import EstimatorState, TrueMotion, bounded_i16
from sitl.faults import VehicleFaults, shifted
from sitl.mavlink.gimbal import GimbalManager
from sitl.mavlink.signing import SigningKey
from sitl.mavlink_constants import Fields, MessageId, Outgoing

UID_OF_STUBS = 0x5354_5542_0000_0000
"""The unique id of system id 0: "STUB" in its upper half."""
CELLS = 4
CELL_EMPTY_V, CELL_FULL_V = 3.5, 4.2
UNKNOWN_U8, UNKNOWN_I16, UNKNOWN_U16 = 255, 32767, 65535
SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)
"""Without the GPS."""
POSITION_GATE_M, VELOCITY_GATE_M_S = 2.5, 1.5
"""The gates of the estimators' tests: five standard deviations of a GPS with errors of 0.5 m and 0.3 m/s."""
HOME_CORRECTED_M = 0.5
"""By how much a corrected height of home varies. PX4 corrects it for two minutes after a take-off."""
MOTION_MESSAGES = frozenset({MessageId.ATTITUDE, MessageId.LOCAL_POSITION_NED, MessageId.GLOBAL_POSITION_INT})
"""The messages with the vehicle's position and motion, beside that with the truth."""


@dataclass(frozen=True, slots=True)
class EstimatorNoise:
    """White noise on reported position and velocity, one sigma per axis."""

    position_m: float = 0.0
    velocity_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class MavlinkConfig:
    """A stub vehicle's MAVLink system id, the mission frame, and how its estimates differ from the truth.

    `origin_m` is the origin of its local NED in the mission frame [m]. `seed` is that of the `noise`. With a
    `signing_key` it signs its messages, and accepts signed ones only. `uid` is the reported unique id (None: a stub's).
    """

    system_id: int
    frame: MissionFrame
    origin_m: Triple
    noise: EstimatorNoise = field(default_factory=EstimatorNoise)
    seed: int | tuple[int, ...] = 0
    signing_key: SigningKey | None = None
    uid: int | None = None

    @property
    def reported_uid(self) -> int:
        """The reported unique id."""
        return UID_OF_STUBS + self.system_id if self.uid is None else self.uid


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimate at one time: position and velocity in the mission frame."""

    time_s: float
    position_m: Triple
    velocity_m_s: Triple


class TelemetryFields:
    """Computes each message's fields from the autopilot's state; messages of the same time share one estimate."""

    def __init__(
        self,
        autopilot: StubAutopilot,
        config: MavlinkConfig,
        faults: VehicleFaults,
        gimbal: GimbalManager | None = None,
    ) -> None:
        """Report the state of `autopilot` and its `gimbal`, with the `faults` that affect its motion."""
        self._autopilot = autopilot
        self._dialect = autopilot.DIALECT
        self._config = config
        self._random = np.random.default_rng(config.seed)
        self._faults = faults
        self._estimated = Estimate(-1.0, autopilot.airframe.position_m, autopilot.airframe.velocity_m_s)
        self._builders: dict[int, Callable[[], Fields | None]] = {
            MessageId.HEARTBEAT: self._heartbeat,
            MessageId.SYS_STATUS: self._sys_status,
            MessageId.GPS_RAW_INT: self._gps_raw_int,
            MessageId.ATTITUDE: self._attitude,
            MessageId.LOCAL_POSITION_NED: self._local_position_ned,
            MessageId.GLOBAL_POSITION_INT: self._global_position_int,
            MessageId.GPS_GLOBAL_ORIGIN: self._gps_global_origin,
            MessageId.ALTITUDE: self._altitude,
            MessageId.BATTERY_STATUS: self._battery_status,
            MessageId.AUTOPILOT_VERSION: self._autopilot_version,
            MessageId.HOME_POSITION: self._home_position,
            MessageId.EXTENDED_SYS_STATE: self._extended_sys_state,
            self._dialect.estimator_message: self._estimator,
            self._dialect.truth_message: self._truth,
            **({} if gimbal is None else gimbal.builders),
        }

    @property
    def origin_m(self) -> Triple:
        """The present origin of its local NED in the mission frame [m]."""
        return shifted(self._config.origin_m, self._faults.origin_moved_m)

    @property
    def known(self) -> frozenset[int]:
        """The ids of all messages that can be requested."""
        return frozenset(self._builders)

    def begin_mission(self) -> None:
        """Draw the noise from its seed again: a mission then has the same noise whenever it begins."""
        self._random = np.random.default_rng(self._config.seed)

    def report(self, message: int) -> list[Outgoing]:
        """Return a message, or nothing while the estimator is not ready; KeyError if the message is unknown."""
        if self._faults.motion_silent and message in {*MOTION_MESSAGES, self._dialect.truth_message}:
            return []
        if self._faults.battery_silent and message == MessageId.BATTERY_STATUS:
            return []
        if self._faults.gimbal_silent and message == MessageId.GIMBAL_DEVICE_ATTITUDE_STATUS:
            return []
        fields = self._builders[message]()
        second = [] if message != MessageId.BATTERY_STATUS else self._second_battery()
        return [] if fields is None else [(message, fields), *second]

    @property
    def _boot_ms(self) -> int:
        return round(self._autopilot.time_s * 1e3) % 2**32

    @property
    def _ready(self) -> bool:
        return self._autopilot.estimator_ready

    @property
    def _on_globe(self) -> bool:
        return self._autopilot.global_position_known

    def _estimate(self) -> Estimate:
        """Return the present estimate: the truth, its offset, and noise that is drawn once per time."""
        now_s = self._autopilot.time_s
        if self._estimated.time_s != now_s:
            airframe = self._autopilot.airframe
            position, velocity = shifted(airframe.position_m, self._faults.offset_m), airframe.velocity_m_s
            if self._config.noise.position_m > 0.0 or self._config.noise.velocity_m_s > 0.0:
                error = self._random.standard_normal(6).tolist()
                position = _disturbed(position, error[:3], self._config.noise.position_m)
                velocity = _disturbed(velocity, error[3:], self._config.noise.velocity_m_s)
            self._estimated = Estimate(now_s, position, velocity)
        return self._estimated

    def _ned_from_mission_place(self, place_m: Triple) -> Triple:
        x, y, z = place_m
        x0, y0, z0 = self.origin_m
        return self._config.frame.ned_from_mission((x - x0, y - y0, z - z0))

    def _heartbeat(self) -> Fields:
        autopilot = self._autopilot
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if autopilot.armed else 0
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | armed
        hil = self._dialect.hil_parameter
        if hil and autopilot.parameters[hil] != 0:
            flags |= mavlink.MAV_MODE_FLAG_HIL_ENABLED
        mode = self._dialect.modes[autopilot.mode][0]
        return mavlink.MAV_TYPE_QUADROTOR, self._dialect.autopilot, flags, mode, self._system_status(), 3

    def _system_status(self) -> int:
        autopilot = self._autopilot
        if autopilot.armed:
            return int(mavlink.MAV_STATE_CRITICAL if autopilot.failsafe else mavlink.MAV_STATE_ACTIVE)
        # Where the heartbeat shows the checks, it reports standby only if it can be armed.
        standby = autopilot.armable or not self._dialect.tells_checks_in_heartbeat
        return int(mavlink.MAV_STATE_STANDBY if standby else mavlink.MAV_STATE_UNINIT)

    def _sys_status(self) -> Fields:
        present = SENSORS
        if self._autopilot.gps:
            present |= mavlink.MAV_SYS_STATUS_SENSOR_GPS
        located = mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
        healthy = present if self._ready else present & ~located
        if self._autopilot.armable or self._autopilot.armed:
            healthy |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
        enabled = present | mavlink.MAV_SYS_STATUS_PREARM_CHECK
        millivolts = UNKNOWN_U16 if self._faults.values_unknown else sum(self._cell_mv())
        remaining = self._battery_percent()
        return enabled, enabled, healthy, 300, millivolts, -1, remaining, 0, 0, 0, 0, 0, 0

    def _gps_raw_int(self) -> Fields:
        time_us = self._boot_ms * 1000
        if not self._on_globe:
            return time_us, mavlink.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, *[UNKNOWN_U16] * 4, 0
        estimate = self._estimate()
        north, east, _ = self._config.frame.ned_from_mission(estimate.velocity_m_s)
        speed_cm_s = bounded_i16(100.0 * float(np.hypot(north, east)))
        unknown = (*[UNKNOWN_U16] * 4, UNKNOWN_U8)
        measured = unknown if self._faults.values_unknown else (70, 110, speed_cm_s, 0, 14)
        place_m = shifted(self._autopilot.airframe.position_m, self._faults.estimate_offset_m)
        return time_us, mavlink.GPS_FIX_TYPE_3D_FIX, *self._place(place_m), *measured

    def _attitude(self) -> Fields:
        airframe = self._autopilot.airframe
        x, y = airframe.acceleration_m_s2
        north, east, _ = self._config.frame.ned_from_mission((x, y, 0.0))
        heading = airframe.heading_rad
        ahead = north * cos(heading) + east * sin(heading)
        right = east * cos(heading) - north * sin(heading)
        roll, pitch = atan2(right, GRAVITY_M_S2), -atan2(ahead, GRAVITY_M_S2)
        return self._boot_ms, roll, pitch, heading, 0.0, 0.0, airframe.heading_rate_rad_s

    def _local_position_ned(self) -> Fields | None:
        if not self._ready:
            return None
        estimate = self._estimate()
        position = self._ned_from_mission_place(estimate.position_m)
        return self._boot_ms, *position, *self._config.frame.ned_from_mission(estimate.velocity_m_s)

    def _global_position_int(self) -> Fields | None:
        if not self._on_globe:
            return None
        estimate = self._estimate()
        relative_mm = round((estimate.position_m[2] - self._autopilot.home_m[2]) * 1e3)
        velocity = [bounded_i16(v * 100.0) for v in self._config.frame.ned_from_mission(estimate.velocity_m_s)]
        heading_cdeg = round(degrees(self._autopilot.airframe.heading_rad % tau) * 100.0) % 36000
        return self._boot_ms, *self._place(estimate.position_m), relative_mm, *velocity, heading_cdeg

    def _truth(self) -> Fields | None:
        if self._config.frame.is_local:
            return None
        airframe = self._autopilot.airframe
        velocity = self._config.frame.ned_from_mission(airframe.velocity_m_s)
        return self._dialect.truth(TrueMotion(self._place(airframe.position_m), velocity))

    def _gps_global_origin(self) -> Fields | None:
        return (*self._place(self.origin_m), self._boot_ms * 1000) if self._on_globe else None

    def _home_position(self) -> Fields | None:
        if not self._on_globe:
            return None
        x, y, z = self._autopilot.home_m
        if self._dialect.corrects_home and not self._autopilot.landed:
            z += HOME_CORRECTED_M * sin(self._autopilot.time_s)
        home = x, y, z
        local = self._ned_from_mission_place(home)
        return *self._place(home), *local, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, self._boot_ms * 1000

    def _altitude(self) -> Fields | None:
        """Return the barometer's altitude and those of the estimate; terrain is not simulated."""
        if not self._ready:
            return None
        sensed_m = self._autopilot.airframe.position_m[2] + self._faults.barometer_off_m
        told_m = self._estimate().position_m[2]
        origin = self._config.frame.origin
        datum_m = 0.0 if origin is None else origin.altitude_m
        above_home_m, above_origin_m = told_m - self._autopilot.home_m[2], told_m - self.origin_m[2]
        heights_m = (datum_m + sensed_m, datum_m + told_m, above_origin_m, above_home_m, nan, nan)
        return self._boot_ms * 1000, *heights_m

    def _battery_status(self) -> Fields:
        return self._battery(0, self._battery_percent())

    def _second_battery(self) -> list[Outgoing]:
        charge = self._faults.second_battery
        return [] if charge is None else [(MessageId.BATTERY_STATUS, self._battery(1, round(charge * 100.0)))]

    def _battery(self, number: int, percent: int) -> Fields:
        volts, temperature = [*self._cell_mv(), *[UNKNOWN_U16] * (10 - CELLS)], 2500
        endurance_s = round(self._faults.endurance_s or 0.0)  # 0 is unknown
        if self._faults.values_unknown:
            volts, temperature, endurance_s = [UNKNOWN_U16] * 10, UNKNOWN_I16, 0
        kind = mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO
        state = self._faults.charge_state
        return number, *kind, temperature, volts, -1, -1, -1, percent, endurance_s, state

    def _extended_sys_state(self) -> Fields:
        return 0, int(self._autopilot.landed_state)

    def _estimator(self) -> Fields:
        flags, accuracy_m = self._estimator_flags(), self._config.noise.position_m
        return self._dialect.estimator(EstimatorState(self._boot_ms, flags, self._shares_of_gates(), accuracy_m))

    def _shares_of_gates(self) -> tuple[float, float, float, float]:
        """Return the errors of the estimate relative to the gates: velocity, horizontal position, height, compass."""
        if self._faults.values_unknown:
            return nan, nan, nan, nan
        estimate, airframe = self._estimate(), self._autopilot.airframe
        position = np.subtract(estimate.position_m, airframe.position_m) / POSITION_GATE_M
        velocity = np.subtract(estimate.velocity_m_s, airframe.velocity_m_s) / VELOCITY_GATE_M_S
        horizontal = max(float(np.hypot(position[0], position[1])), sqrt(self._faults.estimator_ratio))
        height = abs(float(position[2]) - self._faults.unnoticed_m / POSITION_GATE_M)
        return float(np.linalg.norm(velocity)), horizontal, height, 0.0

    def _estimator_flags(self) -> int:
        """Attitude and height, from gyros and barometer, are always valid; the rest needs a source of position."""
        flags: int = mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_VELOCITY_VERT | mavlink.ESTIMATOR_POS_VERT_ABS
        if not self._ready:
            return int(flags | mavlink.ESTIMATOR_CONST_POS_MODE)
        flags |= (
            mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_PRED_POS_HORIZ_REL
        )
        if self._on_globe:
            flags |= mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
        return flags

    def _autopilot_version(self) -> Fields:
        no_hash = (0,) * 8
        version = self._dialect.firmware_version
        versions = (version, version, 0, 0)
        return self._dialect.capabilities, *versions, no_hash, no_hash, no_hash, 0, 0, self._config.reported_uid

    def _battery_percent(self) -> int:
        return -1 if self._faults.values_unknown else round(self._autopilot.battery_fraction * 100.0)

    def _cell_mv(self) -> list[int]:
        volts = CELL_EMPTY_V + (CELL_FULL_V - CELL_EMPTY_V) * self._autopilot.battery_fraction
        return [round(volts * 1e3)] * CELLS

    def _place(self, place_m: Triple) -> tuple[int, int, int]:
        return wire_place(self._config.frame.geodetic_from_mission(place_m))


def wire_place(place: Geodetic) -> tuple[int, int, int]:
    """Return latitude and longitude in degE7, altitude in millimetres."""
    return round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7), round(place.altitude_m * 1e3)


def _disturbed(value: Triple, error: list[float], sigma: float) -> Triple:
    x, y, z = (v + sigma * e for v, e in zip(value, error, strict=True))
    return x, y, z
