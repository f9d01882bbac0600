"""What one autopilot has to state about itself: numbers, names and texts, and functions where those are not enough."""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from math import inf, isfinite
from typing import Any, Literal, NamedTuple

STUB_UID = 0x5354_5542
"""The upper half of the unique id that cordon's stubs report, "STUB"."""


class VehicleKind(Enum):
    """The kind of a vehicle."""

    FLIGHT = "real flight"
    BOARD = "board with a simulated body"
    BOARD_OUTER = "board with an outer simulator"
    SIMULATOR = "simulator in software"
    STUB = "stub"
    UNKNOWN = "unknown"

    @property
    def is_simulated(self) -> bool:
        """Whether it is certain that no real vehicle flies; an unknown kind may fly."""
        return self not in (VehicleKind.FLIGHT, VehicleKind.UNKNOWN)

    @property
    def is_board(self) -> bool:
        """Whether it is hardware with a simulated body: its outputs may be live."""
        return self in (VehicleKind.BOARD, VehicleKind.BOARD_OUTER)


@dataclass(frozen=True, slots=True)
class Evidence:
    """The evidence of a vehicle's kind; None for what it did not report.

    `uid` and `vendor_id` are those of its AUTOPILOT_VERSION, `hil` the flag MAV_MODE_FLAG_HIL_ENABLED of its
    heartbeats, `parameters` those that were asked for.
    """

    system_id: int
    uid: int | None = None
    vendor_id: int | None = None
    hil: bool = False
    parameters: Mapping[str, float | None] = field(default_factory=dict)


CORDON_ID = 245
"""MAVSDK's system id as a ground station."""
ATTITUDE, POS_HORIZ_REL, POS_HORIZ_ABS, POS_VERT_ABS, PRED_POS_HORIZ_REL, PRED_POS_HORIZ_ABS = 1, 8, 16, 32, 256, 512
"""The flags that the estimators' reports have in common."""
SENSORS = ("horizontal position", "height", "velocity", "compass")
INTEGER_LAST = 6
"""The last MAV_PARAM_TYPE of an integer of 32 bits or less; 9 is a 32-bit float."""
CROSSING = "the vehicle climbs and flies home across the other vehicles' paths, without separation by the guard"
MOTORS_STOP = "the motors stop, and the vehicle falls"

Fields = Mapping[str, Any]
"""The fields of a message by their names."""
Judgement = tuple[Literal["pass", "warning", "refuse"], str, str, str]
"""Grade, meaning of the value, reason, and next step."""
Judge = Callable[[float], Judgement]
Limits = tuple[tuple[str, float], ...]
"""The possible names of a parameter that limits the motion, with its unit in SI; names depend on the version."""
Topic = Literal[
    "airframe", "hold", "rates", "streams", "bench", "simulation", "system id", "signing", "alone", "gimbal"
]
"""What the operator is told about each autopilot: parameters to check or to set, and what it does by itself."""


@dataclass(frozen=True, slots=True)
class TruthMessage:
    """One simulator's message, and how to read latitude, longitude [deg], altitude [m] and velocity from its fields."""

    name: str
    number: int
    size_bytes: int
    place: Callable[[Fields], tuple[float, float, float]]
    velocity_ned_m_s: Callable[[Fields], tuple[float, float, float]]


@dataclass(frozen=True, slots=True)
class EstimatorDialect:
    """One autopilot's estimator report: message, fields of the test ratios of SENSORS, and its flags.

    Any bit of `relative` or `absolute` stands for a horizontal position; `errors` maps a bit to its fault. Its `wind`
    has a message of its own, with that number; the speed is that of the components named.
    """

    message: str
    number: int
    ratios: tuple[str, str, str, str]
    relative: int
    absolute: int
    errors: Mapping[int, str]
    glitch: int
    wind: str
    wind_number: int
    wind_components: tuple[str, ...]


class FenceLimits(NamedTuple):
    """The fence in force: name and value of its limits from and above home, whether its areas act, and if a breach
    stops the motors, the setting that does and the next step.
    """

    across: tuple[str, float] | None
    up: tuple[str, float] | None
    areas: bool
    terminates: tuple[str, str] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Autopilot:
    """One autopilot. What others do by its kind they ask here.

    `name` is that of its profile and its files, `number` its MAV_AUTOPILOT. Its simulators send to `simulator_port` and
    those above. In its `guided_mode` it takes off and follows setpoints, None if take-off has a mode of its own. `mode`
    names a mode's number, `external_mode` is the one that follows setpoints. `leaves_offboard_s` is how long it does
    without an agent, `setpoint_timeout` names the parameter of how long without setpoints, with its default [s].
    `failed_check` is a pattern of its texts. `failsafe_parameters` are those that docs/hardware.md
    requires, given how many of its seconds pass in one of its link. `fence` reads the values of `fence_parameters`.
    `station_failsafe` is the parameter of the failsafe of a silent station, if that monitors one of `station_ids`.
    """

    name: str
    label: str
    number: int
    simulator_port: int
    guided_mode: int | None
    mode: Callable[[int], str]
    external_mode: str
    parameters_bytewise: bool
    leaves_offboard_s: float
    failed_check: str
    truth: TruthMessage
    estimator: EstimatorDialect
    kind: Callable[[Evidence], VehicleKind]
    failsafe_parameters: Callable[[float], Mapping[str, int | float]]
    judges: Mapping[str, Judge]
    fence_parameters: tuple[str, ...]
    fence: Callable[[Mapping[str, float]], FenceLimits]
    speed_limits: Limits
    acceleration_limits: Limits
    advice: Mapping[Topic, str]
    setpoint_timeout: tuple[str, float] = ("", inf)
    station_failsafe: str = ""
    station_ids: tuple[str, ...] = ()

    @property
    def is_known(self) -> bool:
        """Whether cordon knows its failsafes: it flies no other."""
        return bool(self.judges)

    @property
    def parameters_wanted(self) -> tuple[tuple[str, ...], ...]:
        """The parameters to read; an entry of several names is complete once one of them is received."""
        if not self.is_known:
            return ()
        limits = (tuple(name for name, _ in table) for table in (self.speed_limits, self.acceleration_limits))
        single = (self.advice["simulation"], *self.judges, *self.fence_parameters)
        return (*((name,) for name in single), *limits, *((self.station_ids,) if self.station_ids else ()))

    def setpoint_timeout_s(self, parameters: Mapping[str, float | None]) -> float:
        """Return the time without setpoints after which it leaves `external_mode` [s]; infinity: it stays."""
        name, default_s = self.setpoint_timeout
        value_s = parameters.get(name)
        return default_s if value_s is None else value_s

    def parameter(self, wire_type: int, value: float) -> int | float | None:
        """Decode a PARAM_VALUE, None if it is no number: integers come as the bytes of a float, or as a float."""
        if self.parameters_bytewise and wire_type <= INTEGER_LAST:
            return int(struct.unpack("<i", struct.pack("<f", value))[0])
        return float(value) if isfinite(value) else None
