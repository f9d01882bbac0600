"""Output-error fit of a plant: simulated from the setpoints only, compared with the positions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from estimation.identification.excerpts import GRID_S, Excerpt, grid_s
from estimation.identification.response import InputHold, Response, response_of
from estimation.plant.model import Plant
from estimation.state import Vector

ORDER_MAX = 4


def whitening_filter(errors: Sequence[Vector]) -> Vector:
    """Return the filter (p + 1,) that whitens blocks of errors to variance 1.

    It is the inverse of an autoregressive model; its order p is chosen by Schwarz' criterion.
    """
    best, best_score = np.array([1.0]), np.inf
    scale = float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) or 1.0
    count = sum(each.size - ORDER_MAX for each in errors)
    for order in range(1, ORDER_MAX + 1):
        past = np.concatenate(
            [
                np.column_stack([each[ORDER_MAX - lag : each.size - lag] for lag in range(1, order + 1)])
                for each in errors
            ]
        )
        present = np.concatenate([each[ORDER_MAX:] for each in errors])
        weights, *_ = np.linalg.lstsq(past, present, rcond=None)
        variance = max(float(np.mean((present - past @ weights) ** 2)), (1e-9 * scale) ** 2, 1e-24)
        score = count * np.log(variance) + order * np.log(count)
        if score < best_score:
            best, best_score = np.append(1.0, -weights) / np.sqrt(variance), score
    return np.asarray(best, dtype=np.float64)


def whitened(whitening: Vector, values: Vector) -> Vector:
    """Return filtered values (T,) or (T, k), without the first p, which would need earlier values."""
    if values.ndim == 1:
        return np.convolve(values, whitening, mode="valid")
    return np.column_stack([np.convolve(column, whitening, mode="valid") for column in values.T])


def jackknifed(jacobians: Sequence[Vector], errors: Sequence[Vector]) -> tuple[Vector, int]:
    """Return the covariance (k, k) of a fit by a jackknife over blocks, and the number of blocks.

    The arguments are Jacobians (T, k) and errors (T,) of blocks of time. Errors may be correlated in any way within a
    block; blocks with large influence are weighted accordingly (MacKinnon and Webb 2023, CV3).
    """
    information = np.sum([each.T @ each for each in jacobians], axis=0)
    moves = [
        np.linalg.pinv(information - each.T @ each, hermitian=True) @ (each.T @ error)
        for each, error in zip(jacobians, errors, strict=True)
    ]
    count = len(moves)
    return (count - 1) / count * np.sum([np.outer(move, move) for move in moves], axis=0), count


def autocorrelation(errors: Sequence[Vector], lags: int) -> Vector:
    """Return the autocorrelation of errors at lags 1 to `lags`, (lags,)."""
    energy = sum(float(each @ each) for each in errors) or 1.0
    return np.array([sum(float(each[lag:] @ each[:-lag]) for each in errors) / energy for lag in range(1, lags + 1)])


def whiteness(errors: Sequence[Vector], lags: int = 20) -> tuple[float, float]:
    """Return the share of the first autocorrelations within the 95 % bounds of white noise, and the bounds."""
    count = sum(each.size for each in errors)
    bound = 1.96 / np.sqrt(max(count, 1))
    return float(np.mean(np.abs(autocorrelation(errors, lags)) <= bound)), float(bound)


DELAY_MIN_S, DELAY_MAX_S = -0.3, 0.6
"""A negative delay is not causal, but the fit allows it because it reveals faulty clocks or sampling."""
_NO_DELAY_S = 1e-5
A0_RANGE, A1_RANGE, LAG_RANGE_S, FEEDFORWARD_RANGE = (0.02, 60.0), (0.05, 60.0), (0.005, 2.0), (-1.0, 3.0)
PLANT_NAMES = ("x.a0_per_s2", "x.a1_per_s", "y.a0_per_s2", "y.a1_per_s", "delay_s")
BLOCK_S = 8.0
"""Errors this far apart are assumed to be independent in the confidence intervals."""
SENT_S = 0.05
"""MAVSDK sends setpoints at 20 Hz or more. A log that samples them may be synchronous with the sender; all its
setpoints are then late by the same unknown share of the period.
"""
_ROUNDS = 2
_PLAIN = np.array([1.0])
_PRIOR_DEVIATION = 3.0
"""Prior standard deviation of the fitted parameters: a factor of twenty either way."""
_NUDGE = 1e-5
_TRAINING_MIN = 40
_REMEMBERED = 8
"""The last errors of an axis that are kept: of a point, and of its derivatives along two parameters."""


@dataclass(frozen=True, slots=True)
class Model:
    """The parameters fitted in addition to a0, a1 and the delay, and the assumed input between setpoints.

    With `alike`, both axes have the same a0 and a1.
    """

    between: InputHold
    lag: bool = False
    feedforward: bool = False
    delayed: bool = True
    alike: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the fitted parameters, in order."""
        return PLANT_NAMES + ("feedforward",) * self.feedforward + ("lag_s",) * self.lag

    @property
    def directions(self) -> Vector:
        """Return the directions (k, d) in which the fitted parameters are free."""
        every = np.eye(len(self.names))
        return np.column_stack((every[0] + every[2], every[1] + every[3], every[:, 4:])) if self.alike else every

    def responses(self, parameters: Vector) -> tuple[Response, Response]:
        """Return each axis' response; fitted parameters hold the logarithms of a0 and a1."""
        x0, x1, y0, y1 = np.exp(parameters[:4]).tolist()
        # A longer lag would be unstable (Hurwitz).
        lag_s = min(float(np.exp(parameters[-1])), 0.95 * x1 / x0, 0.95 * y1 / y0) if self.lag else 0.0
        return response_of(x0, x1, lag_s), response_of(y0, y1, lag_s)

    def leads_s(self, parameters: Vector) -> tuple[float, float]:
        """Return the lead time of each axis' aim by the feed-forward velocity, g a1 / a0."""
        gain = float(parameters[5]) if self.feedforward else 0.0
        x, y = np.exp(parameters[1:4:2] - parameters[0:4:2]).tolist()
        return gain * x, gain * y

    def bounds(self) -> tuple[Vector, Vector]:
        """Return the lower and upper bounds of the fitted parameters."""
        logs = [np.log(A0_RANGE), np.log(A1_RANGE)] * 2
        least_s = 0.0 if self.lag else DELAY_MIN_S
        delay_range_s = (least_s, DELAY_MAX_S) if self.delayed else (-_NO_DELAY_S, _NO_DELAY_S)
        rows = [*logs, np.array(delay_range_s)]
        rows += [np.array(FEEDFORWARD_RANGE)] * self.feedforward + [np.log(LAG_RANGE_S)] * self.lag
        low, high = np.array(rows, dtype=np.float64).T
        return low, high


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fit: fitted parameters (k,), their covariance with its number of blocks, and the noise of each axis.

    `errors` are the whitened errors, one array for each axis and excerpt; `score` is -2 times the logarithm of their
    likelihood. `unbounded_delay_s` is the delay that fits best if it is not bounded to causal values.
    """

    model: Model
    parameters: Vector
    covariance: Vector
    whitening: tuple[Vector, Vector]
    errors: tuple[tuple[Vector, ...], ...]
    blocks: int
    unbounded_delay_s: float | None = None

    @property
    def score(self) -> float:
        """-2 times the log-likelihood of the flights under this fit."""
        pairs = zip(self.errors, self.whitening, strict=True)
        return float(
            sum(each @ each - 2.0 * each.size * np.log(whitening[0]) for axis, whitening in pairs for each in axis)
        )

    @property
    def deviations95(self) -> Vector:
        """Half the width of the parameters' 95 % intervals (k,)."""
        return np.asarray(self.quantile95 * np.sqrt(np.diag(self.covariance)), dtype=np.float64)

    @property
    def quantile95(self) -> float:
        """Half the width of a 95 % interval in standard deviations, by Student's distribution."""
        return float(student.ppf(0.975, max(self.blocks - 1, 1)))

    def unbounded_delay(self) -> float:
        """Return the delay that fits best [s], causal or not."""
        return float(self.parameters[4]) if self.unbounded_delay_s is None else self.unbounded_delay_s

    @property
    def count(self) -> int:
        """The number of errors."""
        return sum(each.size for axis in self.errors for each in axis)


