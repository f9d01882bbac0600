"""The record of a flight: what metrics, figures and reports are computed from."""

from dataclasses import dataclass, field

import numpy as np

from estimation.state import Vector


@dataclass(frozen=True, slots=True)
class VehicleTrack:
    """One vehicle's flight on the record's time grid of T samples.

    `position_m`, `velocity_m_s` (T, 2) in the mission frame; `tactic` (T,) names (`formation`, `encircle`, ...);
    rows where the vehicle was not heard are NaN with tactic `unknown`.
    """

    vehicle_id: int
    position_m: Vector
    velocity_m_s: Vector
    tactic: np.ndarray[tuple[int], np.dtype[np.str_]]


@dataclass(frozen=True, slots=True)
class LoopStatistics:
    """How well the control loop kept its rate: `tick_us` (ticks,) are computing times in microseconds."""

    rate_hz: float
    ticks: int
    missed: int
    tick_us: Vector = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """A whole flight on an even grid `time_s` (T,) since the mission's start; the target's motion has shape (T, 2).

    `source` is simulation, sitl or flight; `reference` is truth or estimate: what the positions are.
    """

    mission: str
    seed: int
    source: str
    reference: str
    time_s: Vector
    target_position_m: Vector
    target_velocity_m_s: Vector
    vehicles: tuple[VehicleTrack, ...]
    loop: LoopStatistics
    wall_time_s: float
