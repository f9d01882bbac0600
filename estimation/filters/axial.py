"""A Gaussian over one axis of a vehicle in plain numbers: the Kalman steps of the own filter.

State [p v c s q]: position, velocity, a steady disturbance, a swinging one and the other half of its oscillator. Plant,
noise and telemetry know no coupling of x and y, so that a vehicle's filter is one such Gaussian along each of them. On
arrays this small numpy spends its time around the arithmetic; tests hold these equations against filterpy's.
"""

from math import sqrt
from typing import NamedTuple

import msgspec

Turn = tuple[float, float]
"""Cosine and sine of the angle by which the oscillator turns in a step."""


class Spread(msgspec.Struct, frozen=True):
    """A symmetric covariance (5, 5) of [p v c s q], by its upper triangle."""

    pp: float
    pv: float
    pc: float
    ps: float
    pq: float
    vv: float
    vc: float
    vs: float
    vq: float
    cc: float
    cs: float
    cq: float
    ss: float
    sq: float
    qq: float


class Along(msgspec.Struct, frozen=True):
    """What is believed along one axis [m, m/s, m/s²], and its covariance."""

    p: float
    v: float
    c: float
    s: float
    q: float
    spread: Spread


class Step(NamedTuple):
    """A step of one axis: the plant's transition, what disturbance and aim add.

    `ramp` is what a slope of the aim about its mean adds. The noise is that of the position, of position with velocity,
    of the velocity, and the walks of the steady disturbance and of both halves of the oscillator.
    """

    pp: float
    pv: float
    vp: float
    vv: float
    disturbed_p: float
    disturbed_v: float
    aimed_p: float
    aimed_v: float
    ramp_p: float
    ramp_v: float
    noise_pp: float
    noise_pv: float
    noise_vv: float
    walk_c: float
    walk_s: float


def moved(along: Along, step: Step, turn: Turn, aim_m: float) -> tuple[float, float, float, float, float]:
    """Return the mean after a step under an aim: `m' = F m + B u`."""
    p, v, c, s, q = along.p, along.v, along.c, along.s, along.q
    w, (cosine, sine) = c + s, turn
    return (
        step.pp * p + step.pv * v + step.disturbed_p * w + step.aimed_p * aim_m,
        step.vp * p + step.vv * v + step.disturbed_v * w + step.aimed_v * aim_m,
        c,
        cosine * s - sine * q,
        sine * s + cosine * q,
    )


def carried(along: Along, step: Step, turn: Turn, aim_m: float) -> Along:
    """Return the belief after a step under an aim: `P' = F P F' + Q`."""
    spread = along.spread
    pp, pv, pc, ps, pq = spread.pp, spread.pv, spread.pc, spread.ps, spread.pq
    vv, vc, vs, vq, cc = spread.vv, spread.vc, spread.vs, spread.vq, spread.cc
    cs, cq, ss, sq, qq = spread.cs, spread.cq, spread.ss, spread.sq, spread.qq
    a, b, d, e, g, h, _, _, _, _, noise_pp, noise_pv, noise_vv, walk_c, walk_s = step
    cosine, sine = turn
    # F P, as far as it is needed: the rows of position and velocity, the one of the swing in the end.
    pw, vw = pc + ps, vc + vs
    p_p, p_v = a * pp + b * pv + g * pw, a * pv + b * vv + g * vw
    v_p, v_v = d * pp + e * pv + h * pw, d * pv + e * vv + h * vw
    cw, sw, qw = cc + cs, cs + ss, cq + sq
    p_c, p_s, p_q = a * pc + b * vc + g * cw, a * ps + b * vs + g * sw, a * pq + b * vq + g * qw
    v_c, v_s, v_q = d * pc + e * vc + h * cw, d * ps + e * vs + h * sw, d * pq + e * vq + h * qw
    p_w, v_w = p_c + p_s, v_c + v_s
    s_s, s_q = cosine * ss - sine * sq, cosine * sq - sine * qq
    q_s, q_q = sine * ss + cosine * sq, sine * sq + cosine * qq
    return Along(
        *moved(along, step, turn, aim_m),
        Spread(
            a * p_p + b * p_v + g * p_w + noise_pp,
            d * p_p + e * p_v + h * p_w + noise_pv,
            p_c,
            cosine * p_s - sine * p_q,
            sine * p_s + cosine * p_q,
            d * v_p + e * v_v + h * v_w + noise_vv,
            v_c,
            cosine * v_s - sine * v_q,
            sine * v_s + cosine * v_q,
            cc + walk_c,
            cosine * cs - sine * cq,
            sine * cs + cosine * cq,
            cosine * s_s - sine * s_q + walk_s,
            sine * s_s + cosine * s_q,
            sine * q_s + cosine * q_q + walk_s,
        ),
    )


def corrected(along: Along, position_m: float, rate_m_s: float, noise: tuple[float, float]) -> tuple[Along, float]:
    """Return the belief after measured position and velocity, with these variances, and the squared innovation.

    That is the Mahalanobis distance, of two degrees of freedom; NaN if a measurement was. With the innovation's
    covariance S = L L' and everything divided by L: the gain needs no inverse, what the covariance loses is symmetric.
    """
    p, v, c, s, q, spread = along.p, along.v, along.c, along.s, along.q, along.spread
    pp, pv, pc, ps, pq = spread.pp, spread.pv, spread.pc, spread.ps, spread.pq
    vv, vc, vs, vq, cc = spread.vv, spread.vc, spread.vs, spread.vq, spread.cc
    cs, cq, ss, sq, qq = spread.cs, spread.cq, spread.ss, spread.sq, spread.qq
    first = sqrt(pp + noise[0])
    gp, gv, gc, gs, gq = pp / first, pv / first, pc / first, ps / first, pq / first
    second = sqrt(max(vv - gv * gv, 0.0) + noise[1])
    hp, hv, hc, hs, hq = (
        (pv - gv * gp) / second,
        (vv - gv * gv) / second,
        (vc - gv * gc) / second,
        (vs - gv * gs) / second,
        (vq - gv * gq) / second,
    )
    x = (position_m - p) / first
    y = (rate_m_s - v - gv * x) / second
    after = Along(
        p + gp * x + hp * y,
        v + gv * x + hv * y,
        c + gc * x + hc * y,
        s + gs * x + hs * y,
        q + gq * x + hq * y,
        Spread(
            pp - gp * gp - hp * hp,
            pv - gp * gv - hp * hv,
            pc - gp * gc - hp * hc,
            ps - gp * gs - hp * hs,
            pq - gp * gq - hp * hq,
            vv - gv * gv - hv * hv,
            vc - gv * gc - hv * hc,
            vs - gv * gs - hv * hs,
            vq - gv * gq - hv * hq,
            cc - gc * gc - hc * hc,
            cs - gc * gs - hc * hs,
            cq - gc * gq - hc * hq,
            ss - gs * gs - hs * hs,
            sq - gs * gq - hs * hq,
            qq - gq * gq - hq * hq,
        ),
    )
    return after, x * x + y * y
