"""The environment of the vehicles: the true target, the sensors that see it, and the parameters of the wind."""

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import cos, hypot, pi, sin
from operator import itemgetter
from typing import NamedTuple, Protocol

import numpy as np

from estimation.state import Sighting, Vector
from sitl.draws import AHEAD, normals

Pair = tuple[float, float]


class Leg(NamedTuple):
    """A leg of a target's path: its end, the speed, and the time that the target stays there."""

    to_m: Pair
    speed_m_s: float
    pause_s: float = 0.0


class _Piece(NamedTuple):
    """An interval of constant velocity: its begin, the position then, and the velocity."""

    begin_s: float
    from_m: Pair
    velocity_m_s: Pair


@dataclass(frozen=True)
class TargetMotion:
    """The motion of a target from its position at mission time 0: at constant velocity, or along legs if there are any.

    It follows its legs `rounds` times, and stays at the end of the last one.
    """

    start_m: Pair
    velocity_m_s: Pair = (0.0, 0.0)
    legs: tuple[Leg, ...] = ()
    rounds: int = 1

    def position_m(self, mission_time_s: float) -> Pair:
        """Return the target's position; before the mission starts the target waits."""
        begin_s, (x, y), (x_rate, y_rate) = self._piece(mission_time_s)
        since_s = max(mission_time_s, 0.0) - begin_s
        return x + x_rate * since_s, y + y_rate * since_s

    def velocity_at_m_s(self, mission_time_s: float) -> Pair:
        """Return the velocity at a mission time, before the start that of the start."""
        return self._piece(mission_time_s).velocity_m_s

    def over(self, mission_time_s: Vector) -> tuple[Vector, Vector]:
        """Return the positions and velocities (T, 2) over mission time (T,)."""
        times_s = mission_time_s.tolist()
        positions_m, velocities_m_s = map(self.position_m, times_s), map(self.velocity_at_m_s, times_s)
        return np.array([*positions_m]).reshape(-1, 2), np.array([*velocities_m_s]).reshape(-1, 2)

    @property
    def speed_max_m_s(self) -> float:
        """The highest speed of the whole motion."""
        return max(hypot(*piece.velocity_m_s) for piece in self._pieces)

    def path_m(self, until_s: float, points: int) -> list[tuple[float, Pair]]:
        """Return times and positions along the path, evenly in time, and its corners; one if it does not move."""
        if self.speed_max_m_s == 0.0:
            return [(0.0, self.start_m)]
        corners_s = {piece.begin_s for piece in self._pieces if piece.begin_s <= until_s}
        return [
            (at_s, self.position_m(at_s)) for at_s in sorted({*np.linspace(0.0, until_s, points).tolist(), *corners_s})
        ]

    def _piece(self, mission_time_s: float) -> _Piece:
        pieces = self._pieces
        if len(pieces) == 1:
            return pieces[0]
        return pieces[bisect_right(pieces, max(mission_time_s, 0.0), key=_begin_s) - 1]

    @cached_property
    def _pieces(self) -> list[_Piece]:
        return _divided(self)


@lru_cache(maxsize=64)
def _divided(motion: TargetMotion) -> list[_Piece]:
    """Divide a path into intervals of constant velocity."""
    if not motion.legs:
        return [_Piece(0.0, motion.start_m, motion.velocity_m_s)]
    pieces, time_s, (x, y) = [], 0.0, motion.start_m
    for leg in motion.legs * motion.rounds:
        away_x, away_y = leg.to_m[0] - x, leg.to_m[1] - y
        takes_s = hypot(away_x, away_y) / leg.speed_m_s
        if takes_s > 0.0:
            pieces.append(_Piece(time_s, (x, y), (away_x / takes_s, away_y / takes_s)))
        time_s, (x, y) = time_s + takes_s, leg.to_m
        pieces.append(_Piece(time_s, leg.to_m, (0.0, 0.0)))
        time_s += leg.pause_s
    return pieces


_begin_s = itemgetter(0)


