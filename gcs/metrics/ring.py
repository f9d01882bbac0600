"""The metrics of the ring as a whole: when it settled, and the spacings between neighbours.

Arrays over time have shape (T,): the record's samples.

The team's motion about the target: radius, bearing and rate of every vehicle, and the spacings on the ring.

Arrays over the whole team have shape (V, T): vehicles in the record's order, samples in time. NaN marks samples
without a measurement.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, tau

import numpy as np

from agents.ring.bent_ring import RingBend
from agents.ring.place import EVEN, Gaps, weights_of
from agents.tactics import NO_TACTIC, Tactic
from estimation.state import Vector
from gcs.metrics.record import TIME_GRAIN_S, FlightRecord, Mask, grid_time, largest, lasting_s, rms
from gcs.metrics.references import DesiredRing

SETTLED_RADIUS_FRACTION = 0.05
SETTLED_SPACING_RAD = np.radians(5.0)
TOGETHER_S = 3.0
"""What begins within this time of each other, such as engagements, settles together."""
LOST_AFTER_S = 5.0
"""A vehicle without data for longer than this at the end of the record has left the ring."""


@dataclass(frozen=True, slots=True)
class RingMotion:
    """The team's motion about the target, shape (V, T) each; NaN where a vehicle does not encircle or has no data.

    `member` marks the vehicles on the ring, including one without data that encircled before and after, `weight` (V,)
    are the weights of the gaps ahead of them.
    `lead_rad` is the angle counter-clockwise from a vehicle to the next one: NaN where there is none, or where a
    member has no data, so that the neighbours are not known.
    """

    member: Mask
    radius_m: Vector
    bearing_rad: Vector
    rate_rad_s: Vector
    lead_rad: Vector
    weight: Vector

    @property
    def desired_spacing_rad(self) -> Vector:
        """The angle that each member should keep to the next: its share of a turn, 2 pi / n where gaps are even.

        NaN where there are fewer than two.
        """
        weight = np.where(self.member, self.weight[:, None], 0.0)
        spaced = self.member & (self.member.sum(axis=0) > 1)
        unit_rad = tau / np.where(spaced, weight.sum(axis=0), 1.0)
        return np.where(spaced, weight * unit_rad, np.nan)

    @property
    def measured(self) -> Mask:
        """The samples (T,) with a ring of which every member was measured."""
        return np.asarray(self.member.any(axis=0) & ~(self.member & np.isnan(self.bearing_rad)).any(axis=0))

    def first(self, samples: int) -> "RingMotion":
        """Return it over the first samples."""
        return RingMotion(
            self.member[:, :samples],
            self.radius_m[:, :samples],
            self.bearing_rad[:, :samples],
            self.rate_rad_s[:, :samples],
            self.lead_rad[:, :samples],
            self.weight,
        )


def ring_motion(record: FlightRecord, gaps: Gaps = EVEN, bend: RingBend | None = None) -> RingMotion:
    """Resolve every vehicle's motion relative to the moving target into radius, bearing and angular rate.

    Estimated motion is relative to the vehicle's own estimate of the target, so that frame errors are no ring errors.
    Radii on a ring that bends around no-fly zones are less its bend.
    """
    shape = (len(record.vehicles), record.time_s.size)
    offset_m, drift_m_s = np.empty((2, *shape, 2))
    for index, track in enumerate(record.vehicles):
        offset_m[index], drift_m_s[index] = record.relative(track)
    encircling = measured(record) & flies(record, Tactic.ENCIRCLE)
    radius_m = np.where(encircling, np.hypot(offset_m[..., 0], offset_m[..., 1]), np.nan)
    # On top of the target there is neither a bearing nor an angular rate.
    defined_m = np.where(radius_m > 0.0, radius_m, np.nan)
    swept_m2_s = offset_m[..., 0] * drift_m_s[..., 1] - offset_m[..., 1] * drift_m_s[..., 0]
    bearing_rad = np.where(np.isnan(defined_m), np.nan, np.arctan2(offset_m[..., 1], offset_m[..., 0]))
    member = _members(record)
    if bend is not None:
        known = np.isfinite(bearing_rad)
        radius_m[known] -= bend.at(bearing_rad[known])[0]
    return RingMotion(
        member=member,
        radius_m=radius_m,
        bearing_rad=bearing_rad,
        rate_rad_s=swept_m2_s / defined_m**2,
        lead_rad=_lead_rad(bearing_rad, member),
        weight=np.array(weights_of((track.vehicle_id for track in record.vehicles), gaps)),
    )


def off_ring(time_s: Vector, motion: RingMotion, ring: DesiredRing) -> Mask:
    """Return the samples (T,) with a radius or a spacing outside of what counts as settled, or a ring on its way."""
    desired_m = ring.over_m(time_s)
    spacing_error_rad = np.abs(motion.lead_rad - motion.desired_spacing_rad)
    off_radius = (np.abs(motion.radius_m - desired_m) > SETTLED_RADIUS_FRACTION * desired_m).any(axis=0)
    return np.asarray(off_radius | (spacing_error_rad > SETTLED_SPACING_RAD).any(axis=0) | ring.changes(time_s))


def on_ring(time_s: Vector, motion: RingMotion, ring: DesiredRing, mixing_samples: int = 0) -> Mask:
    """Return where (V, T) a vehicle has reached the radius since it became a member.

    The radius counts from so many samples as a member on.
    """
    desired_m = ring.over_m(time_s)
    near = np.abs(motion.radius_m - desired_m) <= SETTLED_RADIUS_FRACTION * desired_m
    index = np.arange(motion.member.shape[1])
    out = np.maximum.accumulate(np.where(motion.member, -1, index), axis=1)
    reached = np.maximum.accumulate(np.where(motion.member & near & (index - out > mixing_samples), index, -1), axis=1)
    return np.asarray(motion.member & (reached > out))


def measured(record: FlightRecord) -> Mask:
    """Return the samples (V, T) that hold a vehicle's position, velocity and tactic."""
    mask = ~_samples(record, NO_TACTIC)
    for row, track in zip(mask, record.vehicles, strict=True):
        motion = np.concatenate((track.position_m, track.velocity_m_s), axis=1)
        row[:] &= np.isfinite(motion).all(axis=1)
    return mask


