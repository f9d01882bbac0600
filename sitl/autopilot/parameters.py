"""The stub's parameters: names, types and defaults of an autopilot, as far as a ground station reads them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

Value = int | float


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """The flight limits of a vehicle, independent of parameter names: speeds, ramps and margins in SI units."""

    cruise_m_s: float
    climb_m_s: float
    sink_m_s: float
    land_m_s: float
    crawl_m_s: float
    take_off_m_s: float
    take_off_ramp_s: float
    spool_up_s: float
    return_rise_m: float
    altitude_margin_m: float


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """One autopilot's parameters: names with defaults, and the function that derives the flight limits."""

    defaults: Mapping[str, Value]
    limits: Callable[[Mapping[str, Value]], FlightLimits]


DEFAULTS: Mapping[str, Value] = MappingProxyType(
    {
        "COM_ARM_WO_GPS": 1,
        "COM_DISARM_LAND": 2.0,
        "COM_DISARM_PRFLT": 10.0,
        "COM_DL_LOSS_T": 10,
        "COM_OBL_RC_ACT": 0,
        "COM_OF_LOSS_T": 1.0,
        "COM_RCL_EXCEPT": 0,
        "COM_RC_IN_MODE": 1,
        "COM_SPOOLUP_TIME": 1.0,
        "GF_ACTION": 2,
        "GF_MAX_HOR_DIST": 0.0,
        "GF_MAX_VER_DIST": 0.0,
        "GF_SOURCE": 0,
        "MAV_SYS_ID": 1,
        "MAV_TYPE": 2,
        "MIS_TAKEOFF_ALT": 2.5,
        "MPC_ACC_HOR": 3.0,
        "MPC_LAND_CRWL": 0.3,
        "MPC_LAND_SPEED": 0.7,
        "MPC_TKO_RAMP_T": 3.0,
        "MPC_TKO_SPEED": 1.5,
        "MPC_XY_CRUISE": 5.0,
        "MPC_XY_VEL_MAX": 12.0,
        "MPC_Z_VEL_MAX_DN": 1.5,
        "MPC_Z_VEL_MAX_UP": 3.0,
        "NAV_DLL_ACT": 0,
        "NAV_MC_ALT_RAD": 0.8,
        "NAV_RCL_ACT": 2,
        "RTL_DESCEND_ALT": 10.0,
        "RTL_RETURN_ALT": 30.0,
        "SYS_AUTOSTART": 10040,
        "SYS_HITL": 0,
    }
)
"""PX4 1.17's, of a multicopter in its simulator. An int is a 32-bit integer on the wire, a float a 32-bit float."""


def _px4_limits(values: Mapping[str, Value]) -> FlightLimits:
    return FlightLimits(
        cruise_m_s=values["MPC_XY_CRUISE"],
        climb_m_s=values["MPC_Z_VEL_MAX_UP"],
        sink_m_s=values["MPC_Z_VEL_MAX_DN"],
        land_m_s=values["MPC_LAND_SPEED"],
        crawl_m_s=values["MPC_LAND_CRWL"],
        take_off_m_s=values["MPC_TKO_SPEED"],
        take_off_ramp_s=values["MPC_TKO_RAMP_T"],
        spool_up_s=values["COM_SPOOLUP_TIME"],
        return_rise_m=values["RTL_RETURN_ALT"],
        altitude_margin_m=values["NAV_MC_ALT_RAD"],
    )


ARDUCOPTER_DEFAULTS: Mapping[str, Value] = MappingProxyType(
    {
        "ARMING_CHECK": 1,
        "DISARM_DELAY": 10,
        "FENCE_ACTION": 1,
        "FENCE_ALT_MAX": 100.0,
        "FENCE_ENABLE": 0,
        "FENCE_RADIUS": 300.0,
        "FENCE_TYPE": 7,
        "FRAME_CLASS": 1,
        "FS_CRASH_CHECK": 1,
        "FS_EKF_ACTION": 1,
        "FS_EKF_THRESH": 0.8,
        "FS_GCS_ENABLE": 0,
        "FS_GCS_TIMEOUT": 5.0,
        "FS_OPTIONS": 16,
        "FS_THR_ENABLE": 1,
        "GUID_OPTIONS": 0,
        "GUID_TIMEOUT": 3.0,
        "LAND_SPEED": 50.0,
        "MOT_SPOOL_TIME": 0.5,
        "PSC_JERK_XY": 5.0,
        "RTL_ALT": 1500.0,
        "SIM_OPOS_LAT": 47.397742,
        "SYSID_MYGCS": 255,
        "SYSID_THISMAV": 1,
        "TKOFF_SLEW_TIME": 2.0,
        "WPNAV_ACCEL": 250.0,
        "WPNAV_RADIUS": 200.0,
        "WPNAV_SPEED": 500.0,
        "WPNAV_SPEED_DN": 150.0,
        "WPNAV_SPEED_UP": 250.0,
    }
)
"""ArduCopter's, in centimetres although the names do not show it. GUID_TIMEOUT ends velocities, not positions."""


def _arducopter_limits(values: Mapping[str, Value]) -> FlightLimits:
    return FlightLimits(
        cruise_m_s=values["WPNAV_SPEED"] / 100.0,
        climb_m_s=values["WPNAV_SPEED_UP"] / 100.0,
        sink_m_s=values["WPNAV_SPEED_DN"] / 100.0,
        land_m_s=values["LAND_SPEED"] / 100.0,
        crawl_m_s=values["LAND_SPEED"] / 100.0,
        take_off_m_s=values["WPNAV_SPEED_UP"] / 100.0,
        take_off_ramp_s=values["TKOFF_SLEW_TIME"],
        spool_up_s=values["MOT_SPOOL_TIME"],
        return_rise_m=values["RTL_ALT"] / 100.0,
        altitude_margin_m=values["WPNAV_RADIUS"] / 100.0,
    )


PX4_TABLE = ParameterTable(DEFAULTS, _px4_limits)
ARDUCOPTER_TABLE = ParameterTable(ARDUCOPTER_DEFAULTS, _arducopter_limits)

REAL_MAX = 1e4
"""Floats outside 0 to this are refused: the stub applies its parameters, and must stay near its origin."""


class Parameters:
    """A vehicle's parameter table: fixed names and types, settable values."""

    def __init__(self, table: ParameterTable = PX4_TABLE, /, **overrides: Value) -> None:
        """Start from the defaults; raises KeyError or TypeError for an override that does not fit them."""
        self._table = table
        self._values: dict[str, Value] = dict(table.defaults)
        self.names: tuple[str, ...] = tuple(sorted(table.defaults))
        self.limits = table.limits(self._values)
        for name, value in overrides.items():
            if not self.set(name, value):
                raise TypeError(f"{name} = {value!r} does not fit its type")

    def __getitem__(self, name: str) -> Value:
        """Return a value; raises KeyError for an unknown name."""
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        """Return whether the parameter exists."""
        return name in self._values

    def set(self, name: str, value: Value) -> bool:
        """Set a known parameter to a value of its type and range; return whether it was set."""
        if type(value) is not type(self._values[name]):
            return False
        if isinstance(value, float) and not 0.0 <= value <= REAL_MAX:
            return False
        self._values[name] = value
        self.limits = self._table.limits(self._values)
        return True
