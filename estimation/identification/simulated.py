"""A plant's simulation of flights, held against what was measured."""

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
"""An estimator's wander within a window: its place, rate and curvature, free for every plant alike. With the plant's
own free motions in their place, a slow plant would take up the wander, and be judged too well."""


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """One axis of an excerpt: times, measured and simulated positions (T,).

    `edges` are where the windows of what was not fitted begin, and where the last ends.
    """

    time_s: Vector
    measured_m: Vector
    simulated_m: Vector
    edges: tuple[int, ...]

    @property
    def held_out(self) -> int:
        """From where on nothing was fitted."""
        return self.edges[0]

    @property
    def error_m(self) -> Vector:
        """Measured minus simulated, (T,)."""
        return self.measured_m - self.simulated_m


def simulated(
    excerpts: Sequence[Excerpt], plant: Fit, axis: int, share: float, window_s: float = inf
) -> list[Simulated]:
    """Simulate each excerpt from its setpoints alone.

    The state it began in and a constant disturbance are taken from the first `share` of it, and nothing from the rest.
    The rest is cut to windows of about `window_s`, in each of which the estimator's wander is taken out of the errors.
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
        found.append(Simulated(excerpt.time_s, measured_m, simulated_m, edges))
    return found


def _wander(error_m: Vector) -> Vector:
    """Return the part of a window's errors (T,) that the estimator's wander explains."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, error_m.size), _WANDER_DEGREE + 1))
    return np.asarray(basis @ (basis.T @ error_m), dtype=np.float64)


def _edges(trained: int, count: int, window_s: float) -> tuple[int, ...]:
    windows = max(1, round((count - trained) * GRID_S / window_s))
    return tuple(np.linspace(trained, count, windows + 1).astype(int).tolist())


def fit_percent(flights: Sequence[Simulated]) -> float:
    """Return 100 (1 - rms error / rms motion) over what was not fitted; below 0 it is worse than no motion at all.

    Motion is what a window moves about its mean.
    """
    parts = [(flight, slice(*edges)) for flight in flights for edges in pairwise(flight.edges)]
    errors = np.concatenate([flight.error_m[part] for flight, part in parts])
    motion = np.concatenate([_centred(flight.measured_m[part]) for flight, part in parts])
    moved = float(np.sqrt(np.mean(motion**2)))
    return 100.0 * (1.0 - float(np.sqrt(np.mean(errors**2))) / max(moved, 1e-9))


def _centred(values: Vector) -> Vector:
    return np.asarray(values - values.mean(), dtype=np.float64)
