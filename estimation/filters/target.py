"""The target filter: a constant-velocity model with adaptive noise, on the sightings of the whole team.

Vehicles share raw sightings, not estimates, so that no information is counted twice. The estimate depends on the
sightings in order of time: a late one is inserted at its time and those after it are processed again. All vehicles with
the same sightings therefore have the same estimate, whatever the order. docs/notes/target.md compares the alternatives.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import lru_cache
from math import exp, inf, isfinite, log, sqrt
from typing import Final

import msgspec
import numpy as np
from msgspec.structs import replace

from estimation.filters.planar import (
    LEAST_M2,
    Innovation,
    Motion,
    PlanarCovariance,
    PredictionStep,
    faster,
    predicted,
    updated,
)
from estimation.settings import TargetFilterSettings
from estimation.state import STEP_DIGITS, Sighting, TargetEstimate
from estimation.vectors import rounded

OUT_OF_SIGHT_S: Final = 1.0
"""A target not sighted for longer may have turned or stopped since."""
HISTORY_MAX: Final = 256
"""The largest number of stored sightings, which bounds the cost of a late one."""
_SEGMENT_S: Final = 0.05
_SEGMENT_MAX: Final = 32
"""One track per this time, or per this many sightings, is stored, to restart from for a late sighting."""

_FADING_S: Final = 0.5
_CLIP_SIGMA: Final = 3.0
_MANOEUVRE_THRESHOLD: Final = 20.0
_MANOEUVRE_THRESHOLD_AGAIN: Final = 16.0
"""Thresholds of the fading-memory innovation test, chi-squared with two degrees of freedom: exceeded by chance in 1 of
20 000 samples, or of 3000 for a target that has manoeuvred before and is likely to do so again."""
_ONSET_S: Final = 0.5
_MANOEUVRING_S: Final = 8.0
_MANOEUVRES_AGAIN_S: Final = 40.0


class _FadingInnovation:
    """The fading-memory innovation test: a fading sum of normalised innovations, and its variance."""

    def __init__(self, x: float = 0.0, y: float = 0.0, variance: float = 0.0) -> None:
        self.x: Final = x
        self.y: Final = y
        self.variance: Final = variance

    @property
    def squared(self) -> float:
        """The sum, normalised and squared; 0 for only one or two sightings."""
        return (self.x**2 + self.y**2) / self.variance if self.variance > 1.5 else 0.0

    def after(self, step_s: float, innovation: Innovation) -> "_FadingInnovation":
        kept, squared = exp(-step_s / _FADING_S), innovation.squared
        share = 1.0 if squared <= _CLIP_SIGMA**2 else _CLIP_SIGMA / sqrt(squared)
        return _FadingInnovation(
            kept * self.x + share * innovation.x,
            kept * self.y + share * innovation.y,
            kept * kept * self.variance + 1.0,
        )


class _Track(msgspec.Struct, frozen=True):
    """The estimate after a sighting, which was used or `refused`; importance and threat are the latest received.

    `accepted_s` is the time of the last sighting used, `refused_since_s` that of the first one refused after it,
    `began_s` when the track began, `manoeuvre_s` when the last manoeuvre was detected; `resets` counts confirmed
    restarts.
    """

    sighting: Sighting
    motion: Motion
    fading_innovation: _FadingInnovation
    accepted_s: float
    refused_since_s: float
    began_s: float
    importance: float
    threat: float
    manoeuvre_s: float = -inf
    resets: int = 0
    refused: bool = False


class _Segment:
    """Consecutive sightings, and the track before the first of them (None: no track yet)."""

    __slots__ = ("before", "from_s", "refused", "sightings", "times_s")

    def __init__(self, before: _Track | None, first: Sighting) -> None:
        self.before = before
        self.from_s = first.time_s
        self.sightings = [first]
        self.times_s = [first.time_s]
        self.refused = 0

    def has(self, sighting: Sighting) -> bool:
        """Return whether it has a sighting; its own are in the order of time."""
        time_s = sighting.time_s
        first, end = bisect_left(self.times_s, time_s), bisect_right(self.times_s, time_s)
        return sighting in self.sightings[first:end]

    def add(self, sighting: Sighting) -> None:
        """Add a sighting that is not before its last one."""
        self.sightings.append(sighting)
        self.times_s.append(sighting.time_s)

    def copy(self) -> "_Segment":
        other = _Segment(self.before, self.sightings[0])
        other.sightings, other.times_s, other.refused = self.sightings.copy(), self.times_s.copy(), self.refused
        return other


class TrackFit:
    """How well a sighting fits a track whose gate it passes: terms of its likelihood, and the prior motion.

    `squared` is the squared Mahalanobis distance, `log_volume` the logarithm of its covariance's determinant [m^4].
    """

    def __init__(self, squared: float, log_volume: float, prior: Motion) -> None:
        self.squared: Final = squared
        self.log_volume: Final = log_volume
        self.prior: Final = prior


class TargetFilter:
    """Estimates the target's position and velocity from the sightings of all vehicles.

    `refused` counts the rejected sightings (less those accepted later, after late ones had arrived), `late` those
    inserted before others, `resets` the restarts of a track that had more than one sighting.
    """

    def __init__(self, settings: TargetFilterSettings) -> None:
        self._settings = settings
        # Read in every tick: as a machine number each costs a tenth of a setting.
        self._stale_after_s, self._late_max_s = settings.stale_after_s, settings.late_max_s
        self._steady_m2_s4 = settings.acceleration_noise_m_s2**2
        self._manoeuvring_m2_s4 = settings.manoeuvre_acceleration_m_s2**2
        self._track: _Track | None = None
        self._segments: list[_Segment] = []
        self._kept = 0
        self._dropped_before_s = -inf
        self.refused = 0
        self.late = 0
        self.resets = 0

    def sight(self, *sightings: Sighting) -> None:
        """Process sightings from any sensors, in any order; outliers, repeats and late ones are refused.

        One call for several costs less, because later sightings are processed again only once.
        """
        fresh = self._fresh(sightings)
        if not fresh:
            return
        resets = 0 if self._track is None else self._track.resets
        if self._track is not None and fresh[0].time_s < self._track.sighting.time_s:
            fresh = self._put_among(fresh)
        for each in fresh:
            track = self._take(each)
        self.resets += max(track.resets - resets, 0)
        self._drop_old(fresh[-1].time_s)

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the estimate at `now_s`; None if there is none, or its newest sighting is stale."""
        track = self._track
        if track is None or now_s - track.accepted_s > self._stale_after_s:
            return None
        motion = self._motion_at(track, max(now_s, track.motion.time_s))
        mean, spread = np.array((motion.x, motion.y, motion.u, motion.v)), motion.spread.upper
        return TargetEstimate(motion.time_s, mean, spread, track.accepted_s, track.importance, track.threat)

    def fit(self, sighting: Sighting) -> TrackFit | None:
        """Return how well a sighting not older than the newest one fits; None if the gate would refuse it.

        The gate is chi-squared with two degrees of freedom: a sound sighting is refused with `exp(-gate_sigma**2)`.
        """
        track = self._track
        if track is None:
            return None
        prior = self._motion_at(track, sighting.time_s)
        noise_m2 = self._reachable(track, sighting)
        _, innovation = updated(prior, sighting.position_m, noise_m2)
        if not self._passes(innovation):
            return None
        (xx, xy, _, _, yy, *_), (noise_xx, noise_xy, noise_yy) = prior.spread.upper, noise_m2
        across = (xy + noise_xy) / sqrt(xx + noise_xx)
        log_volume = log(xx + noise_xx) + log(max(yy + noise_yy - across * across, LEAST_M2))
        return TrackFit(innovation.squared, log_volume, prior) if isfinite(log_volume) else None

    def copy(self) -> "TargetFilter":
        """Return a filter in the same state, which later sightings of this one do not change."""
        other = TargetFilter(self._settings)
        other._track = self._track
        other._segments = [*self._segments[:-1], *(each.copy() for each in self._segments[-1:])]
        other._kept, other._dropped_before_s = self._kept, self._dropped_before_s
        other.refused, other.late, other.resets = self.refused, self.late, self.resets
        return other

    @property
    def sighted_s(self) -> float:
        """Time of the newest sighting used [s], 0 before any."""
        return 0.0 if self._track is None else self._track.accepted_s

    def _put_among(self, fresh: list[Sighting]) -> list[Sighting]:
        """Remove the segments from the first new sighting on; return all sightings to process again, in order."""
        place = max(bisect_right(self._segments, fresh[0].time_s, key=_begin_of) - 1, 0)
        back = self._segments[place:]
        del self._segments[place:]
        newer = [sighting for segment in back for sighting in segment.sightings]
        self.late += sum(each.time_s < newer[-1].time_s for each in fresh)
        self.refused -= sum(segment.refused for segment in back)
        self._kept -= len(newer)
        self._track = back[0].before
        return sorted([*newer, *fresh], key=_when)

    def _fresh(self, sightings: Sequence[Sighting]) -> list[Sighting]:
        """Return the sightings that are not too late, in order of time; repeats are detected later."""
        newest_s = -inf if self._track is None else self._track.sighting.time_s
        from_s = max(newest_s - self._late_max_s, self._dropped_before_s)
        fresh = [
            each
            for each in sorted(sightings, key=_when)
            if each.time_s >= newest_s or (each.time_s >= from_s and not self._is_repeat(each))
        ]
        self.refused += len(sightings) - len(fresh)
        return fresh

    def _is_repeat(self, sighting: Sighting) -> bool:
        for segment in reversed(self._segments):
            if segment.from_s <= sighting.time_s and segment.has(sighting):
                return True
            if segment.from_s < sighting.time_s:
                return False
        return False

    def _take(self, sighting: Sighting) -> _Track:
        """Process the newest sighting so far, unless it is a repeat; return the track after it."""
        before, last = self._track, self._segments[-1] if self._segments else None
        if before is not None and sighting.time_s == before.sighting.time_s and self._is_repeat(sighting):
            self.refused += 1
            return before
        if last is None or sighting.time_s - last.from_s >= _SEGMENT_S or len(last.sightings) >= _SEGMENT_MAX:
            last = _Segment(before, sighting)
            self._segments.append(last)
        else:
            last.add(sighting)
        self._kept += 1
        self._track = track = self._started(sighting) if before is None else self._after(before, sighting)
        last.refused += track.refused
        self.refused += track.refused
        return track

    def _after(self, last: _Track, sighting: Sighting) -> _Track:
        """Return the track after the newest sighting so far."""
        if last.refused and (other := self._restarted_by_majority(last, sighting)) is not None:
            return other
        track = self._updated(last, sighting)
        if track.refused:
            # All sightings have disagreed with the track during the timeout: the track is wrong.
            too_long = sighting.time_s - track.refused_since_s > self._settings.gate_timeout_s
            if too_long:
                return replace(self._started(sighting), resets=last.resets + 1)
            return track
        statistic = track.fading_innovation.squared
        if statistic <= _MANOEUVRE_THRESHOLD_AGAIN:
            return track
        manoeuvres_again = sighting.time_s - track.manoeuvre_s < _MANOEUVRES_AGAIN_S
        return self._restarted_at_manoeuvre(track) if manoeuvres_again or statistic > _MANOEUVRE_THRESHOLD else track

    def _restarted_by_majority(self, last: _Track, sighting: Sighting) -> _Track | None:
        """Return a new track if the first sighting was never confirmed and the last two agree better."""
        if last.accepted_s != last.began_s:
            return None
        first = self._started(last.sighting)
        if self._squared_innovation(first, sighting) >= self._squared_innovation(last, sighting):
            return None
        other = self._updated(first, sighting)
        return None if other.refused else replace(other, resets=last.resets)

    def _squared_innovation(self, track: _Track, sighting: Sighting) -> float:
        """Return the squared Mahalanobis distance of a sighting from a track."""
        prior = self._motion_at(track, sighting.time_s)
        return updated(prior, sighting.position_m, sighting.covariance_m2)[1].squared

    def _started(self, sighting: Sighting) -> _Track:
        (xx, xy, yy), speed = sighting.covariance_m2, self._settings.velocity_prior_m_s**2
        spread = PlanarCovariance((xx, xy, 0.0, 0.0, yy, 0.0, 0.0, speed, 0.0, speed))
        time_s = sighting.time_s
        motion = Motion(time_s, *sighting.position_m, 0.0, 0.0, spread)
        return _Track(sighting, motion, _FadingInnovation(), time_s, inf, time_s, sighting.importance, sighting.threat)

    def _updated(self, last: _Track, sighting: Sighting) -> _Track:
        """Return the track after a sighting; a sighting beyond the noise has less weight, or is refused."""
        prior = self._motion_at(last, sighting.time_s)
        motion, innovation = updated(prior, sighting.position_m, sighting.covariance_m2)
        unseen_s, squared = sighting.time_s - last.accepted_s, innovation.squared
        if not squared <= _CLIP_SIGMA**2:  # also NaN
            _, within_reach = updated(prior, sighting.position_m, self._reachable(last, sighting))
            if not self._passes(within_reach):
                refused_since_s = min(last.refused_since_s, sighting.time_s)
                return replace(last, sighting=sighting, motion=prior, refused_since_s=refused_since_s, refused=True)
            excess = sqrt(squared) / _CLIP_SIGMA
            motion, _ = updated(prior, sighting.position_m, _widened(sighting, excess, 0.0))
        return _Track(
            sighting,
            motion,
            last.fading_innovation.after(unseen_s, innovation),
            sighting.time_s,
            inf,
            last.began_s,
            sighting.importance,
            sighting.threat,
            last.manoeuvre_s,
            last.resets,
        )

    def _reachable(self, last: _Track, sighting: Sighting) -> tuple[float, float, float]:
        """Return a sighting's covariance plus how far a manoeuvring target can be from the prediction by now."""
        reach_m = self._settings.velocity_prior_m_s * min(sighting.time_s - last.accepted_s, OUT_OF_SIGHT_S)
        return _widened(sighting, 1.0, reach_m**2)

    def _passes(self, within_reach: Innovation) -> bool:
        return within_reach.squared <= 2.0 * self._settings.gate_sigma**2  # False for NaN

    def _restarted_at_manoeuvre(self, track: _Track) -> _Track:
        """Return the track, processed again with a larger velocity covariance from shortly before the manoeuvre.

        A track that began after the last stored one is returned unchanged: its velocity covariance is already large.
        """
        manoeuvre_s, speed_m2_s2 = track.sighting.time_s, self._settings.manoeuvre_speed_m_s**2
        since = [each for each in self._segments if each.before is not None and each.before.began_s == track.began_s]
        since = since[min(bisect_right(since, manoeuvre_s - _ONSET_S, key=_begin_of), len(since) - 1) :]
        if not since or (before := since[0].before) is None:
            return track
        motion = faster(before.motion, speed_m2_s2)
        again = replace(before, motion=motion, fading_innovation=_FadingInnovation(), manoeuvre_s=manoeuvre_s)
        for segment in since:
            for sighting in segment.sightings:
                again = self._updated(again, sighting)
        return replace(again, fading_innovation=_FadingInnovation())

    def _motion_at(self, track: _Track, to_s: float) -> Motion:
        """Return the predicted motion: constant velocity while in sight, a decaying velocity while out of sight."""
        motion, settings = track.motion, self._settings
        if to_s <= motion.time_s:
            return motion
        out_of_sight_s = max(track.accepted_s + OUT_OF_SIGHT_S, motion.time_s)
        step_s = rounded(min(to_s, out_of_sight_s) - motion.time_s, STEP_DIGITS)
        if step_s > 0.0:
            # A manoeuvre is likely to be followed by another. Rounded, so that cached steps are reused.
            manoeuvring = rounded(exp(min(track.manoeuvre_s - motion.time_s, 0.0) / _MANOEUVRING_S), 2)
            density = self._steady_m2_s4 + manoeuvring * self._manoeuvring_m2_s4
            motion = predicted(motion, min(to_s, out_of_sight_s), _straight(density, step_s))
        step_s = rounded(to_s - out_of_sight_s, STEP_DIGITS)
        if step_s > 0.0:
            motion = predicted(motion, to_s, _ornstein_uhlenbeck(settings.velocity_prior_m_s, settings.coast_s, step_s))
        return motion

    def _drop_old(self, newest_s: float) -> None:
        # One track older than the window is kept, to restart from for a late sighting or a manoeuvre.
        before_s, segments = newest_s - self._late_max_s - _ONSET_S, self._segments
        while len(segments) > 1 and (segments[1].from_s < before_s or self._kept > HISTORY_MAX):
            self._kept -= len(segments[0].sightings)
            del segments[0]
            self._dropped_before_s = segments[0].from_s


