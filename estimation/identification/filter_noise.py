"""The noise and disturbance settings of the own filter, identified from the same flight as the plant.

Noise of position and velocity is measured: from positions without their smooth motion, and from the difference between
the reported velocity and the rate of the reported position. The random walk of the disturbance is chosen to minimise
the error of the filter's prediction one second ahead.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_are

from estimation.identification.excerpts import GRID_S, Excerpt
from estimation.identification.output_error import Fit
from estimation.identification.shaping import mean_inputs
from estimation.plant.model import Plant, exact_step
from estimation.settings import OwnFilterSettings
from estimation.state import Vector

AHEAD_S = 1.0
"""Half of it is the delay of a slow link; over longer times the plant's errors exceed those of the filter's state."""
TELEMETRY_S = 0.05
"""The sample period of the filter in flight; an estimator's errors do not depend on its report rate."""
POSITION_LEAST_M = OwnFilterSettings().position_noise_m
VELOCITY_LEAST_M_S = OwnFilterSettings().velocity_noise_m_s
_WALKS_M_S2 = np.geomspace(OwnFilterSettings().disturbance_noise_m_s2, 0.4, 14)
"""The smallest random walk follows a wind that the flight may not have had."""
_NEAR_BEST = 1.05
"""The smallest random walk within this factor of the least prediction error is used, for smoother setpoints."""
_SETTLED_S = 5.0
_MAX_QUANTILE, _MAX_RESERVE = 0.99, 1.25
_MAX_RANGE_M_S2 = (OwnFilterSettings().disturbance_max_m_s2, 2.0)
"""The smallest bound leaves a margin for such a wind."""
_WHITE_THIRD_DIFFERENCE = 20.0
"""Variance of the third difference of white noise, relative to the noise: 1 + 9 + 9 + 1."""


@dataclass(frozen=True, slots=True)
class FilterNoise:
    """IdentificationResult settings of the own filter, and its prediction error `AHEAD_S` ahead with them (rms).

    `innovation` is the normalised squared innovation: 1 if the noise is as large as assumed.
    """

    position_noise_m: float
    velocity_noise_m_s: float
    disturbance_noise_m_s2: float
    disturbance_max_m_s2: float
    predicted_rms_m: float
    innovation: float


