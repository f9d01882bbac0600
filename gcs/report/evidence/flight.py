"""The data of a report beside the metrics: each vehicle's estimates, control loop and reception of messages.

Times are seconds since the mission's start, positions are in the mission frame. An empty array means not recorded.
"""

from dataclasses import dataclass, field

import numpy as np

from estimation.state import Vector
from gcs.metrics.record import FlightRecord
from gcs.metrics.result import PlantResult

Names = np.ndarray[tuple[int], np.dtype[np.str_]]


def _none() -> Vector:
    return np.empty(0)


def _no_names() -> Names:
    return np.empty(0, dtype="<U16")


@dataclass(frozen=True, slots=True)
class EstimateSeries:
    """One vehicle's estimates of itself or of the target: `motion` (T, 4) = [x y x' y'], `sigma` (T, 4).

    `sigma` holds the standard deviations: the square roots of the covariance's diagonal.
    """

    time_s: Vector = field(default_factory=_none)
    motion: Vector = field(default_factory=lambda: np.empty((0, 4)))
    sigma: Vector = field(default_factory=lambda: np.empty((0, 4)))


@dataclass(frozen=True, slots=True)
class LoopTiming:
    """One vehicle's control loop, an entry per tick: time (T,), computing time [us], and ticks skipped before it.

    `qp` is the source of each plan (`interior`, `bounded`, `fallback`), `guard` the action of the guard (`passed`,
    `changed`, `yielded`, `braked`); `setpoint_m` (T, 3) is the position sent, NaN where none was sent; `velocity_m_s`
    (T, 3) the velocity sent with it, 0 without one, and `yaw_rad` (T,) the yaw, NaN where none was sent. `values`
    (T,) are those of a user's planner by name, NaN in the ticks without.
    """

    time_s: Vector = field(default_factory=_none)
    tick_us: Vector = field(default_factory=_none)
    skipped: Vector = field(default_factory=_none)
    qp: Names = field(default_factory=_no_names)
    guard: Names = field(default_factory=_no_names)
    setpoint_m: Vector = field(default_factory=lambda: np.empty((0, 3)))
    velocity_m_s: Vector = field(default_factory=lambda: np.empty((0, 3)))
    yaw_rad: Vector = field(default_factory=_none)
    values: dict[str, Vector] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Reception:
    """Messages of one kind from one sender: time of reception (K,), and age on reception [s] (K,)."""

    received_s: Vector
    age_s: Vector


@dataclass(frozen=True, slots=True)
class VehicleEvidence:
    """The recorded data of one vehicle.

    `telemetry` is the reception of its own autopilot, `peers` that of each other vehicle, by id; `dropped` states the
    messages dropped by reason. `battery` (K, 2) holds times and fractions. `altitude_m` (T,) is at `own.time_s`.
    `samples` (K, 3) are time, x and y of the autopilot's position. `round_trip_s` (K,) are those of its link, one with
    each status of the autopilot [s of the mission clock].
    """

    vehicle_id: int
    own: EstimateSeries = field(default_factory=EstimateSeries)
    target: EstimateSeries = field(default_factory=EstimateSeries)
    altitude_m: Vector = field(default_factory=_none)
    loop: LoopTiming = field(default_factory=LoopTiming)
    telemetry: Reception = field(default_factory=lambda: Reception(np.empty(0), np.empty(0)))
    peers: dict[int, Reception] = field(default_factory=dict)
    dropped: str = ""
    battery: Vector = field(default_factory=lambda: np.empty((0, 2)))
    samples: Vector = field(default_factory=lambda: np.empty((0, 3)))
    round_trip_s: Vector = field(default_factory=_none)


@dataclass(frozen=True, slots=True)
class FlightEvidence:
    """The record behind the metrics, and each vehicle's evidence in the record's order.

    `facts` are name and value of what heads the report: date, log, versions; `logs` the names of its logs. `speed`
    is seconds of mission time per second of wall time; ages, computing times and intervals of messages are wall time.
    """

    record: FlightRecord
    vehicles: tuple[VehicleEvidence, ...]
    facts: dict[str, str] = field(default_factory=dict)
    logs: tuple[str, ...] = ()
    plants: tuple[PlantResult, ...] = ()
    speed: float = 1.0