def parameters_of(plant: Plant, model: Model) -> Vector:
    """Return a plant's parameters in the form of a model without a lag."""
    (x0, y0), (x1, y1) = np.log(plant.a0_per_s2), np.log(plant.a1_per_s)
    return np.array([x0, x1, y0, y1, plant.delay_s, *[plant.feedforward] * model.feedforward])


def fit(
    excerpts: Sequence[Excerpt],
    model: Model,
    start: Vector,
    share: float = 1.0,
    whiten: bool = True,
) -> Fit:
    """Fit the model to the first `share` of each excerpt, with whitening of the errors estimated in rounds.

    The initial state and a constant disturbance are fitted as well for each excerpt and axis.
    """
    problem = _Problem(excerpts, model, share)
    filters = (_PLAIN, _PLAIN)
    parameters = problem.solved(start, filters)
    for _ in range(_ROUNDS if whiten else 0):
        plain = problem.errors(parameters, (_PLAIN, _PLAIN))
        filters = (whitening_filter(plain[0]), whitening_filter(plain[1]))
        parameters = problem.solved(parameters, filters)
    if not whiten:
        plain = problem.errors(parameters, filters)
        filters = (_levelled(plain[0]), _levelled(plain[1]))
    errors = problem.errors(parameters, filters)
    covariance, blocks = problem.covariance(parameters, filters)
    if any(excerpt.recording.sampled for excerpt in excerpts):
        covariance[4, 4] += SENT_S**2 / 12.0
    return Fit(model, parameters, covariance, filters, (tuple(errors[0]), tuple(errors[1])), blocks)


