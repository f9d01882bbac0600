"""Plain least squares on the difference equation of a plant (ARX): what a fit has to be better than.

It is biased by noise in the positions: they stand on both sides of the equation.
"""

from collections.abc import Sequence

import numpy as np

from estimation.excerpts import GRID_S, Excerpt
from estimation.plant import Plant, PlantAxis

_DELAYS = range(7)


def baseline_of(excerpts: Sequence[Excerpt], share: float) -> Plant | None:
    """Return the plant by plain least squares over the first share of each excerpt; None if that is no stable plant."""
    best, least = None, np.inf
    for delay in _DELAYS:
        axes = [_axis(excerpts, share, delay, axis) for axis in range(2)]
        cost = sum(cost for cost, _ in axes)
        if cost < least:
            least, best = cost, (delay, [plant for _, plant in axes])
    if best is None or any(plant is None for plant in best[1]):
        return None
    (x0, x1), (y0, y1) = (plant for plant in best[1] if plant is not None)
    return Plant(PlantAxis(x0, x1), PlantAxis(y0, y1), best[0] * GRID_S)


def _axis(excerpts: Sequence[Excerpt], share: float, delay: int, axis: int) -> tuple[float, tuple[float, float] | None]:
    rows, outputs = [], []
    for excerpt in excerpts:
        count = round(share * excerpt.position_m.shape[0])
        position_m, setpoint_m = excerpt.position_m[:count, axis], excerpt.setpoint_m()[:count, axis]
        first, last = max(_DELAYS) + 2, count
        columns = [position_m[first - lag : last - lag] for lag in (1, 2)]
        columns += [setpoint_m[first - lag - delay : last - lag - delay] for lag in (1, 2)]
        rows.append(np.column_stack([*columns, np.ones(last - first)]))
        outputs.append(position_m[first:])
    matrix, output = np.vstack(rows), np.concatenate(outputs)
    weights, *_ = np.linalg.lstsq(matrix, output, rcond=None)
    cost = float(np.sum((output - matrix @ weights) ** 2))
    discrete = np.roots([1.0, -weights[0], -weights[1]]).astype(np.complex128)
    if (np.abs(discrete) >= 1.0).any() or (discrete.real <= 0.0).any():
        return cost, None
    poles = np.log(discrete) / GRID_S
    return cost, (float(np.prod(poles).real), float(-np.sum(poles).real))
