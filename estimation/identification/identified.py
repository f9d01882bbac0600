"""The result of an identification: values with intervals, and the verdict."""

from collections.abc import Mapping
from dataclasses import dataclass

from estimation.identification.excerpts import Excerpt
from estimation.identification.filter_noise import FilterNoise
from estimation.identification.output_error import Fit
from estimation.identification.response import InputHold
from estimation.identification.shaping import Shaping
from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis, PlantGrade
from estimation.state import Vector

METHOD = "output error 2"
"""The method and its version."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def relative(self) -> float:
        """Half its width, as a share of the value."""
        return (self.high - self.low) / 2.0 / self.value


@dataclass(frozen=True, slots=True)
class AxisResult:
    """One axis: a0 [1/s2], a1 [1/s], natural frequency [rad/s] and damping.

    `fit_percent` is the validation fit, `error_rms_m` the error of the simulation over all data; `white_share` is the
    share of the whitened errors' autocorrelation within the bounds of white noise.
    """

    a0_per_s2: Interval
    a1_per_s: Interval
    frequency_rad_s: Interval
    damping: Interval
    fit_percent: float
    error_rms_m: float
    white_share: float


@dataclass(frozen=True, slots=True)
class OrderComparison:
    """Comparison with a third order, an actuator lag: the validation fits, and the ratio of errors.

    `error_ratio` is the ratio of the errors on the fitted data, third order to second order.
    """

    lag_s: float
    fit_second_percent: float
    fit_third_percent: float
    error_ratio: float

    @property
    def second_is_enough(self) -> bool:
        """Whether a third order gives no relevant improvement."""
        return self.error_ratio > 0.9 or self.fit_third_percent < self.fit_second_percent + 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Validation:
    """The data of an identification's figures."""

    excerpts: tuple[Excerpt, ...]
    best: Fit
    trained: Fit


@dataclass(frozen=True, slots=True, eq=False)
class ParameterEstimate:
    """The parameters of a plant, x and y, with their covariance (k, k) in the order of `covariance_of`.

    `feedforward` is the feed-forward gain, None if no varying velocities were sent. `whitened` is whether errors were
    whitened, which is not done if it predicts markedly worse. `consistent` is whether whitening makes no difference
    beyond the uncertainty, `axes_alike` whether both axes were fitted as one. `baseline` is the plant by ordinary least
    squares, None if that is unstable; fits of other plants are listed by name. `delay_spread_s` is the variation of the
    delay over the flights (rms). `noise` holds the settings of the own filter, None if the flights have no reported
    velocities.
    """

    axes: tuple[AxisResult, AxisResult]
    delay_s: Interval
    covariance: Vector
    between: InputHold
    whitened: bool
    consistent: bool
    axes_alike: bool
    order: OrderComparison
    shaping: Shaping
    baseline: Plant | None
    baseline_fit_percent: tuple[float, float] | None
    others_fit_percent: Mapping[str, tuple[float, float]]
    validation: Validation
    delay_spread_s: float
    feedforward: Interval | None = None
    noise: FilterNoise | None = None

    @property
    def plant(self) -> Plant:
        """The plant."""
        x, y = (PlantAxis(axis.a0_per_s2.value, axis.a1_per_s.value) for axis in self.axes)
        gain = 0.0 if self.feedforward is None else min(max(self.feedforward.value, 0.0), FEEDFORWARD_MAX)
        return Plant(x, y, self.delay_s.value, gain)


@dataclass(frozen=True, slots=True)
class IdentificationResult:
    """The verdict with its reasons, the amount of data used, and the result if there is one."""

    verdict: PlantGrade
    reasons: tuple[str, ...]
    duration_s: float
    excerpts: int
    found: ParameterEstimate | None = None