def flies(record: FlightRecord, tactic: Tactic) -> Mask:
    """Return the samples (V, T) at which a vehicle flies a tactic."""
    return _samples(record, tactic.value)


def _samples(record: FlightRecord, tactic: str) -> Mask:
    mask = np.zeros((len(record.vehicles), record.time_s.size), dtype=np.bool_)
    for row, track in zip(mask, record.vehicles, strict=True):
        row[:] = track.tactic == tactic
    return mask


def _members(record: FlightRecord) -> Mask:
    """Return the members of the ring; a gap in the data is bridged if the vehicle encircled before and after it."""
    known, encircle = measured(record), flies(record, Tactic.ENCIRCLE)
    samples = record.time_s.size
    index = np.arange(samples)
    before = np.maximum.accumulate(np.where(known, index, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, index, samples)[:, ::-1], axis=1)[:, ::-1]
    encircled = np.take_along_axis(encircle, np.maximum(before, 0), axis=1) & (before >= 0)
    if not samples:
        return encircled
    encircles_again = np.take_along_axis(encircle, np.minimum(after, samples - 1), axis=1) & (after < samples)
    gap_s = record.time_s[-1] - record.time_s[np.maximum(before, 0)]
    return np.asarray(encircled & (encircles_again | ((after == samples) & (gap_s <= LOST_AFTER_S))))


def _lead_rad(bearing_rad: Vector, member: Mask) -> Vector:
    """Sort the bearings (NaN last); take the angle from each to the next, the last's around to the first."""
    count = member.sum(axis=0)
    lead_rad = np.full(bearing_rad.shape, np.nan)
    complete = (count > 1) & ~(member & np.isnan(bearing_rad)).any(axis=0)
    if not complete.any():
        return lead_rad
    order = np.argsort(bearing_rad, axis=0)
    ranked = np.take_along_axis(bearing_rad, order, axis=0)
    following = np.roll(ranked, -1, axis=0)
    closing = np.arange(len(ranked))[:, None] == count - 1
    following = np.where(closing, ranked[0] + tau, following)
    np.put_along_axis(lead_rad, order, np.where(complete, following - ranked, np.nan), axis=0)
    return lead_rad


