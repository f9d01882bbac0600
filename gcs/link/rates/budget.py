"""The load of a connection in bytes, from the rates of its vehicles."""

from collections.abc import Sequence
from dataclasses import dataclass

from gcs.link.rates.rates import Rates

TELEMETRY_BYTES = 40
"""LOCAL_POSITION_NED."""
STATUS_BYTES = (43, 40, 14)
"""SYS_STATUS, ATTITUDE, EXTENDED_SYS_STATE."""
SLOW_STATUS_BYTES = (67, 53, 64, 40, 54, 52)
"""At half the status rate: HOME_POSITION, BATTERY_STATUS, GPS_RAW_INT, GLOBAL_POSITION_INT, ESTIMATOR_STATUS and
WIND_COV, as PX4 sends them; ArduPilot's EKF_STATUS_REPORT and WIND are smaller.
"""
SETPOINT_BYTES = 65
"""SET_POSITION_TARGET_LOCAL_NED."""
EXTERNAL_BYTES, EXTERNAL_HZ = 48, 30.0
"""VISION_POSITION_ESTIMATE; external positions above this rate are not passed on."""
HEARTBEAT_BYTES, HEARTBEAT_HZ = 21, 1.0
ROUND_TRIP_BYTES, ROUND_TRIP_HZ = 28, 0.5
"""TIMESYNC, each way."""
SIGNATURE_BYTES = 13
LOAD_SHARE = 0.7
"""The share of a connection for planned messages: commands, parameters and repetitions take the rest."""


@dataclass(frozen=True, slots=True)
class Load:
    """The bytes to the vehicles of a connection, and those from them [bytes/s]."""

    up_bytes_s: float
    down_bytes_s: float

    @property
    def bytes_s(self) -> float:
        """Both ways together."""
        return self.up_bytes_s + self.down_bytes_s


def load(rates: Rates, vehicles: int, *, signed: bool = False, positions_hz: float = 0.0) -> Load:
    """Return the load of this many vehicles on one connection at these rates, with external positions to each.

    One heartbeat and one TIMESYNC go up for all of them.
    """
    extra = SIGNATURE_BYTES if signed else 0
    streams = (
        (rates.telemetry_hz, (TELEMETRY_BYTES,)),
        (rates.status_hz, STATUS_BYTES),
        (rates.status_hz / 2.0, SLOW_STATUS_BYTES),
        (HEARTBEAT_HZ, (HEARTBEAT_BYTES,)),
        (ROUND_TRIP_HZ, (ROUND_TRIP_BYTES,)),
    )
    down = sum(rate_hz * (size + extra) for rate_hz, sizes in streams for size in sizes)
    up = rates.setpoint_hz * (SETPOINT_BYTES + extra) + positions_hz * (EXTERNAL_BYTES + extra)
    shared = HEARTBEAT_HZ * (HEARTBEAT_BYTES + extra) + ROUND_TRIP_HZ * (ROUND_TRIP_BYTES + extra)
    return Load(vehicles * up + shared, vehicles * down)


def fitting(levels: Sequence[Rates], vehicles: int, capacity_bytes_s: float, *, signed: bool = False) -> int:
    """Return the index of the first rates that a connection carries with its reserve; of the last if none fit."""
    room = LOAD_SHARE * capacity_bytes_s
    fits = (index for index, rates in enumerate(levels) if load(rates, vehicles, signed=signed).bytes_s <= room)
    return next(fits, len(levels) - 1)
