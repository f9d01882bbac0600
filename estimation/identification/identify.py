"""System identification: from recordings of flights to a plant with its uncertainty and verdict.

The plant is fitted by its output error (Ljung, System Identification, 1999, ch. 7 and 10): it is simulated from the
setpoints only. Two weightings are compared. Whitened errors are efficient if the plant has the assumed order and the
rest is noise. Equal weights give the plant that simulates best even otherwise, but fit the estimator's slow drift as
motion; they are used if their validation fit is markedly better. A difference beyond the uncertainty (Hausman 1978) is
reported: slow and fast motions then fit different parameters.

Autopilots have the same gains along both axes. Unless the axes differ by more than their uncertainty allows (Wald's
test), they are fitted as one: that halves the scatter of a0 and a1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.stats import chi2

from estimation.identification.excerpts import GRID_S, Excerpt, MotionRecording, excerpts_of
from estimation.identification.filter_noise import filter_noise_of
from estimation.identification.grading import WIDE_GOOD, graded, refused
from estimation.identification.identified import (
    AxisResult,
    IdentificationResult,
    Interval,
    OrderComparison,
    ParameterEstimate,
    Validation,
)
from estimation.identification.output_error import Fit, Model, delay_spread_s, fit, parameters_of, start_of, whiteness
from estimation.identification.response import InputHold
from estimation.identification.shaping import UNSHAPED, Shaping, shaping_of
from estimation.identification.simulated import PREDICTION_HORIZON_S, fit_percent, simulated
from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis

_DELAYS = range(7)


def baseline_of(excerpts: Sequence[Excerpt], share: float) -> Plant | None:
    """Return the plant by ordinary least squares over the first share of each excerpt; None if it is unstable."""
    best, least, fed = None, np.inf, any(excerpt.fed for excerpt in excerpts)
    for delay in _DELAYS:
        axes = [_free_response(excerpts, share, delay, axis, fed=fed) for axis in range(2)]
        cost = sum(cost for cost, _ in axes)
        if cost < least:
            least, best = cost, (delay, [plant for _, plant in axes])
    if best is None or any(plant is None for plant in best[1]):
        return None
    (x0, x1, x_gain), (y0, y1, y_gain) = (plant for plant in best[1] if plant is not None)
    gain = min(max((x_gain + y_gain) / 2.0, 0.0), FEEDFORWARD_MAX)
    return Plant(PlantAxis(x0, x1), PlantAxis(y0, y1), best[0] * GRID_S, gain)


def _free_response(
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


TRAINED_SHARE = 0.7
_HAUSMAN_SURE = 0.999
_AXES_DIFFER_SURE = 0.95
_PLAIN_ERRORS_MAX = 0.85
"""The fit with equal weights is used if it leaves less than this share of the whitened fit's validation error."""
_MISFIT_PERCENT = 80.0
_STAGES = 9


@dataclass(slots=True)
class _Counter:
    """Reports the share of the work that is done."""

    on_progress: Callable[[float], None]
    done: int = 0

    def step(self) -> None:
        self.done += 1
        self.on_progress(min(1.0, self.done / _STAGES))


def identify(
    recordings: Sequence[MotionRecording],
    on_progress: Callable[[float], None] = lambda _: None,
    others: Mapping[str, Plant] = MappingProxyType({}),
) -> IdentificationResult:
    """Identify one vehicle from recordings of its flights; unsuitable recordings give a verdict, not an error.

    Other plants, by name, are compared on the same part of the flights as the identified one.
    """
    excerpts = [excerpt for recording in recordings for excerpt in excerpts_of(recording)]
    if (refusal := refused(recordings, excerpts)) is not None:
        return refusal
    counter = _Counter(on_progress)
    white = _likeliest(recordings, excerpts, counter)
    chosen = _weighted(excerpts, white, counter)
    baseline = baseline_of(excerpts, TRAINED_SHARE)
    order = _order(excerpts, chosen)
    counter.step()
    shaping = shaping_of(excerpts, chosen.best) if _is_misfit(excerpts, chosen) else UNSHAPED
    counter.step()
    return _result(_Parts(excerpts, chosen, baseline, order, shaping, others))


@dataclass(frozen=True, slots=True)
class _Chosen:
    """The fit to all data, and the fit to the first part.

    `whitened` is whether errors were whitened, `consistent` whether this makes no difference beyond the uncertainty.
    """

    best: Fit
    trained: Fit
    whitened: bool
    consistent: bool


