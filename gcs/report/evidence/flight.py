"""What a report shows beside the metrics: how well each vehicle knew, computed and heard.

Times are seconds since the mission's start, places are in the mission frame. An array with nothing in it stands for
what is not known.
"""

from dataclasses import dataclass, field

import numpy as np

from estimation.state import Vector
from gcs.metrics.record import FlightRecord

Names = np.ndarray[tuple[int], np.dtype[np.str_]]


def _none() -> Vector:
    return np.empty(0)


def _no_pairs() -> Vector:
    return np.empty((0, 2))


def _no_names() -> Names:
    return np.empty(0, dtype="<U16")


@dataclass(frozen=True, slots=True)
class Belief:
    """What one vehicle believed of itself or of the target: `motion` (T, 4) = [x y x' y'], `sigma` (T, 4) its spread.

    `sigma` holds the standard deviations: the roots of the covariance's diagonal.
    """

    time_s: Vector = field(default_factory=_none)
    motion: Vector = field(default_factory=lambda: np.empty((0, 4)))
    sigma: Vector = field(default_factory=lambda: np.empty((0, 4)))


@dataclass(frozen=True, slots=True)
class Loop:
    """One vehicle's control loop, an entry a tick: when (T,), its computing time [us], and ticks skipped before it.

    `qp` says where each plan came from (`interior`, `bounded`, `fallback`), `guard` what the guard did with the wish
    (`passed`, `changed`, `yielded`, `braked`); `setpoint_m` (T, 3) is what was sent, NaN where nothing was;
    `velocity_m_s` (T, 3) is the velocity that went with it, 0 where none did, and `yaw_rad` (T,) the yaw, NaN where
    nothing was sent.
    """

    time_s: Vector = field(default_factory=_none)
    tick_us: Vector = field(default_factory=_none)
    skipped: Vector = field(default_factory=_none)
    qp: Names = field(default_factory=_no_names)
    guard: Names = field(default_factory=_no_names)
    setpoint_m: Vector = field(default_factory=lambda: np.empty((0, 3)))
    velocity_m_s: Vector = field(default_factory=lambda: np.empty((0, 3)))
    yaw_rad: Vector = field(default_factory=_none)


@dataclass(frozen=True, slots=True)
class Hearing:
    """What came of one kind from one sender: when it was heard (K,), and how old it was then [s] (K,)."""

    heard_s: Vector
    age_s: Vector


@dataclass(frozen=True, slots=True)
class VehicleEvidence:
    """One vehicle's.

    `telemetry` is what its own autopilot said; `peers` what each other vehicle said of itself, by its id; `dropped` is
    how many messages it refused. `battery` (K, 2) holds times and fractions. `altitude_m` (T,) is over `own.time_s`.
    `samples` (K, 3) are times, and places x and y that its autopilot said it was at.
    """

    vehicle_id: int
    own: Belief = field(default_factory=Belief)
    target: Belief = field(default_factory=Belief)
    altitude_m: Vector = field(default_factory=_none)
    loop: Loop = field(default_factory=Loop)
    telemetry: Hearing = field(default_factory=lambda: Hearing(np.empty(0), np.empty(0)))
    peers: dict[int, Hearing] = field(default_factory=dict)
    dropped: int = 0
    battery: Vector = field(default_factory=_no_pairs)
    samples: Vector = field(default_factory=lambda: np.empty((0, 3)))


@dataclass(frozen=True, slots=True)
class FlightEvidence:
    """A flight as a report needs it: the record behind the metrics, and each vehicle's evidence in the record's order.

    `facts` are what people want to know first, as name and value: date, versions, mission, where the log is.
    """

    record: FlightRecord
    vehicles: tuple[VehicleEvidence, ...]
    facts: dict[str, str] = field(default_factory=dict)
