"""Errors of the vehicles' estimates against the truth, or against the best reference that is available."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.state import POSITION, Vector
from gcs.metrics.record import FlightRecord
from gcs.report.evidence.flight import EstimateSeries, VehicleEvidence

SIGMAS = 3.0
WITHIN_SHARE = 0.997
"""The share of Gaussian errors that is within three standard deviations."""
NEES_EXPECTED = 2.0
"""The mean normalised estimation error squared of a consistent filter, over two axes."""
_OUTSIDE_FACTOR = 3.0
_CAUTIOUS_NEES = 1.0


@dataclass(frozen=True, slots=True)
class EstimateError:
    """Errors of one vehicle's estimate at (K,) times: `error_m`, `sigma_m` (K, 2) in x and y; NaN: no reference."""

    row: int
    time_s: Vector
    error_m: Vector
    sigma_m: Vector


@dataclass(frozen=True, slots=True)
class EstimateConsistency:
    """How the errors of an estimate compare with its own covariance.

    `within` is the share within `SIGMAS`; `nees` the mean normalised estimation error squared, 2 where the covariance
    is right. The two axes are taken as independent, which leaves the mean as it is.
    """

    within: float
    nees: float

    @property
    def is_optimistic(self) -> bool:
        """Whether the errors leave the bounds more than three times as often as those of a consistent filter."""
        return 1.0 - self.within > _OUTSIDE_FACTOR * (1.0 - WITHIN_SHARE)

    @property
    def is_pessimistic(self) -> bool:
        """Whether the errors are so small that the covariance is at least twice too large."""
        return not self.is_optimistic and self.nees < _CAUTIOUS_NEES


def consistency(error: EstimateError) -> EstimateConsistency | None:
    """Return how errors compare with their covariance; None where no error is known."""
    known = np.isfinite(error.error_m).all(axis=1) & (error.sigma_m > 0.0).all(axis=1)
    if not known.any():
        return None
    ratio = error.error_m[known] / error.sigma_m[known]
    return EstimateConsistency(float(np.mean(np.abs(ratio) <= SIGMAS)), float(np.mean((ratio**2).sum(axis=1))))


def estimate_error(row: int, estimate: EstimateSeries, time_s: Vector, position_m: Vector) -> EstimateError:
    """Return the error of an estimate against positions (T, 2) at other times, NaN outside their time span."""
    reference_m = np.column_stack([np.interp(estimate.time_s, time_s, column) for column in position_m.T])
    inside = (estimate.time_s >= time_s[0]) & (estimate.time_s <= time_s[-1])
    error_m = np.where(inside[:, None], estimate.motion[:, POSITION] - reference_m, np.nan)
    return EstimateError(row, estimate.time_s, error_m, estimate.sigma[:, POSITION])


def own_errors(record: FlightRecord, vehicles: Sequence[VehicleEvidence]) -> list[EstimateError]:
    """Return the errors of each vehicle's own estimate, in the record's order; none without the truth."""
    if record.reference != "truth":
        return []
    return [
        estimate_error(row, vehicle.own, record.time_s, record.vehicles[row].position_m)
        for row, vehicle in enumerate(vehicles)
        if vehicle.own.time_s.size
    ]


def target_errors(record: FlightRecord, vehicles: Sequence[VehicleEvidence]) -> tuple[str, list[EstimateError]]:
    """Return the errors of the target estimates, and their reference: the truth, the record, or the peers' mean."""
    rows = [row for row, vehicle in enumerate(vehicles) if vehicle.target.time_s.size]
    if np.isfinite(record.target_position_m).any():
        comparison = "estimation error" if record.reference == "truth" else "estimate − recorded target"
        reference_m = {row: record.target_of(record.vehicles[row]).position_m for row in rows}
    else:
        comparison = "estimate − mean of the other vehicles"
        estimated_m = {row: _on_grid_m(vehicles[row].target, record.time_s) for row in rows}
        reference_m = {
            row: _mean_m([_alike_m(record, row, other, estimated_m) for other in rows if other != row], record.time_s)
            for row in rows
        }
    return comparison, [estimate_error(row, vehicles[row].target, record.time_s, reference_m[row]) for row in rows]


def _alike_m(record: FlightRecord, row: int, other: int, estimated_m: Mapping[int, Vector]) -> Vector:
    """Return a vehicle's estimates (T, 2), NaN where they are of another target than those of the vehicle of a row."""
    is_same = record.target_numbers(record.vehicles[row]) == record.target_numbers(record.vehicles[other])
    return np.where(is_same[:, None], estimated_m[other], np.nan)


def _on_grid_m(estimate: EstimateSeries, time_s: Vector) -> Vector:
    columns = [
        np.interp(time_s, estimate.time_s, column, left=np.nan, right=np.nan)
        for column in estimate.motion[:, POSITION].T
    ]
    return np.column_stack(columns)


def _mean_m(places_m: Sequence[Vector], time_s: Vector) -> Vector:
    """Return the mean (T, 2) of the known positions, NaN where none is known."""
    stacked = np.array([*places_m, np.full((time_s.size, 2), np.nan)])
    known = np.isfinite(stacked)
    total, count = np.where(known, stacked, 0.0).sum(axis=0), known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
