"""Figures of a filter: its estimates over time, its innovations, and their consistency."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimation.state import POSITION, Vector

Innovation = tuple[Vector, Vector]
"""A measurement minus its prediction (m,), and the innovation covariance (m, m) of the filter."""


@dataclass(frozen=True, slots=True)
class FilterFigures:
    """The figures of one filter; None where a figure is unknown.

    `nis` is the mean normalised innovation squared over its dimension: 1 for a consistent filter. `refused` is the
    share of rejected measurements, `prediction_m` the distance of the accepted ones from their prediction, `error_m`
    the distance of the estimate from the truth (both rms).
    """

    measurements: int
    nis: float | None
    refused: float | None
    prediction_m: float | None
    error_m: float | None


class EstimateTrack:
    """The estimates of one filter over time, and the innovations of its measurements."""

    def __init__(self) -> None:
        self._motion: dict[float, Vector] = {}
        self._nis: list[float] = []
        self._prediction_error_m2: list[float] = []
        self._taken = self._refused = 0

    def add(self, time_s: float, motion: Vector) -> None:
        """Add the estimate (4,) = [x y x' y'] at a tick."""
        self._motion[time_s] = motion

    def add_measurement(self, accepted: bool, innovation: Innovation | None) -> None:
        """Add whether a measurement was accepted, and its innovation, None without a prediction."""
        self._taken += 1
        self._refused += not accepted
        if accepted and innovation is not None:
            off, spread = innovation
            self._nis.append(float(off @ np.linalg.solve(spread, off)) / off.size)
            self._prediction_error_m2.append(float(off[POSITION] @ off[POSITION]))

    def figures(self, truth_m: Callable[[Vector], Vector] | None) -> FilterFigures:
        """Return the figures; `truth_m` returns true positions (T, 2) at times (T,), NaN where they are not known."""
        return FilterFigures(
            self._taken,
            float(np.mean(self._nis)) if self._nis else None,
            self._refused / self._taken if self._taken else None,
            float(np.sqrt(np.mean(self._prediction_error_m2))) if self._prediction_error_m2 else None,
            None if truth_m is None or not self._motion else self._error_m(truth_m),
        )

    def _error_m(self, truth_m: Callable[[Vector], Vector]) -> float | None:
        time_s = np.array(list(self._motion))
        off = np.array(list(self._motion.values()))[:, POSITION] - truth_m(time_s)
        squared = np.sum(off**2, axis=1)
        known = squared[np.isfinite(squared)]
        return float(np.sqrt(known.mean())) if known.size else None

    def difference(self, other: "EstimateTrack", part: slice) -> Vector:
        """Return the difference (T, 2) of two tracks at the times at which both have an estimate."""
        times = [time_s for time_s in self._motion if time_s in other._motion]
        return np.array([self._motion[time_s][part] - other._motion[time_s][part] for time_s in times])


def rms_difference(one: EstimateTrack, other: EstimateTrack, part: slice) -> float | None:
    """Return the rms difference of two tracks in position or velocity, None without common times."""
    apart = one.difference(other, part)
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if apart.size else None
