"""How well a filter fares: its estimates over time, its innovations, and what they amount to."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimation.state import POSITION, Vector

Innovation = tuple[Vector, Vector]
"""A measurement minus its prediction (m,), and the covariance (m, m) that the filter expects of it."""


@dataclass(frozen=True, slots=True)
class FilterFigures:
    """A filter in figures; None is what is not known.

    `nis` is the mean of the squared normalised innovations over their dimension: 1 where the filter's noise is the
    measurements'. `refused` is the share of measurements that it refused, `prediction_m` how far the others were from
    its prediction, `error_m` how far it was from the truth (both rms).
    """

    measurements: int
    nis: float | None
    refused: float | None
    prediction_m: float | None
    error_m: float | None


class Track:
    """What one filter estimated and how it met its measurements."""

    def __init__(self) -> None:
        self._motion: dict[float, Vector] = {}
        self._nis: list[float] = []
        self._missed_m2: list[float] = []
        self._taken = self._refused = 0

    def add(self, time_s: float, motion: Vector) -> None:
        """Take the estimate (4,) = [x y x' y'] at a tick."""
        self._motion[time_s] = motion

    def innovate(self, accepted: bool, innovation: Innovation | None) -> None:
        """Take how a measurement was met; without an innovation where there was nothing to predict it from."""
        self._taken += 1
        self._refused += not accepted
        if accepted and innovation is not None:
            off, spread = innovation
            self._nis.append(float(off @ np.linalg.solve(spread, off)) / off.size)
            self._missed_m2.append(float(off[POSITION] @ off[POSITION]))

    def figures(self, truth_m: Callable[[Vector], Vector] | None) -> FilterFigures:
        """Return the figures; `truth_m` gives the true positions (T, 2) at times (T,), NaN where they are not known."""
        return FilterFigures(
            self._taken,
            float(np.mean(self._nis)) if self._nis else None,
            self._refused / self._taken if self._taken else None,
            float(np.sqrt(np.mean(self._missed_m2))) if self._missed_m2 else None,
            None if truth_m is None or not self._motion else self._error_m(truth_m),
        )

    def _error_m(self, truth_m: Callable[[Vector], Vector]) -> float | None:
        time_s = np.array(list(self._motion))
        off = np.array(list(self._motion.values()))[:, POSITION] - truth_m(time_s)
        squared = np.sum(off**2, axis=1)
        known = squared[np.isfinite(squared)]
        return float(np.sqrt(known.mean())) if known.size else None

    def at_both(self, other: "Track", part: slice) -> Vector:
        """Return by how much two tracks differ (T, 2) where both have an estimate."""
        times = [time_s for time_s in self._motion if time_s in other._motion]
        return np.array([self._motion[time_s][part] - other._motion[time_s][part] for time_s in times])


def rms_difference(one: Track, other: Track, part: slice) -> float | None:
    """Return the rms by which two tracks differ in position or velocity, None where they never both know."""
    apart = one.at_both(other, part)
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if apart.size else None
