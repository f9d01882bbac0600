"""The target filter: constant velocity with adaptive noise, over everybody's sightings, weighted by their covariances.

Vehicles share raw sightings, not estimates, so that nothing is counted twice. What is believed is a fold over the
sightings in order of time: a late one is put where it belongs and what came after it is taken in again, so that all
vehicles believe the same once they have heard the same, whatever the order. docs/target.md says why this filter.
"""

from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from math import exp, inf, sqrt
from typing import NamedTuple

import msgspec

from estimation.planar import Drift, Innovation, Motion, Spread, carried, corrected
from estimation.settings import TargetFilterSettings
from estimation.state import STEP_DIGITS, Sighting, TargetEstimate

OUT_OF_SIGHT_S = 1.0
"""A target that nobody has seen for longer may have turned or stopped since."""
HISTORY_MAX = 256
"""So many sightings are kept at most, however often somebody sees the target: a late one costs no more than they."""

_LEANING_S = 0.5
_CLIP_SIGMA = 3.0
_CERTAIN, _CERTAIN_AGAIN = 20.0, 16.0
"""Of the lean, chi-squared with two degrees of freedom: exceeded by chance in one of 20 000, or of 3000 for a target
that has turned before and is likely to do it again."""
_ONSET_S, _LIVELY_S, _TURNS_AGAIN_S = 0.5, 8.0, 40.0


class _Lean(NamedTuple):
    """How sightings lean to one side of the belief: a fading sum of normalised innovations, and its variance."""

    x: float = 0.0
    y: float = 0.0
    variance: float = 0.0

    @property
    def squared(self) -> float:
        """The sum, normalised and squared; little is known from a sighting or two."""
        return (self.x**2 + self.y**2) / self.variance if self.variance > 1.5 else 0.0

    def after(self, step_s: float, innovation: Innovation) -> "_Lean":
        x, y, variance = self
        kept, squared = exp(-step_s / _LEANING_S), innovation.squared
        share = 1.0 if squared <= _CLIP_SIGMA**2 else _CLIP_SIGMA / sqrt(squared)
        return _Lean(kept * x + share * innovation.x, kept * y + share * innovation.y, kept * kept * variance + 1.0)


class _Taken(msgspec.Struct, frozen=True):
    """A sighting, and what is believed once it was taken in or `refused`; importance and threat are the last told.

    `accepted_s` is when the last one was believed, `doubted_s` since when none is, `began_s` when the belief began,
    `turned_s` when the target was last found to manoeuvre, `resets` how often it began anew once confirmed.
    """

    sighting: Sighting
    belief: Motion
    lean: _Lean
    accepted_s: float
    doubted_s: float
    began_s: float
    importance: float
    threat: float
    turned_s: float = -inf
    resets: int = 0
    refused: bool = False