@dataclass(frozen=True, slots=True)
class _Parts:
    excerpts: Sequence[Excerpt]
    chosen: _Chosen
    baseline: Plant | None
    order: OrderComparison
    shaping: Shaping
    others: Mapping[str, Plant]


def _likeliest(recordings: Sequence[MotionRecording], excerpts: Sequence[Excerpt], counter: _Counter) -> Fit:
    """Return the whitened fit, with the given assumption about the input between setpoints or the most likely one."""
    sampled = any(recording.sampled for recording in recordings)
    candidates = (InputHold.MIXED, InputHold.LINEAR, InputHold.MIDWAY) if sampled else (InputHold.HELD,)
    fed = any(excerpt.fed for excerpt in excerpts)
    start = start_of(excerpts, Model(candidates[0], feedforward=fed))
    counter.step()
    fits = []
    for between in candidates:
        fits.append(fit(excerpts, Model(between, feedforward=fed), start))
        start = fits[0].parameters
        counter.step()
    return min(fits, key=lambda each: each.score)


def _weighted(excerpts: Sequence[Excerpt], white: Fit, counter: _Counter) -> _Chosen:
    plain = fit(excerpts, white.model, white.parameters, whiten=False)
    plain_trained = fit(excerpts, white.model, plain.parameters, TRAINED_SHARE, whiten=False)
    counter.step()
    white_trained = fit(excerpts, white.model, white.parameters, TRAINED_SHARE)
    counter.step()
    apart = white.parameters - plain.parameters
    statistic = float(apart @ np.linalg.pinv(plain.covariance, hermitian=True) @ apart)
    left_plain, left_white = (
        100.0 - np.mean(_prediction_fits(excerpts, each)) for each in (plain_trained, white_trained)
    )
    whitened = bool(left_plain > _PLAIN_ERRORS_MAX * left_white)
    best, trained = (white, white_trained) if whitened else (plain, plain_trained)
    if _axes_agree(best):
        model = replace(best.model, alike=True)
        best = fit(excerpts, model, best.parameters, 1.0, whitened)
        trained = fit(excerpts, model, trained.parameters, TRAINED_SHARE, whitened)
    best, trained = _causal(excerpts, best, 1.0, whitened), _causal(excerpts, trained, TRAINED_SHARE, whitened)
    counter.step()
    consistent = bool(statistic <= chi2.ppf(_HAUSMAN_SURE, apart.size))
    return _Chosen(best, trained, whitened, consistent)


def _axes_agree(apiece: Fit) -> bool:
    """Return whether a0 and a1 of the two axes, fitted separately, differ by no more than their uncertainty."""
    difference = np.zeros((2, apiece.parameters.size))
    difference[:, :4] = (1.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, -1.0)
    apart = difference @ apiece.parameters
    spread = np.linalg.pinv(difference @ apiece.covariance @ difference.T, hermitian=True)
    return bool(apart @ spread @ apart <= chi2.ppf(_AXES_DIFFER_SURE, apart.size))


def _causal(excerpts: Sequence[Excerpt], best: Fit, share: float, whitened: bool) -> Fit:
    """Return a fit with a delay of at least 0, because plants are causal."""
    if best.parameters[4] >= 0.0:
        return best
    at_zero = fit(excerpts, replace(best.model, delayed=False), best.parameters, share, whitened)
    return replace(at_zero, covariance=best.covariance, unbounded_delay_s=float(best.parameters[4]))


def _order(excerpts: Sequence[Excerpt], chosen: _Chosen) -> OrderComparison:
    """Return the comparison with a third order, an actuator lag."""
    second = chosen.trained
    start = np.append(second.parameters, np.log(0.1))
    third = fit(excerpts, replace(second.model, lag=True, delayed=True), start, TRAINED_SHARE, chosen.whitened)
    second_percent, third_percent = (float(np.mean(_prediction_fits(excerpts, each))) for each in (second, third))
    return OrderComparison(
        lag_s=float(np.exp(third.parameters[-1])),
        fit_second_percent=second_percent,
        fit_third_percent=third_percent,
        error_ratio=float(np.exp((third.score - second.score) / 2.0 / max(third.count, 1))),
    )


