"""The stub's parameters: names, types and defaults of an autopilot, as far as a ground station reads them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
    take_off_height_m: float
    spool_up_s: float
    return_rise_m: float
    altitude_margin_m: float


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """One autopilot's parameters: names with defaults, and the function that derives the flight limits."""

    defaults: Mapping[str, Value]
    limits: Callable[[Mapping[str, Value]], FlightLimits]


REAL_MAX = 1e4
"""Floats outside 0 to this are refused: the stub applies its parameters, and must stay near its origin."""


class Parameters:
    """A vehicle's parameter table: fixed names and types, settable values."""

    def __init__(self, table: ParameterTable, /, **overrides: Value) -> None:
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

    def set(self, name: str, value: Value) -> bool:
        """Set a known parameter to a value of its type and range; return whether it was set."""
        if type(value) is not type(self._values[name]):
            return False
        if isinstance(value, float) and not 0.0 <= value <= REAL_MAX:
            return False
        self._values[name] = value
        self.limits = self._table.limits(self._values)
        return True
