"""The stub's parameters: PX4's names, types and defaults, as far as a ground station looks for them."""

from collections.abc import Mapping
from types import MappingProxyType

Value = int | float

DEFAULTS: Mapping[str, Value] = MappingProxyType(
    {
        "COM_ARM_WO_GPS": 1,
        "COM_DISARM_LAND": 2.0,
        "COM_DISARM_PRFLT": 10.0,
        "COM_DL_LOSS_T": 10,
        "COM_OBL_RC_ACT": 0,
        "COM_OF_LOSS_T": 1.0,
        "COM_RCL_EXCEPT": 0,
        "COM_RC_IN_MODE": 3,
        "COM_SPOOLUP_TIME": 1.0,
        "GF_ACTION": 2,
        "GF_MAX_HOR_DIST": 0.0,
        "GF_MAX_VER_DIST": 0.0,
        "GF_SOURCE": 0,
        "MAV_SYS_ID": 1,
        "MAV_TYPE": 2,
        "MIS_TAKEOFF_ALT": 2.5,
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
        "RTL_DESCEND_ALT": 30.0,
        "RTL_RETURN_ALT": 60.0,
        "SYS_AUTOSTART": 10040,
    }
)
"""An int is a 32-bit integer on the wire, a float a 32-bit float."""

REAL_MAX = 1e4
"""Reals outside 0 to this are refused: the stub flies by what it is told, and has to stay on the map."""


class Parameters:
    """A vehicle's parameter table: fixed names and types, settable values."""

    def __init__(self, **overrides: Value) -> None:
        """Start from the defaults; raises KeyError or TypeError for an override that does not fit them."""
        self._values: dict[str, Value] = dict(DEFAULTS)
        self.names: tuple[str, ...] = tuple(sorted(DEFAULTS))
        for name, value in overrides.items():
            if not self.set(name, value):
                raise TypeError(f"{name} = {value!r} does not fit its type")

    def __getitem__(self, name: str) -> Value:
        """Return a value; raises KeyError for an unknown name."""
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        """Say whether there is such a parameter."""
        return name in self._values

    def set(self, name: str, value: Value) -> bool:
        """Set a known parameter to a value of its own type, in range, and say whether that was done."""
        if type(value) is not type(self._values[name]):
            return False
        if isinstance(value, float) and not 0.0 <= value <= REAL_MAX:
            return False
        self._values[name] = value
        return True
