"""Transitions of the ring: the motion of its members while they change places after a vehicle has engaged."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from agents.ring.settling import settling_s
from agents.settings.config import AgentConfig
from estimation.polar import Polar
from estimation.state import Vector
from gcs.metrics.record import FlightRecord, Mask
from gcs.metrics.references import DesiredRing
from gcs.metrics.ring import (
    SETTLED_RADIUS_FRACTION,
    SETTLED_SPACING_RAD,
    TOGETHER_S,
    RingMotion,
    off_ring,
    on_ring,
    ring_motion,
)

ACCELERATION_SPAN_S = 0.4
"""The interval of the velocity differences that give the acceleration."""
_MONOTONIC_AFTER_S = 5.0
_STILL_RAD = np.radians(0.25)
"""V counts as at rest while each spacing is within this on average."""


@dataclass(frozen=True, slots=True)
class TransitionResult:
    """The transition after an engagement or a commanded ring, until the ring has settled or the next one.

    Motion is relative to the target: the highest speed on the ring, the lowest speed along it in its direction
    (negative: backwards, as at first after a reversal), the largest acceleration. `spacing_overshoot_deg` is how far a
    spacing overshot the wanted one, `spacing_monotonic` whether V (18) never increased from 5 s on.
    `settling_predicted_s` is what the law and its bounds predict from the motion at the begin
    (`agents/ring/settling.py`), None if the ring would not settle.
    """

    begins_at_s: float
    members: int
    settling_time_s: float | None = None
    settling_predicted_s: float | None = None
    speed_max_m_s: float | None = None
    forwards_min_m_s: float | None = None
    acceleration_max_m_s2: float | None = None
    spacing_overshoot_deg: float | None = None
    spacing_monotonic: bool | None = None


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """Motion relative to the target, (V, T) each: speed, speed along the ring in its direction, and acceleration."""

    speed_m_s: Vector
    forwards_m_s: Vector
    acceleration_m_s2: Vector


def transitions(
    record: FlightRecord, motion: RingMotion, ring: DesiredRing, began_s: list[float]
) -> tuple[TransitionResult, ...]:
    """Return a result for each engagement and commanded ring, from it until the ring has settled or the next one.

    A ring that was commanded while no vehicle encircled begins none, unless one encircles before the next.
    """
    known_s = [at for at in sorted(began_s) if record.time_s.size and at <= record.time_s[-1]]
    begins_s = [at for at, after in pairwise([*known_s, np.inf]) if after - at > TOGETHER_S]
    relative = relative_motion(record, motion, ring)
    results = (
        _transition(record.time_s, motion, ring, relative, begin_s, end_s)
        for begin_s, end_s in pairwise([*begins_s, np.inf])
    )
    return tuple(each for each in results if each.members)


def predicted(
    results: tuple[TransitionResult, ...], record: FlightRecord, config: AgentConfig, ring: DesiredRing
) -> tuple[TransitionResult, ...]:
    """Return the results with the predicted settling times, for the configuration of a vehicle on the desired ring."""
    motion = ring_motion(record, config.gaps)
    begins_s = np.array([result.begins_at_s for result in results])
    rings = zip(ring.over_m(begins_s).tolist(), ring.over_rad_s(begins_s).tolist(), strict=True)
    changes_s = {each.until_s: each.change_s for each in ring.earlier}
    return tuple(
        replace(
            result,
            settling_predicted_s=_predicted_s(
                result.begins_at_s, record, motion, config.with_ring(*each), changes_s.get(result.begins_at_s, 0.0)
            ),
        )
        for result, each in zip(results, rings, strict=True)
    )


def _predicted_s(
    begin_s: float, record: FlightRecord, motion: RingMotion, config: AgentConfig, change_s: float
) -> float | None:
    """Return the predicted time, at least that in which the ring changes; None without motion to predict from."""
    time_s = record.time_s
    first, after = np.searchsorted(time_s, (begin_s, begin_s + TOGETHER_S))
    after = min(int(after), time_s.size - 1)
    engaged, on_ring_ids = {}, []
    for index in np.flatnonzero(motion.member[:, after]):
        at = int(first) + int(np.argmax(motion.member[index, first:]))
        since_s, until = float(time_s[at]) - begin_s, min(at + 1, time_s.size - 1)
        step_s = float(time_s[until] - time_s[at])
        radii_m = motion.radius_m[index, [at, until]]
        radial_m_s = float(radii_m[1] - radii_m[0]) / step_s if step_s > 0.0 else 0.0
        rate_rad_s = float(motion.rate_rad_s[index, at])
        bearing_rad = float(motion.bearing_rad[index, at]) - rate_rad_s * since_s
        polar = Polar(float(radii_m[0]), bearing_rad, radial_m_s, rate_rad_s)
        if np.isfinite([polar.radius_m, polar.bearing_rad, polar.radial_speed_m_s]).all():
            engaged[record.vehicles[index].vehicle_id] = polar
            if first > 0 and motion.member[index, first - 1]:
                on_ring_ids.append(record.vehicles[index].vehicle_id)
    if not engaged:
        return None
    predicted_s = settling_s(config, engaged, SETTLED_RADIUS_FRACTION, SETTLED_SPACING_RAD, on_ring_ids)
    return round(max(predicted_s, change_s), 6) if np.isfinite(predicted_s) else None


def relative_motion(record: FlightRecord, motion: RingMotion, ring: DesiredRing) -> RelativeMotion:
    """Return the motion of all vehicles relative to the target; the acceleration is NaN near the record's ends."""
    velocity_m_s = np.empty((len(record.vehicles), record.time_s.size, 2))
    for index, track in enumerate(record.vehicles):
        _, velocity_m_s[index] = record.relative(track)
    step_s = float(record.time_s[1] - record.time_s[0]) if record.time_s.size > 1 else 1.0
    half = max(1, round(ACCELERATION_SPAN_S / 2.0 / step_s))
    change_m_s = np.full(velocity_m_s.shape, np.nan)
    if record.time_s.size > 2 * half:
        change_m_s[:, half:-half] = velocity_m_s[:, 2 * half :] - velocity_m_s[:, : -2 * half]
    direction = np.where(ring.over_rad_s(record.time_s) < 0.0, -1.0, 1.0)
    return RelativeMotion(
        np.hypot(velocity_m_s[..., 0], velocity_m_s[..., 1]),
        direction * motion.rate_rad_s * motion.radius_m,
        np.hypot(change_m_s[..., 0], change_m_s[..., 1]) / (2.0 * half * step_s),
    )


