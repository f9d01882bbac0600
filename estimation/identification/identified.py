"""What an identification has found: values with intervals, and whether to fly by them."""

from collections.abc import Mapping
from dataclasses import dataclass

from estimation.identification.excerpts import Excerpt
from estimation.identification.filter_noise import FilterNoise
from estimation.identification.output_error import Fit
from estimation.identification.response import Between
from estimation.identification.shaping import Shaping
from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis
from estimation.plant.provenance import PlantGrade
from estimation.state import Vector

METHOD = "output error 2"
"""What identifies, and its version."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A value, and the bounds that hold the truth in 95 of 100 identifications."""

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

    `fit_percent` is the fit on what was not fitted, `error_rms_m` the error of the simulation over all; `white_share`
    says how much of the whitened errors' correlation is within the bounds of white noise.
    """

    a0_per_s2: Interval
    a1_per_s: Interval
    frequency_rad_s: Interval
    damping: Interval
    fit_percent: float
    error_rms_m: float
    white_share: float


@dataclass(frozen=True, slots=True)
class Order:
    """What a third order, a lag of the actuators, would give: its fits on what was not fitted, and its errors' ratio.

    `error_ratio` is how large the third order's errors on what was fitted are against those of the second.
    """

    lag_s: float
    fit_second_percent: float
    fit_third_percent: float
    error_ratio: float

    @property
    def second_is_enough(self) -> bool:
        """Whether a third order would explain no more that matters."""
        return self.error_ratio > 0.9 or self.fit_third_percent < self.fit_second_percent + 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Validation:
    """What the figures of an identification are drawn from."""

    excerpts: tuple[Excerpt, ...]
    best: Fit
    trained: Fit


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The numbers of a plant, x and y, with their covariance (k, k) in the order of `covariance_of`.

    `feedforward` is the gain of the velocities beside the setpoints; None where none were sent that tell of it.
    `whitened` says whether errors were whitened; they are not where that foretells markedly worse. `consistent` says
    whether it makes no difference beyond the uncertainty, `axes_alike` whether both axes were fitted as one. `baseline`
    is the plant by plain least squares, None where that is unstable; fits of other plants go by their names.
    `delay_spread_s` is how far the delay differs from time to time (rms). `noise` is what the own-state filter needs to
    know, None where the flights tell no velocities.
    """

    axes: tuple[AxisResult, AxisResult]
    delay_s: Interval
    covariance: Vector
    between: Between
    whitened: bool
    consistent: bool
    axes_alike: bool
    order: Order
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
class Identified:
    """The verdict with its reasons, how much was used, and what was found if anything could be."""

    verdict: PlantGrade
    reasons: tuple[str, ...]
    duration_s: float
    excerpts: int
    found: Found | None = None