def delay_spread_s(excerpts: Sequence[Excerpt], fitted: Fit) -> float:
    """Return the variation of the delay between blocks of the flights (rms) beyond what the errors explain."""
    problem, late = _Problem(excerpts, fitted.model, 1.0), fitted.parameters.copy()
    late[4] += _NUDGE
    information = wanted = 0.0
    blocks = 0
    pairs = zip(*(problem.errors(each, fitted.whitening) for each in (fitted.parameters, late)), strict=True)
    for error, later in (pair for axis in pairs for pair in zip(*axis, strict=True)):
        count = max(1, round(error.size * GRID_S / BLOCK_S))
        for part, slope in zip(
            np.array_split(error, count), np.array_split((later - error) / _NUDGE, count), strict=True
        ):
            information += float(slope @ slope)
            wanted += float(slope @ part) ** 2 / max(float(slope @ slope), 1e-12)
            blocks += 1
    return float(np.sqrt(max(wanted - blocks, 0.0) / max(information, 1e-12)))


def _levelled(errors: Sequence[Vector]) -> Vector:
    """Return the filter that scales errors to variance 1 without whitening."""
    return _PLAIN / max(float(np.sqrt(np.mean(np.concatenate(errors) ** 2))), 1e-9)


def start_of(excerpts: Sequence[Excerpt], model: Model) -> Vector:
    """Return the start of the fit: the best of a coarse grid of plants, by axis, with full feed-forward."""
    problem, nominal = _Problem(excerpts, replace(model, lag=False), 1.0), [1.0] * model.feedforward
    white = (np.array([1.0]), np.array([1.0]))
    best: Vector = np.zeros(5)
    least = [np.inf] * 3
    for delay_s in (0.0, 0.15, 0.35):
        axes, costs = np.zeros(5), [np.inf, np.inf]
        axes[4] = delay_s
        for a0 in (0.15, 0.4, 0.8, 1.6, 4.0, 10.0):
            for damping in (0.35, 0.7, 1.2):
                pair = np.log([a0, 2.0 * damping * np.sqrt(a0)])
                errors = problem.errors(np.array([*pair, *pair, delay_s, *nominal]), white)
                for axis in range(2):
                    cost = float(sum(each @ each for each in errors[axis]))
                    if cost < costs[axis]:
                        costs[axis], axes[2 * axis : 2 * axis + 2] = cost, pair
        if sum(costs) < least[0]:
            least[0], best = sum(costs), axes
    return np.append(best, [*nominal, *[np.log(0.1)] * model.lag])


