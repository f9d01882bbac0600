"""A Gaussian over motion in the plane, [x y x' y'], in plain numbers: the Kalman steps of the target's filter.

Vehicles take in every sighting of everybody: on arrays this small numpy spends its time around the arithmetic. Here the
same equations stand element by element, and tests hold them against filterpy's.
"""

from math import sqrt
from typing import NamedTuple

import msgspec
import numpy as np

from estimation.state import Vector

_LEAST_M2 = 1e-9
"""No innovation is surer than this: rounding must not make a variance negative."""


class Spread(msgspec.Struct, frozen=True):
    """A symmetric covariance (4, 4) of [x y x' y'], by its upper triangle."""

    xx: float
    xy: float
    xu: float
    xv: float
    yy: float
    yu: float
    yv: float
    uu: float
    uv: float
    vv: float


class Motion(msgspec.Struct, frozen=True):
    """What is believed of a motion at one time: position and velocity [m, m/s], and their covariance."""

    time_s: float
    x: float
    y: float
    u: float
    v: float
    spread: Spread

    @property
    def mean(self) -> Vector:
        """The mean (4,)."""
        return np.array((self.x, self.y, self.u, self.v))

    @property
    def covariance(self) -> Vector:
        """The covariance (4, 4)."""
        xx, xy, xu, xv, yy, yu, yv, uu, uv, vv = msgspec.structs.astuple(self.spread)
        return np.array([(xx, xy, xu, xv), (xy, yy, yu, yv), (xu, yu, uu, uv), (xv, yv, uv, vv)])


class Drift(NamedTuple):
    """A step of one axis: for how long the velocity carries on [s], the share of it that is left, and process noise.

    The noise is that of the position, of position with velocity, and of the velocity; it has no direction.
    """

    carries_s: float
    kept: float
    place: float
    mixed: float
    velocity: float


class Innovation(msgspec.Struct, frozen=True):
    """How far a measured position is off the belief, whitened by the covariance of that."""

    x: float
    y: float

    @property
    def squared(self) -> float:
        """The squared Mahalanobis distance; NaN if the measurement was."""
        return self.x * self.x + self.y * self.y  # a power of what is far out would overflow


def carried(motion: Motion, to_s: float, drift: Drift) -> Motion:
    """Return the belief after a step: `P' = F P F' + Q`."""
    x, y, u, v, spread = motion.x, motion.y, motion.u, motion.v, motion.spread
    xx, xy, xu, xv, yy = spread.xx, spread.xy, spread.xu, spread.xv, spread.yy
    yu, yv, uu, uv, vv = spread.yu, spread.yv, spread.uu, spread.uv, spread.vv
    t, k, place, mixed, velocity = drift
    return Motion(
        to_s,
        x + t * u,
        y + t * v,
        k * u,
        k * v,
        Spread(
            xx + t * (2.0 * xu + t * uu) + place,
            xy + t * (xv + yu + t * uv),
            k * (xu + t * uu) + mixed,
            k * (xv + t * uv),
            yy + t * (2.0 * yv + t * vv) + place,
            k * (yu + t * uv),
            k * (yv + t * vv) + mixed,
            k * k * uu + velocity,
            k * k * uv,
            k * k * vv + velocity,
        ),
    )


def corrected(
    motion: Motion, position_m: tuple[float, float], noise_m2: tuple[float, float, float]
) -> tuple[Motion, Innovation]:
    """Return the belief after a measured position with covariance (xx, xy, yy), and the innovation.

    With the innovation's covariance S = L L' and everything divided by L: the gain needs no inverse, and what the
    covariance loses is symmetric.
    """
    x, y, u, v, spread = motion.x, motion.y, motion.u, motion.v, motion.spread
    xx, xy, xu, xv, yy = spread.xx, spread.xy, spread.xu, spread.xv, spread.yy
    yu, yv, uu, uv, vv = spread.yu, spread.yv, spread.uu, spread.uv, spread.vv
    noise_xx, noise_xy, noise_yy = noise_m2
    first = sqrt(xx + noise_xx)
    across = (xy + noise_xy) / first
    second = sqrt(max(yy + noise_yy - across * across, _LEAST_M2))
    gx, gy, gu, gv = xx / first, xy / first, xu / first, xv / first
    hx, hy, hu, hv = (
        (xy - across * gx) / second,
        (yy - across * gy) / second,
        (yu - across * gu) / second,
        (yv - across * gv) / second,
    )
    e = (position_m[0] - x) / first
    f = (position_m[1] - y - across * e) / second
    left = Spread(
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
    after = Motion(
        motion.time_s, x + gx * e + hx * f, y + gy * e + hy * f, u + gu * e + hu * f, v + gv * e + hv * f, left
    )
    return after, Innovation(e, f)
