"""A plant's simulation of flights, held against what was measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.excerpts import GRID_S, Excerpt, grid_s
from estimation.output_error import Fit
from estimation.state import Vector


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """One axis of an excerpt: times, measured and simulated positions (T,); from `held_out` on nothing was fitted."""

    time_s: Vector
    measured_m: Vector
    simulated_m: Vector
    held_out: int

    @property
    def error_m(self) -> Vector:
        """Measured minus simulated, (T,)."""
        return self.measured_m - self.simulated_m


def simulated(excerpts: Sequence[Excerpt], plant: Fit, axis: int, share: float) -> list[Simulated]:
    """Simulate each excerpt from its setpoints alone.

    The state it began in and a constant disturbance are taken from the first `share` of it, and nothing from the rest.
    """
    response = plant.model.responses(plant.parameters)[axis]
    found = []
    for excerpt in excerpts:
        measured_m = excerpt.position_m[:, axis]
        count, trained = measured_m.size, round(share * measured_m.size)
        steps = excerpt.steps(plant.model.between)[axis]
        forced_m = response.forced(steps, float(plant.parameters[4]), excerpt.begin_s, GRID_S, count)
        basis = np.column_stack((np.ones(count), response.free(grid_s(count))))
        weights, *_ = np.linalg.lstsq(basis[:trained], (measured_m - forced_m)[:trained], rcond=None)
        found.append(Simulated(excerpt.time_s, measured_m, forced_m + basis @ weights, trained))
    return found


def fit_percent(flights: Sequence[Simulated]) -> float:
    """Return 100 (1 - rms error / rms motion) over what was not fitted; below 0 it is worse than no motion at all."""
    errors = np.concatenate([each.error_m[each.held_out :] for each in flights])
    motion = np.concatenate([_centred(each.measured_m[each.held_out :]) for each in flights])
    moved = float(np.sqrt(np.mean(motion**2)))
    return 100.0 * (1.0 - float(np.sqrt(np.mean(errors**2))) / max(moved, 1e-9))


def _centred(values: Vector) -> Vector:
    return np.asarray(values - values.mean(), dtype=np.float64)
