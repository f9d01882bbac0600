"""The target filter: constant velocity with adaptive noise, over everybody's sightings, weighted by their covariances.

Vehicles share raw sightings, not estimates, so that nothing is counted twice. What is believed is a fold over the
sightings in order of time: a late one is put where it belongs and what came after it is taken in again, so that all
vehicles believe the same once they have heard the same, whatever the order. docs/target.md says why this filter.
"""

from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from math import exp, inf, sqrt

import msgspec
from msgspec.structs import replace

from estimation.filters.planar import (
    Drift,
    Innovation,
    Motion,
    Spread,
    carried,
    corrected,
)
from estimation.settings import TargetFilterSettings
from estimation.state import STEP_DIGITS, Sighting, TargetEstimate

OUT_OF_SIGHT_S = 1.0
"""A target that nobody has seen for longer may have turned or stopped since."""
HISTORY_MAX = 256
"""So many sightings are kept at most, however often somebody sees the target: a late one costs no more than they."""
_STRETCH_S, _STRETCH_MAX = 0.05, 32
"""Of the beliefs one in so long, or in so many sightings, is kept: a late one finds a belief from shortly before it."""

_LEANING_S = 0.5
_CLIP_SIGMA = 3.0
_CERTAIN, _CERTAIN_AGAIN = 20.0, 16.0
"""Of the lean, chi-squared with two degrees of freedom: exceeded by chance in one of 20 000, or of 3000 for a target
that has turned before and is likely to do it again."""
_ONSET_S, _LIVELY_S, _TURNS_AGAIN_S = 0.5, 8.0, 40.0


class _Lean(msgspec.Struct, frozen=True):
    """How sightings lean to one side of the belief: a fading sum of normalised innovations, and its variance."""

    x: float = 0.0
    y: float = 0.0
    variance: float = 0.0

    @property
    def squared(self) -> float:
        """The sum, normalised and squared; little is known from a sighting or two."""
        return (self.x**2 + self.y**2) / self.variance if self.variance > 1.5 else 0.0

    def after(self, step_s: float, innovation: Innovation) -> "_Lean":
        kept, squared = exp(-step_s / _LEANING_S), innovation.squared
        share = 1.0 if squared <= _CLIP_SIGMA**2 else _CLIP_SIGMA / sqrt(squared)
        return _Lean(
            kept * self.x + share * innovation.x,
            kept * self.y + share * innovation.y,
            kept * kept * self.variance + 1.0,
        )


class _Belief(msgspec.Struct, frozen=True):
    """What is believed once a sighting was taken in or `refused`; importance and threat are the last told.

    `accepted_s` is when the last one was believed, `doubted_s` since when none is, `began_s` when the belief began,
    `turned_s` when the target was last found to manoeuvre, `resets` how often it began anew once confirmed.
    """

    sighting: Sighting
    motion: Motion
    lean: _Lean
    accepted_s: float
    doubted_s: float
    began_s: float
    importance: float
    threat: float
    turned_s: float = -inf
    resets: int = 0
    refused: bool = False


class _Stretch:
    """Sightings one after the other, and what was believed before the first of them (None: nothing yet)."""

    __slots__ = ("before", "from_s", "refused", "sightings")

    def __init__(self, before: _Belief | None, first: Sighting) -> None:
        self.before = before
        self.from_s = first.time_s
        self.sightings = [first]
        self.refused = 0


