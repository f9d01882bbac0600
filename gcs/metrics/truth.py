"""The true tracks of a flight and their gaps: metrics use truth only if it is known for all vehicles at all times."""

from collections.abc import Mapping, Sequence

import numpy as np

from estimation.state import POSITION, VELOCITY, Vector
from gcs.metrics.record import Mask, VehicleTrack
from sitl.server.server import TruthTrack

_GAP_MAX_S = 0.5
"""A true position farther in time than this from the nearest sample is unknown. Between two samples twice as far apart,
a straight line is off a ring by 3 cm at 1.5 m/s and 10 m."""
_GRAIN_S = 1e-3


def true_track(estimated: VehicleTrack, truth: TruthTrack, grid_s: Vector) -> VehicleTrack:
    """Return a vehicle's true track on the grid, NaN where it is unknown; its tactics are those of `estimated`."""
    time_s, motion = _samples(truth)
    on_grid = np.column_stack([np.interp(grid_s, time_s, column) for column in motion.T])
    # Nothing is extrapolated before the first sample and after the last one.
    outside = (grid_s < time_s[0] - _GRAIN_S) | (grid_s > time_s[-1] + _GRAIN_S)
    on_grid[outside | ~_known(time_s, grid_s)] = np.nan
    return VehicleTrack(estimated.vehicle_id, on_grid[:, POSITION], on_grid[:, VELOCITY], estimated.tactic)


def missing_truth(
    estimated: Sequence[VehicleTrack], truth: Mapping[int, TruthTrack], time_s: Vector, grid_s: Vector
) -> str:
    """Return the first vehicle and time without a true motion during its flight; empty if there is none.

    `truth` is by vehicle id; `grid_s` is the clock of the truth, `time_s` the time since the mission's start.
    """
    for track in estimated:
        sampled_s = _samples(truth[track.vehicle_id])[0] if track.vehicle_id in truth else np.empty(0)
        if not sampled_s.size:
            return f"no ground truth of vehicle {track.vehicle_id}"
        lacks = np.flatnonzero((track.tactic != "unknown") & ~_known(sampled_s, grid_s))
        if lacks.size:
            first = int(lacks[0])
            known_again = np.flatnonzero(_known(sampled_s, grid_s[first:]))
            until = f" to {time_s[first + int(known_again[0])]:.1f} s" if known_again.size else " on"
            return f"no ground truth of vehicle {track.vehicle_id} from {time_s[first]:.1f} s{until}"
    return ""


def _samples(truth: TruthTrack) -> tuple[Vector, Vector]:
    """Return the times (K,) and horizontal motions (K, 4) of the finite samples, in order of time."""
    motion = np.hstack([truth.position_m[:, POSITION], truth.velocity_m_s[:, POSITION]])
    known = np.flatnonzero(np.isfinite(motion).all(axis=1))
    order = known[np.argsort(truth.time_s[known], kind="stable")]
    return truth.time_s[order], motion[order]


def _known(time_s: Vector, grid_s: Vector) -> Mask:
    """Return where on the grid the nearest sample is near enough."""
    after = np.minimum(np.searchsorted(time_s, grid_s), time_s.size - 1)
    before = np.maximum(after - 1, 0)
    nearest_s = np.minimum(np.abs(grid_s - time_s[before]), np.abs(time_s[after] - grid_s))
    return np.asarray(nearest_s <= _GAP_MAX_S)
