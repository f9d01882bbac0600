"""The target filter: constant velocity with adaptive noise, over everybody's sightings, weighted by their covariances.

Vehicles share raw sightings, not estimates, so that nothing is counted twice. What is believed is a fold over the
sightings in order of time: a late one is put where it belongs and what came after it is taken in again, so that all
vehicles believe the same once they have heard the same, whatever the order. docs/target.md says why this filter.
"""

from bisect import bisect_right
from functools import lru_cache
from itertools import takewhile
from math import exp, inf, sqrt
from typing import NamedTuple

import msgspec
import numpy as np

from estimation.kalman import STEP_DIGITS, Belief, correct, predict
from estimation.settings import TargetFilterSettings
from estimation.state import POSITION, VELOCITY, Sighting, TargetEstimate, Vector

OUT_OF_SIGHT_S = 1.0
"""A target that nobody has seen for longer may have turned or stopped since."""
HISTORY_MAX = 256
"""So many sightings are kept at most, however often somebody sees the target: a late one costs no more than they."""

_NO_GAIN, _NO_INPUT = np.zeros((4, 1)), np.zeros(1)
_LEANING_S = 0.5
_CLIP_SIGMA = 3.0
_WITHIN_CLIP = _CLIP_SIGMA / sqrt(2.0)
_CERTAIN = 16.0
"""Of the lean, chi-squared with two degrees of freedom: exceeded by chance in one of 3000."""
_ONSET_S, _TURNS_AGAIN_S = 0.5, 8.0


class _Lean(NamedTuple):
    """How sightings lean to one side of the belief: a fading sum of normalised innovations, and its variance."""

    x: float = 0.0
    y: float = 0.0
    variance: float = 0.0

    @property
    def squared(self) -> float:
        """The sum, normalised and squared; little is known from a sighting or two."""
        return (self.x**2 + self.y**2) / self.variance if self.variance > 1.5 else 0.0

    def after(self, step_s: float, innovation: Vector) -> "_Lean":
        kept = exp(-step_s / _LEANING_S)
        e_x, e_y = innovation.tolist()
        share = min(1.0, _CLIP_SIGMA / max(sqrt(e_x**2 + e_y**2), _CLIP_SIGMA))
        return _Lean(kept * self.x + share * e_x, kept * self.y + share * e_y, kept**2 * self.variance + 1.0)


class _Taken(msgspec.Struct, frozen=True):
    """A sighting, and what is believed once it was taken in or `refused`; importance and threat are the last told.

    `accepted_s` is when the last one was believed, `doubted_s` since when none is, `began_s` when the belief began,
    `turned_s` when the target was last found to manoeuvre.
    """

    sighting: Sighting
    belief: Belief
    lean: _Lean
    accepted_s: float
    doubted_s: float
    began_s: float
    importance: float
    threat: float
    turned_s: float = -inf
    refused: bool = False


