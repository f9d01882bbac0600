"""The target filter: constant velocity, over everybody's sightings, weighted by their covariances.

Vehicles share raw sightings, not estimates, so that nothing is counted twice. A late sighting is put where it belongs
in time, and what came after it is taken in again.
"""

from bisect import bisect_right
from functools import lru_cache
from itertools import takewhile
from math import inf

import msgspec
import numpy as np

from estimation.kalman import STEP_DIGITS, Belief, correct, predict
from estimation.settings import TargetFilterSettings
from estimation.state import POSITION, VELOCITY, Sighting, TargetEstimate, Vector

_NO_GAIN, _NO_INPUT = np.zeros((4, 1)), np.zeros(1)


class _Taken(msgspec.Struct, frozen=True):
    """A sighting, and the belief once it was taken in."""

    sighting: Sighting
    belief: Belief


class TargetFilter:
    """Estimates the target's position and velocity from the sightings of all vehicles."""

    def __init__(self, settings: TargetFilterSettings) -> None:
        self._settings = settings
        self._taken: list[_Taken] = []
        self._accepted_s = 0.0
        self._doubted_s = inf
        self.refused = 0
        self.late = 0
        self.resets = 0

    def sight(self, sighting: Sighting) -> None:
        """Take in a sighting from any sensor, in any order; outliers, repeats and those too late are refused."""
        place = bisect_right(self._taken, sighting.time_s, key=_time_of)
        if self._is_repeat(sighting, place):
            self.refused += 1
            return
        newer = self._taken[place:]
        del self._taken[place:]
        if newer and sighting.time_s < newer[-1].sighting.time_s - self._settings.late_max_s:
            self._taken += newer
            self.refused += 1
            return
        self.late += bool(newer)
        self._take(sighting)
        for taken in newer:
            self._take(taken.sighting)
        self._forget(self._taken[-1].sighting.time_s - self._settings.late_max_s)

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Return the estimate at `now_s`; None if there is none, or the newest sighting behind it is stale."""
        if not self._taken:
            return None
        newest = self._taken[-1]
        if now_s - self._accepted_s > self._settings.stale_after_s:
            return None
        belief = self._carried(newest.belief, max(now_s, newest.belief.time_s))
        return TargetEstimate(
            belief.time_s,
            belief.mean,
            belief.covariance,
            self._accepted_s,
            newest.sighting.importance,
            newest.sighting.threat,
        )

    @property
    def sighted_s(self) -> float:
        """Time of the newest sighting that was believed, 0 before there is any."""
        return self._accepted_s

    def _is_repeat(self, sighting: Sighting, place: int) -> bool:
        before = takewhile(lambda taken: taken.sighting.time_s == sighting.time_s, reversed(self._taken[:place]))
        return any(taken.sighting == sighting for taken in before)

    def _take(self, sighting: Sighting) -> None:
        position = np.array(sighting.position_m)
        noise = _noise_of(sighting)
        if not self._taken:
            self._start(sighting, position, noise)
            return
        prior = self._carried(self._taken[-1].belief, sighting.time_s)
        result = correct(prior, position, noise, self._settings.gate_sigma)
        self._doubted_s = inf if result.accepted else min(self._doubted_s, sighting.time_s)
        if sighting.time_s - self._doubted_s > self._settings.gate_timeout_s:
            # Every sensor has disagreed with the belief for a while: the belief is what is wrong.
            self.resets += 1
            self._start(sighting, position, noise)
            return
        if not result.accepted:
            self.refused += 1
            return
        self._accepted_s = max(self._accepted_s, sighting.time_s)
        self._taken.append(_Taken(sighting, result.belief))

    def _start(self, sighting: Sighting, position: Vector, noise: Vector) -> None:
        covariance = np.zeros((4, 4))
        covariance[POSITION, POSITION] = noise
        covariance[VELOCITY, VELOCITY] = np.eye(2) * self._settings.velocity_prior_m_s**2
        mean = np.concatenate([position, np.zeros(2)])
        self._accepted_s = sighting.time_s
        self._doubted_s = inf
        self._taken = [_Taken(sighting, Belief(sighting.time_s, mean, covariance))]

    def _carried(self, belief: Belief, to_s: float) -> Belief:
        step_s = round(to_s - belief.time_s, STEP_DIGITS)
        if step_s <= 0.0:
            return belief
        transition, noise = _process(self._settings.acceleration_noise_m_s2, step_s)
        return predict(belief, to_s, transition, noise, _NO_GAIN, _NO_INPUT)

    def _forget(self, before_s: float) -> None:
        # One belief older than the window stays: a late sighting needs something to start from.
        while len(self._taken) > 1 and self._taken[1].sighting.time_s < before_s:
            del self._taken[0]


def _time_of(taken: _Taken) -> float:
    return taken.sighting.time_s


def _noise_of(sighting: Sighting) -> Vector:
    xx, xy, yy = sighting.covariance_m2
    return np.array([[xx, xy], [xy, yy]])


@lru_cache(maxsize=1024)
def _process(acceleration_noise_m_s2: float, step_s: float) -> tuple[Vector, Vector]:
    """Return transition (4, 4) and process noise (4, 4) of constant velocity under white acceleration."""
    transition = np.eye(4)
    transition[POSITION, VELOCITY] = np.eye(2) * step_s
    noise = np.zeros((4, 4))
    density = acceleration_noise_m_s2**2
    noise[POSITION, POSITION] = np.eye(2) * density * step_s**3 / 3.0
    noise[POSITION, VELOCITY] = noise[VELOCITY, POSITION] = np.eye(2) * density * step_s**2 / 2.0
    noise[VELOCITY, VELOCITY] = np.eye(2) * density * step_s
    return transition, noise