def filter_noise_of(
    excerpts: Sequence[Excerpt], best: Fit, plant: Plant, damping_doubt_per_s: float
) -> FilterNoise | None:
    """Return the settings; None if the flights have no reported velocities.

    `damping_doubt_per_s` is half the width of the interval of a1. At the speeds flown it acts as a disturbance, for
    which the bound leaves room beside that for a wind.
    """
    flights = [_flight(excerpt, best, plant) for excerpt in excerpts if excerpt.reported_m_s is not None]
    if not flights:
        return None
    position_m = max(POSITION_LEAST_M, _rms([_roughness_m(excerpt) for excerpt in excerpts]))
    velocity_m_s = max(VELOCITY_LEAST_M_S, _rms([_rate_error_m_s(flight) for flight in flights]))
    tried = [_Tried.of(flights, plant, (position_m, velocity_m_s), float(walk)) for walk in _WALKS_M_S2]
    least_m = min(each.predicted_rms_m for each in tried)
    chosen = next(each for each in tried if each.predicted_rms_m <= _NEAR_BEST * least_m)
    fast_m_s = float(np.quantile(np.abs(np.concatenate([each.velocity_m_s for each in flights])), _MAX_QUANTILE))
    least_m_s2, most_m_s2 = _MAX_RANGE_M_S2
    room_m_s2 = max(_MAX_RESERVE * chosen.disturbance_m_s2, least_m_s2 + damping_doubt_per_s * fast_m_s)
    return FilterNoise(
        position_noise_m=position_m,
        velocity_noise_m_s=velocity_m_s,
        disturbance_noise_m_s2=chosen.walk_m_s2,
        disturbance_max_m_s2=min(room_m_s2, most_m_s2),
        predicted_rms_m=chosen.predicted_rms_m,
        innovation=chosen.innovation,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Flight:
    """Positions, reported velocities and the mean aims over the step to each, all (T, 2)."""

    position_m: Vector
    velocity_m_s: Vector
    aim_m: Vector


def _flight(excerpt: Excerpt, best: Fit, plant: Plant) -> _Flight:
    assert excerpt.reported_m_s is not None
    inputs, count = excerpt.inputs(best.model.between), excerpt.position_m.shape[0]
    delay, begin_s = np.array([plant.delay_s]), excerpt.begin_s - GRID_S
    aim_m = mean_inputs(delay, begin_s, count, [each.position for each in inputs])[:, 0]
    velocities = [each.velocity for each in inputs if each.velocity is not None]
    if velocities and plant.feedforward:
        aim_m = aim_m + plant.lead_s * mean_inputs(delay, begin_s, count, velocities)[:, 0]
    return _Flight(excerpt.position_m, excerpt.reported_m_s, aim_m)


def _roughness_m(excerpt: Excerpt) -> Vector:
    """Return the third differences of the logged positions; interpolated positions would be smoothed."""
    time_s = excerpt.recording.position_time_s
    logged = (time_s >= excerpt.time_s[0]) & (time_s <= excerpt.time_s[-1])
    return np.asarray(np.diff(excerpt.recording.position_m[logged], 3, axis=0) / np.sqrt(_WHITE_THIRD_DIFFERENCE))


def _rate_error_m_s(flight: _Flight) -> Vector:
    """Return the reported velocity minus the rate of the reported position, over each AHEAD_S."""
    steps = round(AHEAD_S / GRID_S)
    middle_m_s = (flight.velocity_m_s[1:] + flight.velocity_m_s[:-1]) / 2.0
    travelled_m = np.cumsum(np.vstack((np.zeros((1, 2)), middle_m_s * GRID_S)), axis=0)
    apart_m = travelled_m - flight.position_m
    return np.asarray((apart_m[steps:] - apart_m[:-steps]) / AHEAD_S)


def _rms(parts: Sequence[Vector]) -> float:
    return float(np.sqrt(np.mean(np.concatenate([part.ravel() for part in parts]) ** 2)))


@dataclass(frozen=True, slots=True)
class _Tried:
    """A random walk of the disturbance: its prediction error, innovation, and a high quantile of the disturbance."""

    walk_m_s2: float
    predicted_rms_m: float
    innovation: float
    disturbance_m_s2: float

    @classmethod
    def of(cls, flights: Sequence[_Flight], plant: Plant, noise: tuple[float, float], walk_m_s2: float) -> "_Tried":
        errors, innovations, disturbances = [], [], []
        for axis in range(2):
            steady = _Steady(plant, axis, noise, walk_m_s2)
            for flight in flights:
                states, squared = steady.filtered(flight, axis)
                settled = slice(round(_SETTLED_S / GRID_S), None)
                errors.append(steady.errors_ahead_m(states, flight, axis)[settled])
                innovations.append(squared[settled])
                disturbances.append(states[settled, 2])
        return cls(
            walk_m_s2,
            _rms(errors),
            float(np.mean(np.concatenate(innovations))),
            float(np.quantile(np.abs(np.concatenate(disturbances)), _MAX_QUANTILE)),
        )


class _Steady:
    """The own filter of one axis with its steady-state gain: state [p v w], measured p and v."""

    def __init__(self, plant: Plant, axis: int, noise: tuple[float, float], walk_m_s2: float) -> None:
        step, (p, v) = exact_step(plant, GRID_S), (axis, axis + 2)
        self.transition = np.eye(3)
        self.transition[:2, :2] = step.transition[np.ix_([p, v], [p, v])]
        self.transition[:2, 2] = step.disturbance_gain[[p, v], axis]
        self.input_gain = np.append(step.input_gain[[p, v], axis], 0.0)
        density = OwnFilterSettings().acceleration_noise_m_s2 ** 2
        process = np.zeros((3, 3))
        process[:2, :2] = density * np.array([[GRID_S**3 / 3.0, GRID_S**2 / 2.0], [GRID_S**2 / 2.0, GRID_S]])
        process[2, 2] = walk_m_s2**2 * GRID_S
        measured = np.eye(2, 3)
        per_sample = np.diag(np.square(noise)) * (TELEMETRY_S / GRID_S)
        prior = solve_discrete_are(self.transition.T, measured.T, process, per_sample)
        innovation = prior[:2, :2] + per_sample
        self.gain = prior[:, :2] @ np.linalg.inv(innovation)
        self.information = np.linalg.inv(innovation)

    def filtered(self, flight: _Flight, axis: int) -> tuple[Vector, Vector]:
        """Return the states (T, 3) after each sample, and the squared innovations per degree of freedom (T,)."""
        measured = np.column_stack((flight.position_m[:, axis], flight.velocity_m_s[:, axis]))
        state, states, innovations = np.append(measured[0], 0.0), np.empty((len(measured), 3)), np.zeros(measured.shape)
        states[0] = state
        for at in range(1, len(measured)):
            state = self.transition @ state + self.input_gain * flight.aim_m[at, axis]
            innovations[at] = measured[at] - state[:2]
            state = state + self.gain @ innovations[at]
            states[at] = state
        return states, np.einsum("ti,ij,tj->t", innovations, self.information, innovations) / 2.0

    def errors_ahead_m(self, states: Vector, flight: _Flight, axis: int) -> Vector:
        """Return the errors of the positions predicted AHEAD_S before under the actual aims."""
        steps = round(AHEAD_S / GRID_S)
        ahead = states[:-steps].T
        for at in range(1, steps + 1):
            aims_m = flight.aim_m[at : at + ahead.shape[1], axis]
            ahead = self.transition @ ahead + np.outer(self.input_gain, aims_m)
        return np.asarray(flight.position_m[steps:, axis] - ahead[0])