class TargetFilter:
    """Estimates the target's position and velocity from the sightings of all vehicles.

    `refused` counts sightings - one that is believed after all, once others have come late, no more - `late` those put
    in among others, `resets` how often a belief that was more than a first sighting began anew.
    """

    def __init__(self, settings: TargetFilterSettings) -> None:
        self._settings = settings
        self._taken: list[_Taken] = []
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
        resets = self._taken[-1].resets if self._taken else 0
        if self._taken and fresh[0].time_s < self._taken[-1].sighting.time_s:
            fresh = self._put_among(fresh)
        for each in fresh:
            taken = self._after(each)
            self._taken.append(taken)
            self.refused += taken.refused
        self.resets += max(self._taken[-1].resets - resets, 0)
        self._forget()

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the estimate at `now_s`; None if there is none, or the newest sighting behind it is stale."""
        if not self._taken:
            return None
        newest = self._taken[-1]
        if now_s - newest.accepted_s > self._settings.stale_after_s:
            return None
        belief = self._carried(newest, max(now_s, newest.belief.time_s))
        return TargetEstimate(
            belief.time_s, belief.mean, belief.covariance, newest.accepted_s, newest.importance, newest.threat
        )

    @property
    def sighted_s(self) -> float:
        """Time of the newest sighting that was believed, 0 before there is any."""
        return self._taken[-1].accepted_s if self._taken else 0.0

    def _put_among(self, fresh: list[Sighting]) -> list[Sighting]:
        """Take back what is newer than the first of these, and return all that is to be taken in again, in order."""
        place = bisect_right(self._taken, fresh[0].time_s, key=_time_of)
        newer = self._taken[place:]
        del self._taken[place:]
        self.late += sum(each.time_s < newer[-1].sighting.time_s for each in fresh)
        self.refused -= sum(taken.refused for taken in newer)
        return sorted([*(taken.sighting for taken in newer), *fresh], key=_when)

    def _fresh(self, sightings: Sequence[Sighting]) -> list[Sighting]:
        """Return what is new and not too late, in order of time."""
        newest_s = self._taken[-1].sighting.time_s if self._taken else -inf
        if len(sightings) == 1 and sightings[0].time_s > newest_s:
            return list(sightings)
        from_s = max(newest_s - self._settings.late_max_s, self._forgotten_s)
        fresh = [
            each
            for each in dict.fromkeys(sorted(sightings, key=_when))
            if each.time_s > newest_s or (each.time_s >= from_s and not self._is_repeat(each))
        ]
        self.refused += len(sightings) - len(fresh)
        return fresh

    def _is_repeat(self, sighting: Sighting) -> bool:
        for index in range(bisect_right(self._taken, sighting.time_s, key=_time_of) - 1, -1, -1):
            before = self._taken[index].sighting
            if before.time_s != sighting.time_s:
                return False
            if before == sighting:
                return True
        return False

    def _after(self, sighting: Sighting) -> _Taken:
        """Return what is believed after a sighting that is the newest so far."""
        if not self._taken:
            return self._started(sighting)
        last = self._taken[-1]
        if last.refused and (other := self._outvoted(last, sighting)) is not None:
            return other
        taken = self._corrected(last, sighting)
        if taken.refused:
            # Every sensor has disagreed with the belief for a while: the belief is what is wrong.
            too_long = sighting.time_s - taken.doubted_s > self._settings.gate_timeout_s
            if too_long:
                return msgspec.structs.replace(self._started(sighting), resets=last.resets + 1)
            return taken
        turns = taken.sighting.time_s - taken.turned_s < _TURNS_AGAIN_S
        certain = _CERTAIN_AGAIN if turns else _CERTAIN
        return self._turned(taken) if taken.lean.squared > certain else taken

    def _outvoted(self, last: _Taken, sighting: Sighting) -> _Taken | None:
        """Return what to believe when nobody has confirmed a first sighting and the last two agree better."""
        if last.accepted_s != last.began_s:
            return None
        first = self._started(last.sighting)
        if self._off(first, sighting) >= self._off(last, sighting):
            return None
        other = self._corrected(first, sighting)
        return None if other.refused else msgspec.structs.replace(other, resets=last.resets)

    def _off(self, taken: _Taken, sighting: Sighting) -> float:
        """Return how far a sighting is off a belief, squared and normalised."""
        prior = self._carried(taken, sighting.time_s)
        return corrected(prior, sighting.position_m, sighting.covariance_m2)[1].squared

    def _started(self, sighting: Sighting) -> _Taken:
        (xx, xy, yy), speed = sighting.covariance_m2, self._settings.velocity_prior_m_s**2
        spread = Spread(xx, xy, 0.0, 0.0, yy, 0.0, 0.0, speed, 0.0, speed)
        time_s = sighting.time_s
        belief = Motion(time_s, *sighting.position_m, 0.0, 0.0, spread)
        return _Taken(sighting, belief, _Lean(), time_s, inf, time_s, sighting.importance, sighting.threat)

    def _corrected(self, last: _Taken, sighting: Sighting) -> _Taken:
        """Return the belief after a sighting; one farther off than noise explains counts for less, or is refused."""
        prior = self._carried(last, sighting.time_s)
        belief, innovation = corrected(prior, sighting.position_m, sighting.covariance_m2)
        unseen_s, squared = sighting.time_s - last.accepted_s, innovation.squared
        if not squared <= _CLIP_SIGMA**2:  # NaN is no innovation either
            # What turns comes this far off the belief in the meantime.
            reach_m = self._settings.velocity_prior_m_s * min(unseen_s, OUT_OF_SIGHT_S)
            _, within_reach = corrected(prior, sighting.position_m, _widened(sighting, 1.0, reach_m**2))
            if not within_reach.squared <= 2.0 * self._settings.gate_sigma**2:
                doubted_s = min(last.doubted_s, sighting.time_s)
                return msgspec.structs.replace(last, sighting=sighting, belief=prior, doubted_s=doubted_s, refused=True)
            excess = sqrt(squared) / _CLIP_SIGMA
            belief, _ = corrected(prior, sighting.position_m, _widened(sighting, excess, 0.0))
        return _Taken(
            sighting,
            belief,
            last.lean.after(unseen_s, innovation),
            sighting.time_s,
            inf,
            last.began_s,
            sighting.importance,
            sighting.threat,
            last.turned_s,
            last.resets,
        )

    def _turned(self, taken: _Taken) -> _Taken:
        """Return the belief had the velocity been in doubt since shortly before: about then it changed."""
        onset_s = taken.sighting.time_s - _ONSET_S
        since = [each for each in self._taken if each.began_s == taken.began_s]
        first = max(bisect_right(since, onset_s, key=_time_of) - 1, 0)
        before = since[first]
        spread, doubt = before.belief.spread, self._settings.manoeuvre_speed_m_s**2
        belief = before.belief._replace(spread=spread._replace(uu=spread.uu + doubt, vv=spread.vv + doubt))
        again = msgspec.structs.replace(before, belief=belief, lean=_Lean(), turned_s=taken.sighting.time_s)
        for each in (*since[first + 1 :], taken):
            again = self._corrected(again, each.sighting)
        return msgspec.structs.replace(again, lean=_Lean())

    def _carried(self, taken: _Taken, to_s: float) -> Motion:
        """Return the belief later: seen just now it moves straight on, out of sight it comes to rest by and by."""
        belief, settings = taken.belief, self._settings
        if to_s <= belief.time_s:
            return belief
        out_of_sight_s = max(taken.accepted_s + OUT_OF_SIGHT_S, belief.time_s)
        step_s = round(min(to_s, out_of_sight_s) - belief.time_s, STEP_DIGITS)
        if step_s > 0.0:
            # What has turned turns again. In whole hundredths, so that the matrices of each are computed once.
            lively = round(exp(min(taken.turned_s - belief.time_s, 0.0) / _LIVELY_S), 2)
            density = settings.acceleration_noise_m_s2**2 + lively * settings.manoeuvre_acceleration_m_s2**2
            belief = carried(belief, min(to_s, out_of_sight_s), _straight(density, step_s))
        step_s = round(to_s - out_of_sight_s, STEP_DIGITS)
        if step_s > 0.0:
            belief = carried(belief, to_s, _wandering(settings.velocity_prior_m_s, settings.coast_s, step_s))
        return belief

    def _forget(self) -> None:
        # One belief older than the window stays: a late sighting needs something to start from, and so does a turn.
        before_s = self._taken[-1].sighting.time_s - self._settings.late_max_s - _ONSET_S
        while len(self._taken) > 1 and (self._taken[1].sighting.time_s < before_s or len(self._taken) > HISTORY_MAX):
            del self._taken[0]
            self._forgotten_s = self._taken[0].sighting.time_s


def _when(sighting: Sighting) -> float:
    return sighting.time_s


def _time_of(taken: _Taken) -> float:
    return taken.sighting.time_s


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
