"""Check of a log's units: positions must change as fast as the velocities, and as far as the setpoints.

Ranges alone cannot distinguish millimetres from metres. Two correlated series can, if one moves hundreds of times as
far as the other. Series that are not correlated pass.
"""

from collections.abc import Mapping
from math import log10, sqrt

import numpy as np

from estimation.state import Vector
from gcs.vehicle_logs.vehicle_log import Series

WINDOW_S = 0.5
GAP_MAX_S = 2.0
WINDOWS_MIN = 10
LAGS_S = tuple(np.arange(0.0, 3.1, 0.5).tolist())
"""Lags of the position behind the setpoint that are tried."""
ALIKE_MIN = 0.6
"""Correlation above which two series are compared."""
VELOCITY_FACTOR_MAX, SETPOINT_FACTOR_MAX = 5.0, 20.0
"""Neither a filter's lag nor bad tracking causes factors beyond these."""


def unit_faults(series: Mapping[str, Series]) -> list[str]:
    """Return the faults of series that are not in metres and seconds, with topic and time."""
    faults = []
    for moved, velocity in (("position", "velocity"), ("true_position", "true_velocity")):
        if moved in series and velocity in series:
            faults += _against_velocity(series[moved], series[velocity])
    if "setpoint" in series and "position" in series:
        faults += _against_position(series["setpoint"], series["position"])
    return faults


def _against_velocity(position: Series, velocity: Series) -> list[str]:
    """Compare the distance moved in windows with the integral of the velocity."""
    times_s = _windows_s(position, velocity)
    if times_s.size < 2:
        return []
    moved = np.diff(_at(times_s, position.time_s, position.values), axis=0)
    steps_s = np.diff(velocity.time_s)[:, np.newaxis]
    means = 0.5 * (velocity.values[1:] + velocity.values[:-1])
    way = np.vstack((np.zeros(means.shape[1]), np.cumsum(means * np.minimum(steps_s, GAP_MAX_S), axis=0)))
    expected = np.diff(_at(times_s, velocity.time_s, way), axis=0)
    likeness, factor = _factor(expected, moved)
    if likeness < ALIKE_MIN or 1.0 / VELOCITY_FACTOR_MAX < factor < VELOCITY_FACTOR_MAX:
        return []
    at_s = times_s[int(np.abs(moved).sum(axis=1).argmax())]
    return [
        f"{position.topic}: the position moves {_factor_text(factor)} as fast as the velocity in {velocity.topic}, "
        f"most of all at {at_s:.1f} s: one of them is not in metres"
    ]


def _against_position(setpoint: Series, position: Series) -> list[str]:
    """Compare how far the setpoints and the vehicle moved, at the lag of the highest correlation."""
    times_s = _windows_s(setpoint, position)
    if times_s.size < 2:
        return []
    held = setpoint.values[np.searchsorted(setpoint.time_s, times_s, side="right") - 1]
    known = np.isfinite(held).all(axis=1)
    if known.sum() < WINDOWS_MIN:
        return []
    held, times_s = held[known], times_s[known]
    asked = held - held.mean(axis=0)
    flown = [_at(times_s + lag_s, position.time_s, position.values) for lag_s in LAGS_S]
    likeness, factor = max(_factor(after - after.mean(axis=0), asked) for after in flown)
    if likeness < ALIKE_MIN or 1.0 / SETPOINT_FACTOR_MAX < factor < SETPOINT_FACTOR_MAX:
        return []
    at_s = times_s[int(np.abs(asked).sum(axis=1).argmax())]
    return [
        f"{setpoint.topic}: the setpoints move {_factor_text(factor)} as far as the vehicle in {position.topic}, "
        f"most of all at {at_s:.1f} s: one of them is not in metres"
    ]


def _windows_s(first: Series, second: Series) -> Vector:
    """Return the begin and end times of windows in which both series have samples."""
    begin_s = max(first.time_s[0], second.time_s[0])
    end_s = min(first.time_s[-1], second.time_s[-1])
    return np.arange(begin_s, end_s, WINDOW_S) if end_s > begin_s else np.empty(0)


def _at(times_s: Vector, sampled_s: Vector, values: Vector) -> Vector:
    return np.column_stack([np.interp(times_s, sampled_s, column) for column in values.T])


def _factor(reference: Vector, other: Vector) -> tuple[float, float]:
    """Return the correlation of two series, and how much farther the other one moves; 0 if unknown."""
    if reference.shape[0] < WINDOWS_MIN:
        return 0.0, 0.0
    product, own, others = (float((a * b).sum()) for a, b in ((reference, other), (reference,) * 2, (other,) * 2))
    scale = sqrt(own) * sqrt(others)
    return (product / scale, sqrt(others) / sqrt(own)) if scale > 0.0 else (0.0, 0.0)


def _factor_text(factor: float) -> str:
    exact = 10.0 ** round(log10(factor))
    return f"about {exact:g} times ({factor:.3g})"
