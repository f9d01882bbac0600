"""The types of the estimators: measurements, estimates, and the layout of state vectors.

Everything is in the mission frame (x, y right-handed with z up), SI units and radians.
"""

from collections.abc import Callable, Sequence
from math import isfinite, sqrt
from typing import ClassVar, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

POSITION = slice(0, 2)
VELOCITY = slice(2, 4)
MOTION = slice(0, 4)
DISTURBANCE = slice(4, 6)

STEP_DIGITS = 3
"""Estimates are predicted by whole milliseconds: telemetry arrives at any time, but there are few different steps,
whose matrices are computed once. The error at 3 m/s is 1.5 mm at most, and measurements prevent its accumulation.
"""


class Telemetry(msgspec.Struct, frozen=True):
    """One sample of a vehicle's own motion, as its autopilot reports it.

    Raises ValueError when a number is not finite: NaN is refused here.
    """

    topic: ClassVar = "telemetry"
    lasts: ClassVar = False
    time_s: float
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]

    def __post_init__(self) -> None:
        _require_finite("telemetry", self.time_s, *self.position_m, *self.velocity_m_s)

    def describe(self, time: Callable[[float], str]) -> str:
        """Return it as text; `time` formats a time on the vehicle's clock."""
        motion = f"position {place_text(self.position_m, 3)} m, velocity {place_text(self.velocity_m_s, 3)} m/s"
        return f"telemetry at {time(self.time_s)}: {motion}"


class Sighting(msgspec.Struct, frozen=True):
    """One sensor's observation of a target, with its importance and threat in [0, 1]. `target`: its name, if known.

    `covariance_m2` holds (xx, xy, yy); `altitude_m` is above the mission's origin, None if not measured. A sensor on
    board adds its vehicle's position error, a first-order Gauss-Markov process: `frame_sigma_m` per axis (0: none),
    `frame_correlation_s`. Raises ValueError when a number is not finite, the covariance is not positive definite, the
    altitude's standard deviation is not positive, importance or threat leave [0, 1], the frame's error has no positive
    correlation time, or the target's name is empty.
    """

    topic: ClassVar = "sighting"
    lasts: ClassVar = False
    time_s: float
    sensor_id: int
    position_m: tuple[float, float]
    covariance_m2: tuple[float, float, float]
    importance: float
    threat: float
    altitude_m: float | None = None
    altitude_sigma_m: float = 1.0
    frame_sigma_m: float = 0.0
    frame_correlation_s: float = 0.0
    target: str | None = None

    def __post_init__(self) -> None:
        xx, xy, yy = self.covariance_m2
        _require_finite("sighting", self.time_s, *self.position_m, xx, xy, yy, self.importance, self.threat)
        if not (xx > 0.0 and xx * yy - xy * xy > 0.0):  # `xy**2` raises on overflow
            raise ValueError(f"sighting covariance {self.covariance_m2} is not positive definite")
        if not (0.0 <= self.importance <= 1.0 and 0.0 <= self.threat <= 1.0):
            raise ValueError(f"importance {self.importance} and threat {self.threat} must lie in [0, 1]")
        if self.altitude_m is not None:
            _require_finite("sighting", self.altitude_m, self.altitude_sigma_m)
            if self.altitude_sigma_m <= 0.0:
                raise ValueError(f"altitude_sigma_m {self.altitude_sigma_m} of a sighting must be positive")
        if self.frame_sigma_m != 0.0:
            _require_finite("sighting", self.frame_sigma_m, self.frame_correlation_s)
            if self.frame_sigma_m < 0.0 or self.frame_correlation_s <= 0.0:
                raise ValueError(f"frame error {self.frame_sigma_m} m, {self.frame_correlation_s} s of a sighting")

        if self.target == "":
            raise ValueError("the name of a sighting's target is empty")

    def describe(self, time: Callable[[float], str]) -> str:
        """Return it as text; `time` formats a time on the vehicle's clock."""
        return f"own sighting at {time(self.time_s)}: {target_text(self)}"