class _Problem:
    """The least-squares problem; linear parameters are eliminated (Golub and Pereyra 1973)."""

    def __init__(self, excerpts: Sequence[Excerpt], model: Model, share: float) -> None:
        self._model = model
        # Most derivatives are along parameters of one axis: the errors of the other stay what they are.
        self._errors_of = lru_cache(_REMEMBERED)(self._axis_errors)
        self._rows = []
        for excerpt in excerpts:
            count = max(_TRAINING_MIN, round(share * excerpt.position_m.shape[0]))
            self._rows.append((excerpt.begin_s, excerpt.position_m[:count], excerpt.inputs(model.between)))

    def residuals(self, parameters: Vector, filters: tuple[Vector, Vector]) -> Vector:
        return np.concatenate([each for axis in self.errors(parameters, filters) for each in axis])

    def errors(self, parameters: Vector, filters: tuple[Vector, Vector]) -> list[list[Vector]]:
        """Return the whitened errors of each axis and excerpt, with the linear parameters fitted."""
        delay_s, leads_s = float(parameters[4]), self._model.leads_s(parameters)
        return [
            self._errors_of(axis, response, leads_s[axis], delay_s, tuple(filters[axis].tolist()))
            for axis, response in enumerate(self._model.responses(parameters))
        ]

    def _axis_errors(
        self, axis: int, response: Response, lead_s: float, delay_s: float, weights: tuple[float, ...]
    ) -> list[Vector]:
        whitening = np.array(weights)
        bases, found = self._bases(response, whitening), []
        for begin_s, position_m, inputs in self._rows:
            count = position_m.shape[0]
            answered = response.answer(inputs[axis], lead_s, delay_s, begin_s, GRID_S, count)
            error = whitened(whitening, position_m[:, axis] - answered)
            basis = bases[count]
            found.append(error - basis @ (basis.T @ error))
        return found

    def _bases(self, response: Response, whitening: Vector) -> dict[int, Vector]:
        """Return an orthonormal basis of the whitened linear regressors for each length of excerpts."""
        counts = {position_m.shape[0] for _, position_m, _ in self._rows}
        grid = grid_s(max(counts))
        free = whitened(whitening, np.column_stack((np.ones(len(grid)), response.free(grid))))
        return {count: np.linalg.qr(free[: count + 1 - whitening.size])[0] for count in counts}

    def solved(self, start: Vector, filters: tuple[Vector, Vector]) -> Vector:
        """Return the parameters of the least sum of squares."""
        directions = self._model.directions
        onto = directions.T / directions.sum(axis=0)[:, None]  # parameters that are equal: their mean
        low, high = (onto @ bound for bound in self._model.bounds())
        solution = least_squares(
            lambda free: self.residuals(directions @ free, filters),
            np.clip(onto @ start, low + 1e-6, high - 1e-6),
            jac=lambda free: self.jacobian(directions @ free, filters),
            bounds=(low, high),
            x_scale=0.1,
            xtol=1e-4,
            ftol=1e-6,
            max_nfev=25,
        )
        parameters = np.asarray(directions @ solution.x, dtype=np.float64)
        if not self._model.delayed:
            parameters[4] = 0.0
        return parameters

    def jacobian(self, parameters: Vector, filters: tuple[Vector, Vector]) -> Vector:
        """Return the derivatives of the errors along the free directions, (N, d)."""
        here = self.residuals(parameters, filters)
        nudges = _NUDGE * self._model.directions.T
        return np.column_stack([(self.residuals(parameters + nudge, filters) - here) / _NUDGE for nudge in nudges])

    def covariance(self, parameters: Vector, filters: tuple[Vector, Vector]) -> tuple[Vector, int]:
        """Return the parameters' covariance, which is valid for correlated errors, and its number of blocks."""
        errors = self.errors(parameters, filters)
        jacobian = self.jacobian(parameters, filters)
        parts = np.split(jacobian, np.cumsum([each.size for axis in errors for each in axis])[:-1])
        blocks: list[tuple[Vector, Vector]] = []
        for x, y, x_errors, y_errors in zip(parts, parts[len(self._rows) :], *errors, strict=False):
            count = max(1, round(min(x_errors.size, y_errors.size) * GRID_S / BLOCK_S))
            cut = [np.array_split(each, count) for each in (x, y, x_errors, y_errors)]
            blocks += [(np.vstack(each[:2]), np.concatenate(each[2:])) for each in zip(*cut, strict=True)]
        covariance, count = jackknifed([each for each, _ in blocks], [each for _, each in blocks])
        directions = self._model.directions
        return directions @ _at_least(covariance, jacobian) @ directions.T, count


def _at_least(covariance: Vector, jacobian: Vector) -> Vector:
    """Return the covariance, increased in directions without excitation, which the jackknife does not detect."""
    prior = np.eye(covariance.shape[0]) / _PRIOR_DEVIATION**2
    expected = np.diag(np.linalg.inv(jacobian.T @ jacobian + prior))
    found = np.diag(covariance)
    scale = np.where(expected > 4.0 * found, np.sqrt(expected / np.maximum(found, 1e-12)), 1.0)
    widened = covariance * np.outer(scale, scale)
    np.fill_diagonal(widened, np.where(expected > 4.0 * found, expected, found))
    return np.asarray(widened, dtype=np.float64)