class TargetFilter:
    """Estimates the target's position and velocity from the sightings of all vehicles.

    `refused` counts sightings - one that is believed after all, once others have come late, no more - `late` those put
    in among others, `resets` how often a belief that was more than a first sighting began anew.
    """

    def __init__(self, settings: TargetFilterSettings) -> None:
        self._settings = settings
        self._belief: _Belief | None = None
        self._stretches: list[_Stretch] = []
        self._kept = 0
        self._forgotten_s = -inf
        self.refused = 0
        self.late = 0
        self.resets = 0

    def sight(self, *sightings: Sighting) -> None:
        """Take in sightings from any sensors, in any order; outliers, repeats and those too late are refused.

        Several at once cost less than one by one: what is newer than they are is taken in again once.
        """
        fresh = self._fresh(sightings)
        if not fresh:
            return
        resets = 0 if self._belief is None else self._belief.resets
        if self._belief is not None and fresh[0].time_s < self._belief.sighting.time_s:
            fresh = self._put_among(fresh)
        for each in fresh:
            belief = self._take(each)
        self.resets += max(belief.resets - resets, 0)
        self._forget(fresh[-1].time_s)

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the estimate at `now_s`; None if there is none, or the newest sighting behind it is stale."""
        belief = self._belief
        if belief is None or now_s - belief.accepted_s > self._settings.stale_after_s:
            return None
        motion = self._carried(belief, max(now_s, belief.motion.time_s))
        return TargetEstimate(
            motion.time_s, motion.mean, motion.covariance, belief.accepted_s, belief.importance, belief.threat
        )

    @property
    def sighted_s(self) -> float:
        """Time of the newest sighting that was believed, 0 before there is any."""
        return 0.0 if self._belief is None else self._belief.accepted_s

    def _put_among(self, fresh: list[Sighting]) -> list[Sighting]:
        """Take back the stretches from the first of these on, and return all that is to be taken in again, in order."""
        place = max(bisect_right(self._stretches, fresh[0].time_s, key=_begin_of) - 1, 0)
        back = self._stretches[place:]
        del self._stretches[place:]
        newer = [sighting for stretch in back for sighting in stretch.sightings]
        self.late += sum(each.time_s < newer[-1].time_s for each in fresh)
        self.refused -= sum(stretch.refused for stretch in back)
        self._kept -= len(newer)
        self._belief = back[0].before
        return sorted([*newer, *fresh], key=_when)

    def _fresh(self, sightings: Sequence[Sighting]) -> list[Sighting]:
        """Return what is not too late, in order of time; repeats of what is newest are left to be found."""
        newest_s = -inf if self._belief is None else self._belief.sighting.time_s
        from_s = max(newest_s - self._settings.late_max_s, self._forgotten_s)
        fresh = [
            each
            for each in sorted(sightings, key=_when)
            if each.time_s >= newest_s or (each.time_s >= from_s and not self._is_repeat(each))
        ]
        self.refused += len(sightings) - len(fresh)
        return fresh

    def _is_repeat(self, sighting: Sighting) -> bool:
        for stretch in reversed(self._stretches):
            if stretch.from_s <= sighting.time_s and sighting in stretch.sightings:
                return True
            if stretch.from_s < sighting.time_s:
                return False
        return False

    def _take(self, sighting: Sighting) -> _Belief:
        """Take in a sighting that is the newest so far unless it is a repeat, and return what is believed then."""
        before, last = self._belief, self._stretches[-1] if self._stretches else None
        if before is not None and sighting.time_s == before.sighting.time_s and self._is_repeat(sighting):
            self.refused += 1
            return before
        if last is None or sighting.time_s - last.from_s >= _STRETCH_S or len(last.sightings) >= _STRETCH_MAX:
            last = _Stretch(before, sighting)
            self._stretches.append(last)
        else:
            last.sightings.append(sighting)
        self._kept += 1
        self._belief = belief = self._started(sighting) if before is None else self._after(before, sighting)
        last.refused += belief.refused
        self.refused += belief.refused
        return belief

    def _after(self, last: _Belief, sighting: Sighting) -> _Belief:
        """Return what is believed after a sighting that is the newest so far."""
        if last.refused and (other := self._outvoted(last, sighting)) is not None:
            return other
        belief = self._corrected(last, sighting)
        if belief.refused:
            # Every sensor has disagreed with the belief for a while: the belief is what is wrong.
            too_long = sighting.time_s - belief.doubted_s > self._settings.gate_timeout_s
            if too_long:
                return replace(self._started(sighting), resets=last.resets + 1)
            return belief
        leans = belief.lean.squared
        if leans <= _CERTAIN_AGAIN:
            return belief
        turns_again = sighting.time_s - belief.turned_s < _TURNS_AGAIN_S
        return self._turned(belief) if turns_again or leans > _CERTAIN else belief

    def _outvoted(self, last: _Belief, sighting: Sighting) -> _Belief | None:
        """Return what to believe when nobody has confirmed a first sighting and the last two agree better."""
        if last.accepted_s != last.began_s:
            return None
        first = self._started(last.sighting)
        if self._off(first, sighting) >= self._off(last, sighting):
            return None
        other = self._corrected(first, sighting)
        return None if other.refused else replace(other, resets=last.resets)

    def _off(self, belief: _Belief, sighting: Sighting) -> float:
        """Return how far a sighting is off a belief, squared and normalised."""
        prior = self._carried(belief, sighting.time_s)
        return corrected(prior, sighting.position_m, sighting.covariance_m2)[1].squared

    def _started(self, sighting: Sighting) -> _Belief:
        (xx, xy, yy), speed = sighting.covariance_m2, self._settings.velocity_prior_m_s**2
        spread = Spread(xx, xy, 0.0, 0.0, yy, 0.0, 0.0, speed, 0.0, speed)
        time_s = sighting.time_s
        motion = Motion(time_s, *sighting.position_m, 0.0, 0.0, spread)
        return _Belief(sighting, motion, _Lean(), time_s, inf, time_s, sighting.importance, sighting.threat)

    def _corrected(self, last: _Belief, sighting: Sighting) -> _Belief:
        """Return the belief after a sighting; one farther off than noise explains counts for less, or is refused."""
        prior = self._carried(last, sighting.time_s)
        motion, innovation = corrected(prior, sighting.position_m, sighting.covariance_m2)
        unseen_s, squared = sighting.time_s - last.accepted_s, innovation.squared
        if not squared <= _CLIP_SIGMA**2:  # NaN is no innovation either
            # What turns comes this far off the belief in the meantime.
            reach_m = self._settings.velocity_prior_m_s * min(unseen_s, OUT_OF_SIGHT_S)
            _, within_reach = corrected(prior, sighting.position_m, _widened(sighting, 1.0, reach_m**2))
            if not within_reach.squared <= 2.0 * self._settings.gate_sigma**2:
                doubted_s = min(last.doubted_s, sighting.time_s)
                return replace(last, sighting=sighting, motion=prior, doubted_s=doubted_s, refused=True)
            excess = sqrt(squared) / _CLIP_SIGMA
            motion, _ = corrected(prior, sighting.position_m, _widened(sighting, excess, 0.0))
        return _Belief(
            sighting,
            motion,
            last.lean.after(unseen_s, innovation),
            sighting.time_s,
            inf,
            last.began_s,
            sighting.importance,
            sighting.threat,
            last.turned_s,
            last.resets,
        )

    def _turned(self, belief: _Belief) -> _Belief:
        """Return the belief had the velocity been in doubt since shortly before: about then it changed.

        One that began after the last belief that is kept stays: its velocity is in doubt already.
        """
        turned_s, doubt = belief.sighting.time_s, self._settings.manoeuvre_speed_m_s**2
        since = [each for each in self._stretches if each.before is not None and each.before.began_s == belief.began_s]
        since = since[min(bisect_right(since, turned_s - _ONSET_S, key=_begin_of), len(since) - 1) :]
        if not since or (before := since[0].before) is None:
            return belief
        spread = before.motion.spread
        spread = replace(spread, uu=spread.uu + doubt, vv=spread.vv + doubt)
        motion = replace(before.motion, spread=spread)
        again = replace(before, motion=motion, lean=_Lean(), turned_s=turned_s)
        for stretch in since:
            for sighting in stretch.sightings:
                again = self._corrected(again, sighting)
        return replace(again, lean=_Lean())

    def _carried(self, belief: _Belief, to_s: float) -> Motion:
        """Return the belief later: seen just now it moves straight on, out of sight it comes to rest by and by."""
        motion, settings = belief.motion, self._settings
        if to_s <= motion.time_s:
            return motion
        out_of_sight_s = max(belief.accepted_s + OUT_OF_SIGHT_S, motion.time_s)
        step_s = round(min(to_s, out_of_sight_s) - motion.time_s, STEP_DIGITS)
        if step_s > 0.0:
            # What has turned turns again. In whole hundredths, so that the matrices of each are computed once.
            lively = round(exp(min(belief.turned_s - motion.time_s, 0.0) / _LIVELY_S), 2)
            density = settings.acceleration_noise_m_s2**2 + lively * settings.manoeuvre_acceleration_m_s2**2
            motion = carried(motion, min(to_s, out_of_sight_s), _straight(density, step_s))
        step_s = round(to_s - out_of_sight_s, STEP_DIGITS)
        if step_s > 0.0:
            motion = carried(motion, to_s, _wandering(settings.velocity_prior_m_s, settings.coast_s, step_s))
        return motion

    def _forget(self, newest_s: float) -> None:
        # One belief older than the window stays: a late sighting needs something to start from, and so does a turn.
        before_s, stretches = newest_s - self._settings.late_max_s - _ONSET_S, self._stretches
        while len(stretches) > 1 and (stretches[1].from_s < before_s or self._kept > HISTORY_MAX):
            self._kept -= len(stretches[0].sightings)
            del stretches[0]
            self._forgotten_s = stretches[0].from_s


def _when(sighting: Sighting) -> float:
    return sighting.time_s


def _begin_of(stretch: _Stretch) -> float:
    return stretch.from_s


def _widened(sighting: Sighting, excess: float, reach_m2: float) -> tuple[float, float, float]:
    """Return a sighting's covariance, `excess` times as large, and farther out in every direction."""
    xx, xy, yy = sighting.covariance_m2
    return xx * excess + reach_m2, xy * excess, yy * excess + reach_m2


@lru_cache(maxsize=4096)
def _straight(density: float, step_s: float) -> Drift:
    """Return a step of constant velocity under white acceleration."""
    return Drift(step_s, 1.0, density * step_s**3 / 3.0, density * step_s**2 / 2.0, density * step_s)


@lru_cache(maxsize=1024)
def _wandering(speed_m_s: float, lasting_s: float, step_s: float) -> Drift:
    """Return a step of a velocity that is forgotten: an Ornstein-Uhlenbeck process.

    Its standard deviation tends to `speed_m_s`; what is known of it lasts for about `lasting_s`.
    """
    kept = exp(-step_s / lasting_s)
    variance = speed_m_s**2
    place = variance * lasting_s**2 * (2.0 * step_s / lasting_s - 3.0 + 4.0 * kept - kept**2)
    mixed = variance * lasting_s * (1.0 - kept) ** 2
    return Drift(lasting_s * (1.0 - kept), kept, place, mixed, variance * (1.0 - kept**2))