def _is_misfit(excerpts: Sequence[Excerpt], chosen: _Chosen) -> bool:
    """Return whether the plant explains so little, or is so uncertain, that the autopilot may have limited it."""
    if not (chosen.whitened and chosen.consistent) or chosen.best.deviations95[:4].max() > WIDE_GOOD:
        return True
    return min(_prediction_fits(excerpts, chosen.trained)) < _MISFIT_PERCENT


def _prediction_fits(excerpts: Sequence[Excerpt], trained: Fit) -> tuple[float, float]:
    """Return the validation fits along x and y."""
    x, y = (fit_percent(simulated(excerpts, trained, axis, TRAINED_SHARE, PREDICTION_HORIZON_S)) for axis in range(2))
    return x, y


def _result(parts: _Parts) -> IdentificationResult:
    best, trained = parts.chosen.best, parts.chosen.trained
    half = best.deviations95
    logs = best.parameters[:4]
    a0_x, a1_x, a0_y, a1_y = (_positive(value, spread) for value, spread in zip(logs, half[:4], strict=True))
    delay_s, unbounded_s = float(best.parameters[4]), best.unbounded_delay()
    delay = Interval(delay_s, max(0.0, unbounded_s - float(half[4])), max(delay_s, unbounded_s + float(half[4])))
    fits = _prediction_fits(parts.excerpts, trained)
    axes = [_axis(parts, axis, a0, a1, fits[axis]) for axis, (a0, a1) in enumerate(((a0_x, a1_x), (a0_y, a1_y)))]
    baseline_fit = None
    if parts.baseline is not None:
        baseline_fit = _of_another(parts, parts.baseline)
    others_fit = {name: _of_another(parts, plant) for name, plant in parts.others.items()}
    scale = np.append(np.exp(logs), np.ones(best.parameters.size - 4))
    found = ParameterEstimate(
        axes=(axes[0], axes[1]),
        delay_s=delay,
        covariance=best.covariance * np.outer(scale, scale),
        between=best.model.between,
        whitened=parts.chosen.whitened,
        consistent=parts.chosen.consistent,
        axes_alike=best.model.alike,
        order=parts.order,
        shaping=parts.shaping,
        baseline=parts.baseline,
        baseline_fit_percent=baseline_fit,
        others_fit_percent=others_fit,
        validation=Validation(tuple(parts.excerpts), best, trained),
        delay_spread_s=delay_spread_s(parts.excerpts, best),
        feedforward=_gain(best) if best.model.feedforward else None,
    )
    damping_doubt_per_s = max((each.a1_per_s.high - each.a1_per_s.low) / 2.0 for each in found.axes)
    found = replace(found, noise=filter_noise_of(parts.excerpts, best, found.plant, damping_doubt_per_s))
    verdict, reasons = graded(found, unbounded_s, float(half[4]) / 2.0)
    duration_s = sum(excerpt.duration_s for excerpt in parts.excerpts)
    return IdentificationResult(verdict, reasons, duration_s, len(parts.excerpts), found)


def _axis(parts: _Parts, axis: int, a0: Interval, a1: Interval, percent: float) -> AxisResult:
    best = parts.chosen.best
    own = best.covariance[2 * axis : 2 * axis + 2, 2 * axis : 2 * axis + 2]
    damping_spread = best.quantile95 * float(np.sqrt(max(own[1, 1] + own[0, 0] / 4.0 - own[0, 1], 0.0)))
    frequency = _positive(np.log(a0.value) / 2.0, best.deviations95[2 * axis] / 2.0)
    damping = _positive(np.log(a1.value) - np.log(4.0 * a0.value) / 2.0, damping_spread)
    apart = simulated(parts.excerpts, best, axis, 1.0)
    rms_m = float(np.sqrt(np.mean(np.concatenate([each.error_m for each in apart]) ** 2)))
    return AxisResult(a0, a1, frequency, damping, percent, rms_m, whiteness(best.errors[axis])[0])


def _of_another(parts: _Parts, plant: Plant) -> tuple[float, float]:
    """Return the validation fit of another plant."""
    trained = parts.chosen.trained
    return _prediction_fits(parts.excerpts, replace(trained, parameters=parameters_of(plant, trained.model)))


def _gain(best: Fit) -> Interval:
    value, half = float(best.parameters[5]), float(best.deviations95[5])
    return Interval(value, value - half, value + half)


def _positive(log_value: float, log_spread: float) -> Interval:
    value, factor = float(np.exp(log_value)), float(np.exp(min(log_spread, 20.0)))
    return Interval(value, value / factor, value * factor)