def _when(sighting: Sighting) -> float:
    return sighting.time_s


def _begin_of(segment: _Segment) -> float:
    return segment.from_s


def _widened(sighting: Sighting, excess: float, reach_m2: float) -> tuple[float, float, float]:
    """Return a sighting's covariance multiplied by `excess`, plus `reach_m2` in every direction."""
    xx, xy, yy = sighting.covariance_m2
    return xx * excess + reach_m2, xy * excess, yy * excess + reach_m2


@lru_cache(maxsize=4096)
def _straight(density: float, step_s: float) -> PredictionStep:
    """Return a step of constant velocity under white acceleration."""
    return PredictionStep(step_s, 1.0, density * step_s**3 / 3.0, density * step_s**2 / 2.0, density * step_s)


@lru_cache(maxsize=1024)
def _ornstein_uhlenbeck(speed_m_s: float, correlation_s: float, step_s: float) -> PredictionStep:
    """Return a step of a velocity that is an Ornstein-Uhlenbeck process.

    Its standard deviation tends to `speed_m_s`, its correlation time is `correlation_s`.
    """
    velocity_share = exp(-step_s / correlation_s)
    variance = speed_m_s**2
    noise_position = (
        variance * correlation_s**2 * (2.0 * step_s / correlation_s - 3.0 + 4.0 * velocity_share - velocity_share**2)
    )
    noise_cross = variance * correlation_s * (1.0 - velocity_share) ** 2
    return PredictionStep(
        correlation_s * (1.0 - velocity_share),
        velocity_share,
        noise_position,
        noise_cross,
        variance * (1.0 - velocity_share**2),
    )
