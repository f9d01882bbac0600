"""Validation of a plant in flight: predictions from the setpoints, compared with the positions.

The filter's innovations hardly show a wrong plant, because its disturbance absorbs the model error. Here the flight is
cut into windows, and in each the plant is simulated from the setpoints sent, with free initial position, initial
velocity and one steady disturbance. The remaining error is compared with that of other plants.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import POSITION, Vector

STEP_S = 0.1
WINDOW_S = 10.0
SHARES = (0.6, 0.75, 1.0, 1.33, 1.67)
"""The factors of stiffness and damping of the other plants."""
DELAYS_S = (-0.2, -0.1, 0.0, 0.1, 0.2)
DELAY_MAX_S, DELAY_STEP_S = 1.0, 0.02
WINDOWS_LEAST = 6
MOVED_LEAST_M = 0.3
"""The smallest motion of the setpoint (rms, about a straight line) in a window that is used."""
_FREE = 3


@dataclass(frozen=True, slots=True)
class PlantComparison:
    """The prediction error of a plant (rms), that of the best other plant, and which plant that is."""

    windows: int
    unexplained_m: float
    best_m: float
    best: Plant


def watch(plant: Plant, setpoints: Vector, samples: Vector) -> PlantComparison | None:
    """Compare a plant with a flight: setpoints (S, 3) and positions (K, 3), each row a time [s] and a position [m].

    Setpoints with velocities are (S, 5). None without enough excitation to distinguish plants.
    """
    windows = list(_windows(setpoints, samples))
    if len(windows) < WINDOWS_LEAST:
        return None
    left = {each: _unexplained_m(each, windows) for each in (plant, *others(plant))}
    best = min(left, key=left.__getitem__)
    return PlantComparison(len(windows), left[plant], left[best], best)


def effect_delay_s(plant: Plant, setpoints: Vector, samples: Vector) -> float | None:
    """Return the delay from setpoint to position with which a plant explains a flight best [s].

    Arguments and None as in `watch`.
    """
    windows = list(_windows(setpoints, samples))
    if len(windows) < WINDOWS_LEAST:
        return None
    tried_s = np.arange(0.0, DELAY_MAX_S + DELAY_STEP_S / 2.0, DELAY_STEP_S)
    left = [_unexplained_m(replace(plant, delay_s=float(delay_s)), windows) for delay_s in tried_s]
    return float(tried_s[np.argmin(left)])


def others(plant: Plant) -> list[Plant]:
    """Return the plants that a plant is compared with; for one with feed-forward also the same without."""
    tried = [replace(plant, feedforward=0.0)] if plant.feedforward else []
    for a0, a1, later_s in product(SHARES, SHARES, DELAYS_S):
        x, y = (PlantAxis(axis.a0_per_s2 * a0, axis.a1_per_s * a1) for axis in (plant.x, plant.y))
        delay_s = round(plant.delay_s + later_s, 3)
        if 0.0 <= delay_s <= 1.0 and (a0, a1, later_s) != (1.0, 1.0, 0.0):
            tried.append(replace(plant, x=x, y=y, delay_s=delay_s))
    return tried


@dataclass(frozen=True, slots=True)
class _Window:
    """A window: its begin, its positions (N, 2), and all setpoints by time, with their velocities (S, 2)."""

    from_s: float
    position_m: Vector
    setpoint_s: Vector
    setpoint_m: Vector
    velocity_m_s: Vector


def _windows(setpoints: Vector, samples: Vector) -> Iterator[_Window]:
    setpoints = setpoints[np.isfinite(setpoints).all(axis=1)]
    if len(setpoints) < 2 or len(samples) < 2:
        return
    count = round(WINDOW_S / STEP_S)
    first_s, last_s = max(setpoints[0, 0] + 1.0, samples[0, 0]), min(setpoints[-1, 0], samples[-1, 0])
    for from_s in np.arange(first_s, last_s - WINDOW_S, WINDOW_S):
        time_s = from_s + STEP_S * np.arange(count + 1)
        near = samples[(samples[:, 0] >= from_s - 1.0) & (samples[:, 0] <= from_s + WINDOW_S + 1.0)]
        if len(near) < count / 2.0 or np.diff(near[:, 0]).max() > 1.0:
            continue
        asked = _held(setpoints[:, 0], setpoints[:, 1:3], time_s)
        if np.sqrt(np.mean(_without_line(asked) ** 2)) < MOVED_LEAST_M:
            continue
        place = np.column_stack([np.interp(time_s, near[:, 0], near[:, k]) for k in (1, 2)])
        yield _Window(float(from_s), place, setpoints[:, 0], setpoints[:, 1:3], setpoints[:, 3:])


def _held(at_s: Vector, value: Vector, time_s: Vector) -> Vector:
    return value[np.maximum(np.searchsorted(at_s, time_s + 1e-6, side="right") - 1, 0)]


def _means(at_s: Vector, value: Vector, edges_s: Vector) -> Vector:
    """Return the means of a piecewise constant value between successive edges."""
    total = np.vstack([np.zeros(2), np.cumsum(value[:-1] * np.diff(at_s)[:, None], axis=0)])
    totals = np.column_stack([np.interp(edges_s, at_s, column) for column in total.T])
    return np.diff(totals, axis=0) / STEP_S


def _without_line(values: Vector) -> Vector:
    base = np.column_stack([np.ones(len(values)), np.arange(len(values))])
    return values - base @ np.linalg.lstsq(base, values, rcond=None)[0]


def _aims(plant: Plant, window: _Window) -> Vector:
    return window.setpoint_m + plant.lead_s * window.velocity_m_s if window.velocity_m_s.size else window.setpoint_m


def _unexplained_m(plant: Plant, windows: Sequence[_Window]) -> float:
    """Return the error of a plant (rms over all windows and both axes)."""
    step = exact_step(plant, STEP_S)
    count = len(windows[0].position_m)
    begins_s = np.array([window.from_s for window in windows])
    pushes = np.array(
        [
            _means(window.setpoint_s, _aims(plant, window), begins_s[k] - plant.delay_s + STEP_S * np.arange(count + 1))
            for k, window in enumerate(windows)
        ]
    )
    states, free = np.zeros((len(windows), 4)), np.hstack([np.eye(4), np.zeros((4, 2))])
    answers, bases = [], []
    for k in range(count):
        answers.append(states[:, POSITION])
        bases.append(free[POSITION])
        states = states @ step.transition.T + pushes[:, k] @ step.input_gain.T
        free = step.transition @ free
        free[:, 4:] += step.disturbance_gain
    answered, basis = np.array(answers).transpose(1, 0, 2), np.array(bases)
    squared = 0.0
    for axis in range(2):
        orthonormal, _ = np.linalg.qr(basis[:, axis, axis::2])
        off = np.array([window.position_m[:, axis] for window in windows]) - answered[:, :, axis]
        left = off - off @ orthonormal @ orthonormal.T
        squared += float(np.sum(left**2))
    return float(np.sqrt(squared / (2 * len(windows) * (count - _FREE))))