def _transition(
    time_s: Vector, motion: RingMotion, ring: DesiredRing, relative: RelativeMotion, begin_s: float, end_s: float
) -> TransitionResult:
    inside = (time_s >= begin_s) & (time_s < end_s)
    outside = np.flatnonzero(inside & off_ring(time_s, motion, ring))
    last = int(outside[-1]) + 1 if outside.size else int(np.argmax(inside))
    settled = bool(last < time_s.size and inside[last])
    moving = inside & (np.arange(time_s.size) <= (last if settled else time_s.size))
    transiting = motion.member & moving
    error_rad = motion.lead_rad - motion.desired_spacing_rad
    return TransitionResult(
        begins_at_s=round(begin_s, 6),
        members=int(motion.member[:, inside].sum(axis=0).max()),
        settling_time_s=round(float(time_s[last]) - begin_s, 6) if settled else None,
        speed_max_m_s=_most(relative.speed_m_s, transiting),
        forwards_min_m_s=_least(relative.forwards_m_s, transiting),
        acceleration_max_m_s2=_most(relative.acceleration_m_s2, transiting),
        spacing_overshoot_deg=overshoot_deg(motion, on_ring(time_s, motion, ring), slice(*_ends(inside))),
        spacing_monotonic=_monotonic(time_s[inside] - begin_s, error_rad[:, inside]),
    )


def _ends(inside: Mask) -> tuple[int, int]:
    samples = np.flatnonzero(inside)
    return int(samples[0]), int(samples[-1]) + 1


def overshoot_deg(motion: RingMotion, on: Mask, span: slice) -> float | None:
    """Return how far a spacing went beyond the wanted one in a span of samples, None without a spacing.

    It counts at most as far as the spacing had been on the other side before: one that happens to be right has to
    change first to make room. A spacing is followed as long as its two vehicles are neighbours, both `on` (V, T) the
    ring, and the wanted one is the same.
    """
    wanted_rad = motion.desired_spacing_rad[:, span]
    error_deg = np.degrees(motion.lead_rad[:, span] - wanted_rad)
    order = np.argsort(np.where(motion.member, motion.bearing_rad, np.nan)[:, span], axis=0)
    count = motion.member[:, span].sum(axis=0)
    rank = np.arange(len(order))[:, None]
    ahead = np.empty(order.shape, dtype=np.intp)
    following = np.take_along_axis(order, np.where(rank == count - 1, 0, np.minimum(rank + 1, len(order) - 1)), axis=0)
    np.put_along_axis(ahead, order, following, axis=0)
    both = on[:, span] & np.take_along_axis(on[:, span], ahead, axis=0) & np.isfinite(error_deg)
    ahead[~both] = -1
    farthest_deg = None
    for neighbour, wanted, error in zip(ahead, wanted_rad, error_deg, strict=True):
        changes = (np.diff(neighbour) != 0) | (np.diff(wanted) != 0.0)
        for begin, end in pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), neighbour.size]):
            if neighbour[begin] >= 0:
                farthest_deg = max(farthest_deg or 0.0, _swung_deg(error[begin:end]))
    return farthest_deg


def _swung_deg(error_deg: Vector) -> float:
    above, below = np.maximum.accumulate(error_deg), np.maximum.accumulate(-error_deg)
    return float(np.maximum(np.minimum(above, -error_deg), np.minimum(below, error_deg)).max(initial=0.0))


def _monotonic(since_s: Vector, error_rad: Vector) -> bool | None:
    """Return whether V (18) never increases from 5 s after the engagement on, except while the ring is at rest."""
    value = 0.5 * np.nansum(error_rad**2, axis=0)
    members = np.isfinite(error_rad).sum(axis=0)
    counted = (since_s >= _MONOTONIC_AFTER_S) & (members > 1)
    if not counted.any():
        return None
    at_rest = 0.5 * members[counted] * _STILL_RAD**2
    value = value[counted]
    return bool((np.diff(value) <= 1e-9).all() or (np.diff(value)[value[1:] > at_rest[1:]] <= 1e-9).all())


def _most(values: Vector, where: Mask) -> float | None:
    known = values[where & np.isfinite(values)]
    return float(known.max()) if known.size else None


def _least(values: Vector, where: Mask) -> float | None:
    most = _most(-values, where)
    return None if most is None else -most