class TargetFilter:
    """Estimates the target's position and velocity from the sightings of all vehicles.

    `refused` counts sightings, `late` those put in among others, `resets` how often the belief began anew.
    """

    def __init__(self, settings: TargetFilterSettings) -> None:
        self._settings = settings
        self._taken: list[_Taken] = []
        self._forgotten_s = -inf
        self.refused = 0
        self.late = 0
        self.resets = 0

    def sight(self, sighting: Sighting) -> None:
        """Take in a sighting from any sensor, in any order; outliers, repeats and those too late are refused."""
        newest = self._taken[-1] if self._taken else None
        if newest is None or sighting.time_s > newest.sighting.time_s:
            self._take_newest(newest, sighting)
            return
        place = bisect_right(self._taken, sighting.time_s, key=_time_of)
        too_late = sighting.time_s < newest.sighting.time_s - self._settings.late_max_s
        if too_late or sighting.time_s < self._forgotten_s or self._is_repeat(sighting, place):
            self.refused += 1
            return
        newer = self._taken[place:]
        del self._taken[place:]
        self.late += bool(newer)
        for each in (sighting, *(taken.sighting for taken in newer)):
            self._taken.append(self._after(each))
        self.refused += self._taken[place].refused
        self.resets += self._taken[-1].began_s > max(newest.began_s, self._taken[0].began_s)
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

    def _take_newest(self, newest: _Taken | None, sighting: Sighting) -> None:
        taken = self._after(sighting)
        self._taken.append(taken)
        self.refused += taken.refused
        self.resets += newest is not None and taken.began_s > newest.began_s
        self._forget()

    def _is_repeat(self, sighting: Sighting, place: int) -> bool:
        before = takewhile(lambda taken: taken.sighting.time_s == sighting.time_s, reversed(self._taken[:place]))
        return any(taken.sighting == sighting for taken in before)

    def _after(self, sighting: Sighting) -> _Taken:
        """Return what is believed after a sighting that is the newest so far."""
        if not self._taken:
            return self._started(sighting)
        last = self._taken[-1]
        taken = self._corrected(last, sighting)
        if taken.refused:
            # Every sensor has disagreed with the belief for a while: the belief is what is wrong.
            too_long = sighting.time_s - taken.doubted_s > self._settings.gate_timeout_s
            return self._started(sighting) if too_long else taken
        return self._turned(taken) if taken.lean.squared > _CERTAIN else taken

    def _started(self, sighting: Sighting) -> _Taken:
        covariance = np.zeros((4, 4))
        covariance[POSITION, POSITION] = _noise_of(sighting)
        covariance[VELOCITY, VELOCITY] = np.eye(2) * self._settings.velocity_prior_m_s**2
        belief = Belief(sighting.time_s, np.array([*sighting.position_m, 0.0, 0.0]), covariance)
        time_s = sighting.time_s
        return _Taken(sighting, belief, _Lean(), time_s, inf, time_s, sighting.importance, sighting.threat)

    def _corrected(self, last: _Taken, sighting: Sighting) -> _Taken:
        """Return the belief after a sighting; one farther off than noise explains counts for less, or is refused."""
        prior = self._carried(last, sighting.time_s)
        position, noise = np.array(sighting.position_m), _noise_of(sighting)
        result = correct(prior, position, noise, _WITHIN_CLIP)
        unseen_s = sighting.time_s - last.accepted_s
        if not result.accepted:
            # What turns comes this far off the belief in the meantime.
            reach_m = self._settings.velocity_prior_m_s * min(unseen_s, OUT_OF_SIGHT_S)
            if not correct(prior, position, noise + np.eye(2) * reach_m**2, self._settings.gate_sigma).accepted:
                doubted_s = min(last.doubted_s, sighting.time_s)
                return msgspec.structs.replace(last, sighting=sighting, belief=prior, doubted_s=doubted_s, refused=True)
            excess = sqrt(result.innovation_squared) / _CLIP_SIGMA
            result = msgspec.structs.replace(
                correct(prior, position, noise * excess, inf), innovation=result.innovation
            )
        return _Taken(
            sighting,
            result.belief,
            last.lean.after(unseen_s, result.innovation),
            sighting.time_s,
            inf,
            last.began_s,
            sighting.importance,
            sighting.threat,
            last.turned_s,
        )

    def _turned(self, taken: _Taken) -> _Taken:
        """Return the belief had the velocity been in doubt since shortly before: about then it changed."""
        onset_s = taken.sighting.time_s - _ONSET_S
        since = [each for each in self._taken if each.began_s == taken.began_s]
        first = max(bisect_right(since, onset_s, key=_time_of) - 1, 0)
        before = since[first]
        covariance = before.belief.covariance.copy()
        covariance[VELOCITY, VELOCITY] += np.eye(2) * self._settings.manoeuvre_speed_m_s**2
        belief = Belief(before.belief.time_s, before.belief.mean, covariance)
        again = msgspec.structs.replace(before, belief=belief, lean=_Lean(), turned_s=taken.sighting.time_s)
        for each in (*since[first + 1 :], taken):
            again = self._corrected(again, each.sighting)
        return msgspec.structs.replace(again, lean=_Lean())

    def _carried(self, taken: _Taken, to_s: float) -> Belief:
        """Return the belief later: seen just now it moves straight on, out of sight it comes to rest by and by."""
        belief, settings = taken.belief, self._settings
        out_of_sight_s = max(taken.accepted_s + OUT_OF_SIGHT_S, belief.time_s)
        step_s = round(min(to_s, out_of_sight_s) - belief.time_s, STEP_DIGITS)
        if step_s > 0.0:
            # What has turned turns again. In whole hundredths, so that the matrices of each are computed once.
            lively = round(exp(min(taken.turned_s - belief.time_s, 0.0) / _TURNS_AGAIN_S), 2)
            density = settings.acceleration_noise_m_s2**2 + lively * settings.manoeuvre_acceleration_m_s2**2
            transition, noise = _straight(density, step_s)
            belief = predict(belief, min(to_s, out_of_sight_s), transition, noise, _NO_GAIN, _NO_INPUT)
        step_s = round(to_s - out_of_sight_s, STEP_DIGITS)
        if step_s > 0.0:
            transition, noise = _wandering(settings.velocity_prior_m_s, settings.coast_s, step_s)
            belief = predict(belief, to_s, transition, noise, _NO_GAIN, _NO_INPUT)
        return belief

    def _forget(self) -> None:
        # One belief older than the window stays: a late sighting needs something to start from, and so does a turn.
        before_s = self._taken[-1].sighting.time_s - self._settings.late_max_s - _ONSET_S
        while len(self._taken) > 1 and (self._taken[1].sighting.time_s < before_s or len(self._taken) > HISTORY_MAX):
            del self._taken[0]
            self._forgotten_s = self._taken[0].sighting.time_s