SETTLED_FOR_S = 10.0
"""A ring that stays within its limits for this time has settled, even if it leaves them later.

What lasts for less cannot be judged: a formation, or what began so shortly before the end of the ring.
"""


@dataclass(frozen=True, slots=True)
class RingResult:
    """The ring as a whole: time to settle after the last engagement or commanded ring, and the spacings of neighbours.

    `unsettled_at_s` is when a ring that had settled left its limits for the last time, None if it never did after it
    began; `first_settled_at_s` is when it had settled first, None without that.
    `judged_s` is the time in the window of the ring metrics with a ring of which every vehicle was measured,
    `judged_from_s` its begin, None without any, `judged_share` its share of all time with a vehicle on the ring, and
    `members_min` the fewest vehicles on the ring in it.
    """

    settling_time_s: float | None = None
    spacing_error_rms_deg: float | None = None
    spacing_error_max_deg: float | None = None
    first_settled_at_s: float | None = None
    unsettled_at_s: float | None = None
    judged_s: float | None = None
    judged_from_s: float | None = None
    judged_share: float | None = None
    members_min: int | None = None


@dataclass(frozen=True, slots=True)
class JudgedPart:
    """The part of a flight over which its ring can be judged: the first `samples`, and the ring desired until then.

    `began_s` are the times at which that ring began to settle, empty where no vehicle engaged.
    """

    ring: DesiredRing
    began_s: tuple[float, ...]
    samples: int


def judged_part(time_s: Vector, motion: RingMotion, ring: DesiredRing, engaged_s: Sequence[float | None]) -> JudgedPart:
    """Return the part of a flight without what began too shortly before the end of the ring to show that it settles.

    An engagement needs `SETTLED_FOR_S` for that, a commanded ring also the time that its change takes. The first
    engagements are never left out: no ring was flown before them.
    """
    began_s = sorted(ring.began_s(engaged_s))
    changed_s = {each.until_s: each.until_s + each.change_s for each in ring.earlier}
    on_s, cut_s = time_s[motion.member.any(axis=0)], inf
    while began_s and (together_s := last_together_s(began_s)) > began_s[0]:
        on_s = on_s[on_s < cut_s - TIME_GRAIN_S]
        needed_s = max(changed_s.get(each, each) for each in began_s if each >= together_s) + SETTLED_FOR_S
        if on_s.size and on_s[-1] >= needed_s - TIME_GRAIN_S:
            break
        cut_s = together_s
        began_s = [each for each in began_s if each < cut_s]
    samples = int(np.searchsorted(time_s, cut_s - TIME_GRAIN_S))
    return JudgedPart(ring.before(cut_s), tuple(began_s), samples)


def last_together_s(began_s: Sequence[float]) -> float:
    """Return the first of the last times, in order, that are within `TOGETHER_S` of each other."""
    breaks = (after for before, after in pairwise(began_s) if after - before > TOGETHER_S)
    return max(breaks, default=began_s[0])


def is_brief(time_s: Vector, motion: RingMotion, part: JudgedPart, window: Mask, result: RingResult) -> bool:
    """Return whether a ring was flown, or had settled, for less than it needs to show that it has settled."""
    anyone = np.asarray(motion.member.any(axis=0) & (np.arange(time_s.size) < part.samples))
    counted = anyone if result.settling_time_s is None else anyone & window
    return lasting_s(time_s, counted) < SETTLED_FOR_S - TIME_GRAIN_S


def judged_ring(time_s: Vector, motion: RingMotion, part: JudgedPart) -> tuple[tuple[float, float] | None, RingResult]:
    """Return the window of the ring metrics, None where none engaged, and the ring as a whole in that part."""
    if not part.began_s:
        return None, RingResult()
    ring, began_s, part_s, flown = part.ring, max(part.began_s), time_s[: part.samples], motion.first(part.samples)
    settled_s = _settled_at_s(part_s, flown, ring, began_s)
    window_s = _window_s(part_s, settled_s)
    settling_time_s = None if settled_s is None else grid_time(settled_s - began_s)
    window = within(time_s, window_s)
    errors_deg, unsettled_s = _spacing_errors_deg(motion, window), _unsettled(part_s, flown, ring, began_s)
    judged_s, from_s, share, members = _judged(time_s, motion, window)
    return window_s, RingResult(settling_time_s, *errors_deg, *unsettled_s, judged_s, from_s, share, members)


