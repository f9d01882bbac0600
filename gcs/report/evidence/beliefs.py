"""How far the vehicles' beliefs were off: from the truth where it is known, otherwise from what there is instead."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.state import POSITION, Vector
from gcs.metrics.record import FlightRecord
from gcs.report.evidence.flight import Belief, VehicleEvidence

SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class Error:
    """How far one vehicle's belief is off at (K,) times: `error_m`, `sigma_m` (K, 2) in x and y; NaN: no comparison."""

    row: int
    time_s: Vector
    error_m: Vector
    sigma_m: Vector


def belief_error(row: int, belief: Belief, time_s: Vector, position_m: Vector) -> Error:
    """Compare a belief with positions (T, 2) at other times, as far as they are known around it."""
    wanted_m = np.column_stack([np.interp(belief.time_s, time_s, column) for column in position_m.T])
    inside = (belief.time_s >= time_s[0]) & (belief.time_s <= time_s[-1])
    error_m = np.where(inside[:, None], belief.motion[:, POSITION] - wanted_m, np.nan)
    return Error(row, belief.time_s, error_m, belief.sigma[:, POSITION])


def own_errors(record: FlightRecord, vehicles: Sequence[VehicleEvidence]) -> list[Error]:
    """Return the errors of what each vehicle, in the record's order, believed of itself; none without a truth."""
    if record.reference != "truth":
        return []
    return [
        belief_error(row, vehicle.own, record.time_s, record.vehicles[row].position_m)
        for row, vehicle in enumerate(vehicles)
        if vehicle.own.time_s.size
    ]


def target_errors(record: FlightRecord, vehicles: Sequence[VehicleEvidence]) -> tuple[str, list[Error]]:
    """Return how far the beliefs of the target are off, and off what: the truth, the record, or the others' mean."""
    rows = [row for row, vehicle in enumerate(vehicles) if vehicle.target.time_s.size]
    if np.isfinite(record.target_position_m).any():
        words = "error of the belief" if record.reference == "truth" else "belief less the record's target"
        wanted_m = dict.fromkeys(rows, record.target_position_m)
    else:
        words = "belief less the others' mean"
        believed_m = {row: _on_grid_m(vehicles[row].target, record.time_s) for row in rows}
        wanted_m = {row: _mean_m([believed_m[other] for other in rows if other != row], record.time_s) for row in rows}
    return words, [belief_error(row, vehicles[row].target, record.time_s, wanted_m[row]) for row in rows]


def _on_grid_m(belief: Belief, time_s: Vector) -> Vector:
    columns = [
        np.interp(time_s, belief.time_s, column, left=np.nan, right=np.nan) for column in belief.motion[:, POSITION].T
    ]
    return np.column_stack(columns)


def _mean_m(places_m: Sequence[Vector], time_s: Vector) -> Vector:
    """Return the mean (T, 2) of those that are known, NaN where none is."""
    stacked = np.array([*places_m, np.full((time_s.size, 2), np.nan)])
    known = np.isfinite(stacked)
    total, count = np.where(known, stacked, 0.0).sum(axis=0), known.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