class MovingTarget(Protocol):
    """A target as its sensors see it."""

    def position_m(self, mission_time_s: float) -> Pair:
        """Return its position; a target that reacts is known at the present tick only."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """A sensor of the target: its range, rate and noise per axis, and the importance and threat that it reports.

    A share of its sightings are outliers with an error of `outlier_m` in a random direction. Sightings arrive `delay_s`
    late; the sensor is blind in an interval of mission time. `altitude_m` is the target's, if the sensor measures it;
    `target` is the name that sightings have. `changes` are times from which on importance and threat are others.
    """

    range_m: float
    rate_hz: float
    noise_m: float
    importance: float
    threat: float
    outlier_share: float = 0.0
    outlier_m: float = 0.0
    delay_s: float = 0.0
    blind_s: tuple[Pair, ...] = ()
    altitude_m: float | None = None
    target: str | None = None
    changes: tuple[tuple[float, float, float], ...] = ()

    def value(self, mission_time_s: float) -> Pair:
        """Return importance and threat at a mission time."""
        past = [each[1:] for each in self.changes if each[0] <= mission_time_s]
        return past[-1] if past else (self.importance, self.threat)


class SimulatedSensor:
    """One vehicle's sensor of a simulated target; seeded, so that flights are reproducible.

    Each further target of several has a `stream` of random numbers of its own.
    """

    # Even an ideal sensor has a covariance: with 0 the filters would follow rounding errors.
    _NOISE_MIN_M = 0.01

    def __init__(
        self,
        sensor_id: int,
        model: SensorModel,
        target: MovingTarget,
        start_s: float,
        seed: int,
        stream: tuple[int, ...] = (),
    ) -> None:
        self._sensor_id = sensor_id
        self._model = model
        self._target = target
        self._start_s = start_s
        self._random = np.random.default_rng([seed, 1, sensor_id, *stream])
        # Outliers are drawn from the same generator.
        self._normals = normals(self._random, AHEAD if model.outlier_share == 0.0 else 1)
        self._sigma_m = max(model.noise_m, self._NOISE_MIN_M)
        self._due_s: float | None = None
        self._untold: deque[Sighting] = deque()

    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        """Return the next sighting to deliver, if any: the target was within range of `position_m` when it was due."""
        # A tick that is early by rounding only is still on time.
        if self._due_s is None or now_s >= self._due_s - 1e-6:
            seen = self._seen(now_s, position_m)
            if seen is not None:
                self._untold.append(seen)
        if self._untold and now_s >= self._untold[0].time_s + self._model.delay_s - 1e-6:
            return (self._untold.popleft(),)
        return ()

    def _seen(self, now_s: float, position_m: tuple[float, float]) -> Sighting | None:
        model = self._model
        due_s = now_s if self._due_s is None else self._due_s
        period_s = 1.0 / model.rate_hz
        self._due_s = max(due_s + period_s, now_s + period_s / 2.0)
        mission_s = now_s - self._start_s
        x, y = self._target.position_m(mission_s)
        if hypot(x - position_m[0], y - position_m[1]) > model.range_m:
            return None
        if any(begin_s <= mission_s < end_s for begin_s, end_s in model.blind_s):
            return None
        noise_x, noise_y = next(self._normals) * model.noise_m, next(self._normals) * model.noise_m
        if model.outlier_share > 0.0 and self._random.random() < model.outlier_share:
            side_rad = self._random.uniform(0.0, 2.0 * pi)
            noise_x += model.outlier_m * cos(side_rad)
            noise_y += model.outlier_m * sin(side_rad)
        variance = self._sigma_m**2
        altitude_m, altitude_sigma_m = None, 1.0
        if model.altitude_m is not None:
            altitude_m, altitude_sigma_m = model.altitude_m + next(self._normals) * model.noise_m, self._sigma_m
        importance, threat = model.value(mission_s)
        return Sighting(
            now_s,
            self._sensor_id,
            (x + noise_x, y + noise_y),
            (variance, 0.0, variance),
            importance,
            threat,
            altitude_m,
            altitude_sigma_m,
            target=model.target,
        )


class SimulatedSensors:
    """One vehicle's sensor of several simulated targets, as a sensor of each."""

    def __init__(self, sensors: Sequence[SimulatedSensor]) -> None:
        self._sensors = tuple(sensors)

    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        """Return the sightings to deliver, in the order of the targets."""
        return tuple(sighting for each in self._sensors for sighting in each.sight(now_s, position_m))