def estimated_ring(time_s: Vector, motion: RingMotion, part: JudgedPart, window: Mask) -> RingResult:
    """Return the ring by the vehicles' estimates in a part of the flight, its spacings in the window of the truth."""
    part_s, flown, began_s = time_s[: part.samples], motion.first(part.samples), max(part.began_s, default=inf)
    settled_s = _settled_at_s(part_s, flown, part.ring, began_s)
    settling_time_s = None if settled_s is None else grid_time(settled_s - began_s)
    return RingResult(settling_time_s, *_spacing_errors_deg(motion, window))


def _settled_at_s(time_s: Vector, motion: RingMotion, ring: DesiredRing, last_began_s: float) -> float | None:
    """Return the time after it began from which the ring stays within its limits to the end, or None."""
    outside = np.flatnonzero(off_ring(time_s, motion, ring))
    # Settling starts at a sample at which every member of the ring was measured.
    valid = motion.measured & (time_s >= last_began_s - TIME_GRAIN_S)
    valid[: outside[-1] + 1 if outside.size else 0] = False
    return float(time_s[np.argmax(valid)]) if valid.any() else None


def _unsettled(
    time_s: Vector, motion: RingMotion, ring: DesiredRing, last_began_s: float
) -> tuple[float | None, float | None]:
    """Return when the ring had settled first, and when it left its limits last after that; None if it never did.

    It counts as settled once it was within its limits for `SETTLED_FOR_S`.
    """
    off = off_ring(time_s, motion, ring)
    known = (off | motion.measured) & (time_s >= last_began_s - TIME_GRAIN_S)
    off, at_s = off[known], time_s[known]
    changes = np.flatnonzero(np.diff(off)) + 1
    begins, ends = np.append(0, changes), np.append(changes, off.size)
    stays = [
        (at_s[begin], at_s[end]) for begin, end in zip(begins, ends, strict=True) if end < off.size and not off[begin]
    ]
    settled_s = next((begin_s for begin_s, end_s in stays if end_s - begin_s >= SETTLED_FOR_S), None)
    if settled_s is None:
        return None, None
    return grid_time(float(settled_s)), grid_time(float(stays[-1][1]))


def _window_s(time_s: Vector, settled_s: float | None) -> tuple[float, float]:
    start_s, end_s = float(time_s[0]), float(time_s[-1])
    window_start_s = settled_s if settled_s is not None else end_s - (end_s - start_s) / 4.0
    return grid_time(window_start_s), grid_time(end_s)


def within(time_s: Vector, window_s: tuple[float, float] | None) -> Mask:
    """Return the samples (T,) in a window, none without one."""
    if window_s is None:
        return np.zeros(time_s.shape, dtype=np.bool_)
    return np.asarray((time_s >= window_s[0] - TIME_GRAIN_S) & (time_s <= window_s[1] + TIME_GRAIN_S))


def _judged(time_s: Vector, motion: RingMotion, window: Mask) -> tuple[float, float | None, float, int]:
    """Return the time on the ring in a window, its begin, its share of all time on the ring, and the fewest members."""
    anyone, judged = np.asarray(motion.member.any(axis=0)), np.asarray(motion.measured & window)
    members = motion.member.sum(axis=0)[judged]
    judged_s, whole_s = lasting_s(time_s, judged), lasting_s(time_s, anyone)
    begins_s = grid_time(float(time_s[judged][0])) if judged.any() else None
    share = judged_s / whole_s if whole_s else float(judged.any())
    return judged_s, begins_s, share, int(members.min(initial=len(motion.member))) if members.size else 0


def _spacing_errors_deg(motion: RingMotion, window: Mask) -> tuple[float | None, float | None]:
    error_deg = np.degrees(motion.lead_rad - motion.desired_spacing_rad)[:, window]
    return rms(error_deg), largest(error_deg)
