"""A plant's simulation of flights, compared with the measured positions."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from estimation.identification.excerpts import GRID_S, Excerpt, grid_s
from estimation.identification.output_error import Fit
from estimation.state import Vector

PREDICTION_HORIZON_S = 10.0
"""Windows of the validation: over longer times the estimator's drift dominates the error."""
_WANDER_DEGREE = 2
"""The model of an estimator's drift within a window: offset, rate and curvature, free for every plant. With the plant's
free motions instead, a slow plant would fit the drift and be rated too well.
"""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedAxis:
    """One axis of an excerpt: times, measured and simulated positions (T,).

    `edges` are the begins of the validation windows, and the end of the last.
    """

    time_s: Vector
    measured_m: Vector
    simulated_m: Vector
    edges: tuple[int, ...]

    @property
    def held_out(self) -> int:
        """The index of the first validation sample."""
        return self.edges[0]

    @property
    def error_m(self) -> Vector:
        """Measured minus simulated, (T,)."""
        return self.measured_m - self.simulated_m


def simulated(
    excerpts: Sequence[Excerpt], plant: Fit, axis: int, share: float, window_s: float = inf
) -> list[SimulatedAxis]:
    """Simulate each excerpt from its setpoints only.

    Initial state and a constant disturbance are fitted to the first `share`. The rest, for validation, is cut into
    windows of about `window_s`, in each of which the estimator's drift is removed from the errors.
    """
    response = plant.model.responses(plant.parameters)[axis]
    found = []
    for excerpt in excerpts:
        measured_m = excerpt.position_m[:, axis]
        count, trained = measured_m.size, round(share * measured_m.size)
        inputs, lead_s = excerpt.inputs(plant.model.between)[axis], plant.model.leads_s(plant.parameters)[axis]
        simulated_m = response.answer(inputs, lead_s, float(plant.parameters[4]), excerpt.begin_s, GRID_S, count)
        free = np.column_stack((np.ones(count), response.free(grid_s(count))))
        weights, *_ = np.linalg.lstsq(free[:trained], (measured_m - simulated_m)[:trained], rcond=None)
        simulated_m += free @ weights
        edges = _edges(trained, count, window_s)
        for begin, end in pairwise(edges) if window_s < inf else ():
            simulated_m[begin:end] += _wander((measured_m - simulated_m)[begin:end])
        found.append(SimulatedAxis(excerpt.time_s, measured_m, simulated_m, edges))
    return found


def _wander(error_m: Vector) -> Vector:
    """Return the part of a window's errors (T,) that the estimator's drift explains."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, error_m.size), _WANDER_DEGREE + 1))
    return np.asarray(basis @ (basis.T @ error_m), dtype=np.float64)


def _edges(trained: int, count: int, window_s: float) -> tuple[int, ...]:
    windows = max(1, round((count - trained) * GRID_S / window_s))
    return tuple(np.linspace(trained, count, windows + 1).astype(int).tolist())


def fit_percent(flights: Sequence[SimulatedAxis]) -> float:
    """Return 100 (1 - rms error / rms motion) over the validation windows; below 0 it is worse than no motion.

    Motion is relative to the mean of its window.
    """
    parts = [(flight, slice(*edges)) for flight in flights for edges in pairwise(flight.edges)]
    errors = np.concatenate([flight.error_m[part] for flight, part in parts])
    positions = [flight.measured_m[part] for flight, part in parts]
    motion = np.concatenate([each - each.mean() for each in positions])
    moved = float(np.sqrt(np.mean(motion**2)))
    return 100.0 * (1.0 - float(np.sqrt(np.mean(errors**2))) / max(moved, 1e-9))
