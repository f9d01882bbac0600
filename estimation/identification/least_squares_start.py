"""Ordinary least squares on the difference equation of a plant (ARX), the baseline of a fit.

It is biased by noise in the positions, which are on both sides of the equation.
"""

from collections.abc import Sequence

import numpy as np

from estimation.identification.excerpts import GRID_S, Excerpt
from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis

_DELAYS = range(7)


def baseline_of(excerpts: Sequence[Excerpt], share: float) -> Plant | None:
    """Return the plant by ordinary least squares over the first share of each excerpt; None if it is unstable."""
    best, least, fed = None, np.inf, any(excerpt.fed for excerpt in excerpts)
    for delay in _DELAYS:
        axes = [_axis(excerpts, share, delay, axis, fed=fed) for axis in range(2)]
        cost = sum(cost for cost, _ in axes)
        if cost < least:
            least, best = cost, (delay, [plant for _, plant in axes])
    if best is None or any(plant is None for plant in best[1]):
        return None
    (x0, x1, x_gain), (y0, y1, y_gain) = (plant for plant in best[1] if plant is not None)
    gain = min(max((x_gain + y_gain) / 2.0, 0.0), FEEDFORWARD_MAX)
    return Plant(PlantAxis(x0, x1), PlantAxis(y0, y1), best[0] * GRID_S, gain)


def _axis(
    excerpts: Sequence[Excerpt], share: float, delay: int, axis: int, *, fed: bool
) -> tuple[float, tuple[float, float, float] | None]:
    """Return the residual, and a0, a1 and the feed-forward of one axis if it is stable."""
    rows, outputs = [], []
    for excerpt in excerpts:
        count = round(share * excerpt.position_m.shape[0])
        position_m, setpoint_m = excerpt.position_m[:count, axis], excerpt.setpoint_m()[:count, axis]
        first, last = max(_DELAYS) + 2, count
        columns = [position_m[first - lag : last - lag] for lag in (1, 2)]
        columns += [setpoint_m[first - lag - delay : last - lag - delay] for lag in (1, 2)]
        if fed:
            velocity_m_s = excerpt.velocity_m_s()[:count, axis]
            columns += [velocity_m_s[first - lag - delay : last - lag - delay] for lag in (1, 2)]
        rows.append(np.column_stack([*columns, np.ones(last - first)]))
        outputs.append(position_m[first:])
    matrix, output = np.vstack(rows), np.concatenate(outputs)
    weights, *_ = np.linalg.lstsq(matrix, output, rcond=None)
    cost = float(np.sum((output - matrix @ weights) ** 2))
    discrete = np.roots([1.0, -weights[0], -weights[1]]).astype(np.complex128)
    if (np.abs(discrete) >= 1.0).any() or (discrete.real <= 0.0).any():
        return cost, None
    poles = np.log(discrete) / GRID_S
    a0, a1 = float(np.prod(poles).real), float(-np.sum(poles).real)
    # In steady state a velocity shifts the position by g a1 / a0 times the velocity, a setpoint by its own change.
    gain = float(weights[4:6].sum() / weights[2:4].sum()) * a0 / a1 if fed else 0.0
    return cost, (a0, a1, gain)
