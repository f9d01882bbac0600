"""Reynolds' rules of flocking as measured in a flight: separation, alignment, cohesion.

Arrays over the team have shape (V, T): vehicles in the record's order, samples in time. NaN marks samples without a
measurement: such a vehicle has no metric and is not counted in those of the others.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimation.state import Vector
from gcs.metrics.catalogue import PHASES
from gcs.metrics.record import FlightRecord, Mask


@dataclass(frozen=True, slots=True)
class FlockingResult:
    """Reynolds' rules over a phase of the flight, None where fewer than two vehicles were measured.

    Separation is the distance to the nearest other vehicle; the alignment's error is the velocity relative to the
    team's mean, its order the length of the mean direction of flight (1 when all fly in one direction, 0 when the
    directions cancel out); cohesion is the distance to the team's centroid. All are horizontal.
    """

    separation_min_m: float | None = None
    separation_mean_m: float | None = None
    alignment_error_rms_m_s: float | None = None
    alignment_order_mean: float | None = None
    cohesion_mean_m: float | None = None
    cohesion_max_m: float | None = None


@dataclass(frozen=True, slots=True)
class ReynoldsResult:
    """Reynolds' rules in formation (30 s to the first engagement), in the ring's window, and over the whole flight."""

    formation: FlockingResult = FlockingResult()
    ring: FlockingResult = FlockingResult()
    flight: FlockingResult = FlockingResult()


def phases(result: ReynoldsResult) -> tuple[tuple[str, FlockingResult], ...]:
    """Return the phases of a flight that have any figure, with their names."""
    named = ((name, getattr(result, name)) for name in PHASES)
    return tuple((name, figures) for name, figures in named if figures != FlockingResult())


# Below this speed a vehicle's direction of flight is noise.
STILL_M_S = 0.02


@dataclass(frozen=True, slots=True)
class Flocking:
    """Reynolds' rules over a flight.

    `nearest_m` (V, T) is the distance to the nearest other vehicle (separation), `mismatch_m_s` (V, T) each
    velocity relative to the team's mean (alignment), `order` (T,) the length of the mean direction of flight: 1 when
    all fly in one direction, 0 when the directions cancel out. `off_centre_m` (V, T) is the distance to the team's
    centroid (cohesion).
    """

    nearest_m: Vector
    mismatch_m_s: Vector
    order: Vector
    off_centre_m: Vector


def flocking(record: FlightRecord) -> Flocking:
    """Measure the three rules over a flight; all NaN with fewer than two measured vehicles."""
    shape = (len(record.vehicles), record.time_s.size)
    position_m, velocity_m_s = np.empty((2, *shape, 2))
    for row, track in enumerate(record.vehicles):
        known = np.isfinite(np.concatenate((track.position_m, track.velocity_m_s), axis=1)).all(axis=1, keepdims=True)
        position_m[row] = np.where(known, track.position_m, np.nan)
        velocity_m_s[row] = np.where(known, track.velocity_m_s, np.nan)
    return Flocking(
        _nearest_m(position_m),
        _off_mean(velocity_m_s),
        _order(velocity_m_s),
        _off_mean(position_m),
    )


def condensed(figures: Flocking, span: Mask) -> FlockingResult:
    """Condense the samples (T,) of a span."""
    nearest_m, off_centre_m = figures.nearest_m[:, span], figures.off_centre_m[:, span]
    mean_square = _over(figures.mismatch_m_s[:, span] ** 2, np.mean)
    return FlockingResult(
        separation_min_m=_over(nearest_m, np.min),
        separation_mean_m=_over(nearest_m, np.mean),
        alignment_error_rms_m_s=None if mean_square is None else mean_square**0.5,
        alignment_order_mean=_over(figures.order[span], np.mean),
        cohesion_mean_m=_over(off_centre_m, np.mean),
        cohesion_max_m=_over(off_centre_m, np.max),
    )


def _nearest_m(position_m: Vector) -> Vector:
    x, y = np.moveaxis(position_m, 2, 0).copy()
    nearest_m = np.full(x.shape, np.inf)
    for row in range(len(x) - 1):
        apart_m = np.hypot(x[row + 1 :] - x[row], y[row + 1 :] - y[row])
        nearest_m[row] = np.fmin(nearest_m[row], np.fmin.reduce(apart_m))
        nearest_m[row + 1 :] = np.fmin(nearest_m[row + 1 :], apart_m)
    return np.where(np.isfinite(nearest_m), nearest_m, np.nan)


def _off_mean(columns: Vector) -> Vector:
    """Return the distance of each (V, T, 2) to the mean of those measured; NaN where fewer than two were."""
    measured = np.isfinite(columns[..., 0])
    count = measured.sum(axis=0)
    total = np.where(measured[..., None], columns, 0.0).sum(axis=0)
    mean = total / np.maximum(count, 1)[:, None]
    return np.where(count > 1, np.linalg.norm(columns - mean, axis=2), np.nan)


def _order(velocity_m_s: Vector) -> Vector:
    speed_m_s = np.linalg.norm(velocity_m_s, axis=2)
    flies = speed_m_s > STILL_M_S  # never true of NaN
    speed_m_s = np.where(flies, speed_m_s, 1.0)
    heading = np.where(flies[..., None], velocity_m_s / speed_m_s[..., None], 0.0)
    count = flies.sum(axis=0)
    return np.where(count > 1, np.linalg.norm(heading.sum(axis=0), axis=1) / np.maximum(count, 1), np.nan)


def _over(values: Vector, condense: Callable[[Vector], np.float64]) -> float | None:
    known = values[np.isfinite(values)]
    return float(condense(known)) if known.size else None
