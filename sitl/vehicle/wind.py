"""The wind at a vehicle: a steady part, and Dryden turbulence at low altitude (MIL-F-8785C, section 3.7.2.5).

Turbulence is a frozen field that moves past the vehicle with the wind (Taylor's hypothesis). The vehicle's speed is
neglected.
"""

from dataclasses import dataclass
from math import hypot, sqrt
from typing import Final

import numpy as np

FEET_M: Final = 0.3048
SPEED_LEAST_M_S: Final = 1.0
"""Lower bound of the field's speed: in weaker wind the vehicle's own motion dominates."""
_BLOCK: Final = 512


@dataclass(frozen=True, slots=True)
class Turbulence:
    """Dryden's parameters: scale length [m] and intensity [m/s], both horizontal, and the field's speed [m/s]."""

    length_m: float
    intensity_m_s: float
    speed_m_s: float


def low_altitude(wind_m_s: float, height_m: float) -> Turbulence:
    """Return the turbulence below 1000 ft in a wind of `wind_m_s` at 20 ft; below 10 ft it is that of 10 ft."""
    height_ft = max(height_m / FEET_M, 10.0)
    shape = 0.177 + 0.000823 * height_ft
    intensity_m_s = 0.1 * wind_m_s / shape**0.4
    return Turbulence(height_ft / shape**1.2 * FEET_M, intensity_m_s, max(wind_m_s, SPEED_LEAST_M_S))


class Wind:
    """The wind at one vehicle, step by step [m/s, mission frame]; its turbulence starts in the stationary state."""

    def __init__(
        self, steady_m_s: tuple[float, float], gusts: Turbulence | None, step_s: float, random: np.random.Generator
    ) -> None:
        """Set a steady wind, with gusts along and across it, or without."""
        speed_m_s = hypot(*steady_m_s)
        along = (steady_m_s[0] / speed_m_s, steady_m_s[1] / speed_m_s) if speed_m_s > 0.0 else (1.0, 0.0)
        self._steady = steady_m_s
        self._along = along
        self._random = random
        self._gusts = None if gusts is None else _Shaping(gusts, step_s, random)

    def blow(self) -> tuple[float, float]:
        """Return the wind (x, y) over the next step."""
        if self._gusts is None:
            return self._steady
        along, across = self._gusts.advance()
        (x, y), (cosine, sine) = self._steady, self._along
        return x + along * cosine - across * sine, y + along * sine + across * cosine


class _Shaping:
    """White noise through Dryden's filters, discretised exactly: one state along, two across."""

    def __init__(self, gusts: Turbulence, step_s: float, random: np.random.Generator) -> None:
        from scipy.linalg import expm  # noqa: PLC0415 - slow to import, and most flights are without gusts

        span_s = gusts.length_m / gusts.speed_m_s
        flow = np.array([[-1.0 / span_s, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0 / span_s**2, -2.0 / span_s]])
        # White noise of unit density drives the last state of each chain; the outputs have the spectra above.
        noise = np.diag([1.0, 0.0, 1.0])
        block = expm(np.block([[-flow, noise], [np.zeros((3, 3)), flow.T]]) * step_s)
        self._step = block[3:, 3:].T
        covariance = self._step @ block[:3, 3:]
        self._root = np.linalg.cholesky((covariance + covariance.T) / 2.0)
        sigma = gusts.intensity_m_s
        self._output = np.array(
            [
                [sigma * sqrt(2.0 / span_s), 0.0, 0.0],
                [0.0, sigma / span_s**1.5, sigma * sqrt(3.0 / span_s)],
            ]
        )
        stationary = np.diag([span_s / 2.0, span_s**3 / 4.0, span_s / 4.0])
        along, across, slope = (np.sqrt(stationary) @ random.standard_normal(3)).tolist()
        self._state: tuple[float, float, float] = (along, across, slope)
        self._random = random
        self._ahead: list[list[float]] = []

    def advance(self) -> tuple[float, float]:
        if not self._ahead:
            self._ahead = self._block()
        along, across = self._ahead.pop()
        return along, across

    def _block(self) -> list[list[float]]:
        """Return gusts of many steps, the last one first."""
        pushes = self._random.standard_normal((_BLOCK, 3)) @ self._root.T
        (aa, _, _), (_, bb, bc), (_, cb, cc) = self._step.tolist()  # no entry couples along and across
        along, across, slope = self._state
        states = []
        for along_push, across_push, slope_push in pushes.tolist():
            along, across, slope = (
                aa * along + along_push,
                bb * across + bc * slope + across_push,
                cb * across + cc * slope + slope_push,
            )
            states.append((along, across, slope))
        self._state = along, across, slope
        return list((np.array(states) @ self._output.T)[::-1].tolist())
