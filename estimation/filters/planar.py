"""Kalman prediction and update of the target filter for motion in the plane, [x y x' y'], written out by element.

Not filterpy: every vehicle processes the sightings of the whole team, and after a late sighting the later ones again. A
prediction and update of `filterpy.kalman.KalmanFilter` 2.0 (numpy 2.4, Python 3.11) takes 15 us with 4 states and 2
measurements, this code 1.8 us. The tests compare these equations with filterpy's.
"""

from math import sqrt
from typing import Final, NamedTuple

from estimation.state import PlanarSpread

LEAST_M2: Final = 1e-9
"""Lower bound of an innovation's variance: rounding must not make it negative."""


class PlanarCovariance:
    """The upper triangle of the symmetric covariance (4, 4) of [x y x' y'], row by row."""

    def __init__(self, upper: PlanarSpread) -> None:
        self.upper: Final = upper


class Motion:
    """The estimated position and velocity [m, m/s] at one time, and their covariance."""

    def __init__(self, time_s: float, x: float, y: float, u: float, v: float, spread: PlanarCovariance) -> None:
        self.time_s: Final = time_s
        self.x: Final = x
        self.y: Final = y
        self.u: Final = u
        self.v: Final = v
        self.spread: Final = spread


class PredictionStep(NamedTuple):
    """One prediction step, the same for both axes.

    `velocity_s` is the gain from velocity to position [s], `velocity_share` the share of the velocity that remains. The
    noise is the variance of the position, its covariance with the velocity, and the variance of the velocity.
    """

    velocity_s: float
    velocity_share: float
    noise_position: float
    noise_cross: float
    noise_velocity: float


class Innovation:
    """A measured position less the predicted one, whitened by the covariance of that difference."""

    def __init__(self, x: float, y: float) -> None:
        self.x: Final = x
        self.y: Final = y

    @property
    def squared(self) -> float:
        """The squared Mahalanobis distance; NaN if the measurement is NaN."""
        return self.x * self.x + self.y * self.y  # `**` raises OverflowError for a far outlier


def predicted(motion: Motion, to_s: float, step: PredictionStep) -> Motion:
    """Return the estimate after a step: `P' = F P F' + Q`."""
    x, y, u, v = motion.x, motion.y, motion.u, motion.v
    xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = motion.spread.upper
    t, k, noise_position, noise_cross, noise_velocity = step
    return Motion(
        to_s,
        x + t * u,
        y + t * v,
        k * u,
        k * v,
        PlanarCovariance(
            (
                xx + t * (2.0 * xu + t * uu) + noise_position,
                xy + t * (xv + yu + t * uv),
                k * (xu + t * uu) + noise_cross,
                k * (xv + t * uv),
                yy + t * (2.0 * yv + t * vv) + noise_position,
                k * (yu + t * uv),
                k * (yv + t * vv) + noise_cross,
                k * k * uu + noise_velocity,
                k * k * uv,
                k * k * vv + noise_velocity,
            )
        ),
    )


def faster(motion: Motion, variance_m2_s2: float) -> Motion:
    """Return the estimate with a variance added to both velocities, which may have changed."""
    xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = motion.spread.upper
    spread = PlanarCovariance((xx, xy, xu, xv, yy, yu, yv, uu + variance_m2_s2, uv, vv + variance_m2_s2))
    return Motion(motion.time_s, motion.x, motion.y, motion.u, motion.v, spread)


def updated(
    motion: Motion, position_m: tuple[float, float], noise_m2: tuple[float, float, float]
) -> tuple[Motion, Innovation]:
    """Return the estimate after a measured position with covariance (xx, xy, yy), and the innovation.

    The innovation covariance is factored as S = L L' and everything is divided by L: no inverse is needed, and the
    covariance stays symmetric.
    """
    x, y, u, v = motion.x, motion.y, motion.u, motion.v
    xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = motion.spread.upper
    noise_xx, noise_xy, noise_yy = noise_m2
    first = sqrt(xx + noise_xx)
    across = (xy + noise_xy) / first
    second = sqrt(max(yy + noise_yy - across * across, LEAST_M2))
    gx, gy, gu, gv = xx / first, xy / first, xu / first, xv / first
    hx, hy, hu, hv = (
        (xy - across * gx) / second,
        (yy - across * gy) / second,
        (yu - across * gu) / second,
        (yv - across * gv) / second,
    )
    e = (position_m[0] - x) / first
    f = (position_m[1] - y - across * e) / second
    left = (
        xx - gx * gx - hx * hx,
        xy - gx * gy - hx * hy,
        xu - gx * gu - hx * hu,
        xv - gx * gv - hx * hv,
        yy - gy * gy - hy * hy,
        yu - gy * gu - hy * hu,
        yv - gy * gv - hy * hv,
        uu - gu * gu - hu * hu,
        uv - gu * gv - hu * hv,
        vv - gv * gv - hv * hv,
    )
    x, y, u, v = x + gx * e + hx * f, y + gy * e + hy * f, u + gu * e + hu * f, v + gv * e + hv * f
    return Motion(motion.time_s, x, y, u, v, PlanarCovariance(left)), Innovation(e, f)