def _time_of(taken: _Taken) -> float:
    return taken.sighting.time_s


def _noise_of(sighting: Sighting) -> Vector:
    xx, xy, yy = sighting.covariance_m2
    return np.array([[xx, xy], [xy, yy]])


@lru_cache(maxsize=4096)
def _straight(density: float, step_s: float) -> tuple[Vector, Vector]:
    """Return transition (4, 4) of constant velocity, and process noise (4, 4) under white acceleration."""
    transition = np.eye(4)
    transition[POSITION, VELOCITY] = np.eye(2) * step_s
    return transition, _isotropic(density * step_s**3 / 3.0, density * step_s**2 / 2.0, density * step_s)


@lru_cache(maxsize=1024)
def _wandering(speed_m_s: float, lasting_s: float, step_s: float) -> tuple[Vector, Vector]:
    """Return transition (4, 4) and process noise (4, 4) of a velocity that is forgotten: an Ornstein-Uhlenbeck process.

    Its standard deviation tends to `speed_m_s`; what is known of it lasts for about `lasting_s`.
    """
    kept = exp(-step_s / lasting_s)
    transition = np.eye(4)
    transition[POSITION, VELOCITY] = np.eye(2) * lasting_s * (1.0 - kept)
    transition[VELOCITY, VELOCITY] = np.eye(2) * kept
    variance = speed_m_s**2
    place = variance * lasting_s**2 * (2.0 * step_s / lasting_s - 3.0 + 4.0 * kept - kept**2)
    return transition, _isotropic(place, variance * lasting_s * (1.0 - kept) ** 2, variance * (1.0 - kept**2))


def _isotropic(place: float, mixed: float, velocity: float) -> Vector:
    noise = np.zeros((4, 4))
    noise[POSITION, POSITION] = np.eye(2) * place
    noise[POSITION, VELOCITY] = noise[VELOCITY, POSITION] = np.eye(2) * mixed
    noise[VELOCITY, VELOCITY] = np.eye(2) * velocity
    return noise