AxisSpread = tuple[float, float, float, float, float, float]
"""The upper triangle (pp, pv, pw, vv, vw, ww) of the covariance of position, velocity and disturbance along an axis."""
PlanarSpread = tuple[float, float, float, float, float, float, float, float, float, float]
"""The upper triangle (xx, xy, xu, xv, yy, yu, yv, uu, uv, vv) of the covariance of [x y x' y'] = [x y u v]."""


class OwnEstimate(msgspec.Struct, frozen=True):
    """The estimate of a vehicle's own motion: mean (6,) = [x y x' y' w_x w_y] at `time_s`, with covariances by axis.

    Position [m] and velocity [m/s] are in the mission frame, right-handed with z up; the disturbance w is an
    acceleration [m/s²] that adds to the plant's. `spread` has, for x and for y, the upper triangle of the covariance of
    position, velocity and disturbance: (pp, pv, pw, vv, vw, ww). Most ticks need one of its elements only; the matrix
    is computed on access.
    """

    time_s: float
    mean: Vector
    spread: tuple[AxisSpread, AxisSpread]

    @property
    def covariance(self) -> Vector:
        """The covariance (6, 6) of the mean; the axes are uncorrelated."""
        covariance = np.zeros((6, 6))
        for axis, (pp, pv, pw, vv, vw, ww) in enumerate(self.spread):
            covariance[axis::2, axis::2] = (pp, pv, pw), (pv, vv, vw), (pw, vw, ww)
        return covariance

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the position, in the worse direction of the axes."""
        return sqrt(max(self.spread[0][0], self.spread[1][0]))


class TargetEstimate(msgspec.Struct, frozen=True):
    """The estimate of the target's motion: mean (4,) = [x y x' y'] at `time_s`, and its covariance.

    Position [m] and velocity [m/s] are in the mission frame, right-handed with z up. `spread` is the upper triangle of
    the covariance, row by row. `sighted_s` is the time of the newest sighting used; importance and threat, in [0, 1],
    are from that sighting.
    """

    time_s: float
    mean: Vector
    spread: PlanarSpread
    sighted_s: float
    importance: float
    threat: float

    @property
    def covariance(self) -> Vector:
        """The covariance (4, 4)."""
        xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = self.spread
        return np.array([(xx, xy, xu, xv), (xy, yy, yu, yv), (xu, yu, uu, uv), (xv, yv, uv, vv)])

    @property
    def position_variance_m2(self) -> tuple[float, float]:
        """The variances of the position along x and y."""
        return self.spread[0], self.spread[4]

    @property
    def position_sigma_m(self) -> float:
        """The standard deviation of the position, in the worse direction of the axes."""
        return sqrt(max(self.position_variance_m2))


class SightedTarget(Protocol):
    """What a sighting and its message to peers have in common."""

    @property
    def position_m(self) -> tuple[float, float]:
        """The target's position."""

    @property
    def covariance_m2(self) -> tuple[float, float, float]:
        """Its covariance (xx, xy, yy)."""

    @property
    def importance(self) -> float:
        """The target's importance in [0, 1]."""

    @property
    def threat(self) -> float:
        """The target's threat in [0, 1]."""

    @property
    def altitude_m(self) -> float | None:
        """The target's altitude, None if not measured."""

    @property
    def altitude_sigma_m(self) -> float:
        """The standard deviation of the altitude."""


def target_text(sighted: SightedTarget) -> str:
    """Return a sighted target as text."""
    xx, _, yy = sighted.covariance_m2
    sigma_m = max(xx, yy, 0.0) ** 0.5
    worth = f"importance {sighted.importance:.3f}, threat {sighted.threat:.3f}"
    known = sighted.altitude_m is not None
    height = f"altitude {sighted.altitude_m:.3f} m (σ {sighted.altitude_sigma_m:.2f} m), " if known else ""
    return f"target at {place_text(sighted.position_m, 3)} m (σ {sigma_m:.2f} m), {height}{worth}"


def place_text(values: Sequence[float], digits: int = 2) -> str:
    """Return coordinates as text, (x, y)."""
    return f"({', '.join(f'{round(value, digits) + 0.0:.{digits}f}' for value in values)})"


def _require_finite(what: str, *values: float) -> None:
    if not isfinite(sum(values)) and not all(map(isfinite, values)):  # the sum is fast, but may overflow
        raise ValueError(f"{what} holds a number that is not finite: {values}")
