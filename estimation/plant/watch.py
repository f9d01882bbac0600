"""Validation of a plant: predictions from the setpoints, compared with the positions, in flight and from a log.

The filter's innovations hardly show a wrong plant, because its disturbance absorbs the model error. Here the flight is
cut into windows, and in each the plant is simulated from the setpoints sent, with free initial position, initial
velocity and one steady disturbance. The remaining error is compared with that of other plants.

Another plant explains a flight if it leaves much less in all windows together, and in several of them each: a jump of
the autopilot's estimator, or a limit of speed or acceleration that acts for a while, is in one window or two. A
difference that is a small share of the motion is none.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from math import inf
from typing import Final, Literal, NamedTuple

import numpy as np

from estimation.plant.model import Plant, PlantAxis, PlantStep, exact_step
from estimation.state import Vector

STEP_S: Final = 0.1
WINDOW_S: Final = 10.0
SHARES = (0.6, 0.75, 1.0, 1.33, 1.67)
"""The factors of stiffness and damping of the other plants."""
DELAYS_S = (-0.2, -0.1, 0.0, 0.1, 0.2)
DELAY_MAX_S: Final = 1.0
DELAY_STEP_S: Final = 0.02
WINDOWS_LEAST: Final = 4
WINDOWS_IN_FLIGHT: Final = 6
"""The fewest windows that are compared, in which another plant has to be better; and the newest that are, in flight."""
MOVED_LEAST_M: Final = 0.3
"""The smallest motion of the setpoint (rms, about a straight line) in a window that is used."""
AGAIN_SHARE: Final = 0.7
"""Another plant is better where it leaves less than this share of the residual of the profile's plant (rms): half of
the variance. In closed loop, noise alone favours a softer plant: the drift of PX4's estimate gives 0.9."""
MATTERS_SHARE: Final = 0.17
"""Another plant is better where it explains more than this share of the setpoint's motion besides (rms, about a
straight line). On a ring that is a lag that is off by a quarter: what is less, the disturbance's estimate covers."""
_COUNT = round(WINDOW_S / STEP_S)
_NEAR_S: Final = 1.0
_FREE: Final = 3
_AXES = ((0, 2), (1, 3))
"""Position and velocity along x and y in a state [x y x' y']."""
Difference = Literal["stiffer", "softer"]


@dataclass(frozen=True, slots=True)
class PlantComparison:
    """The prediction error of a plant (rms), that of the best other plant, which that is, and how the vehicle differs.

    `difference` is None where no other plant is better: a stiffer vehicle is sooner where its setpoints are, a softer
    one later. `is_unfed` is whether the other plant alone has no feed-forward.
    """

    windows: int
    unexplained_m: float
    best_m: float
    best: Plant
    difference: Difference | None
    is_unfed: bool

    @property
    def text(self) -> str:
        """The errors of both, and the other plant."""
        best = self.best
        numbers = f"a0 {best.x.a0_per_s2:.2f} 1/s², a1 {best.x.a1_per_s:.2f} 1/s, delay {best.delay_s:.2f} s"
        feeds = ", without velocity feed-forward" if self.is_unfed else ""
        return f"residual {self.unexplained_m:.2f} m rms, of another plant {self.best_m:.2f} m ({numbers}{feeds})"


def watch(plant: Plant, setpoints: Vector, samples: Vector) -> PlantComparison | None:
    """Compare a plant with a flight: setpoints (S, 3) and positions (K, 3), each row a time [s] and a position [m].

    Setpoints with velocities are (S, 5). None without enough excitation to distinguish plants.
    """
    bank = _bank((plant, *others(plant)))
    return bank.comparison([bank.residual(each) for each in _windows(setpoints, samples)])


class PlantWatch:
    """The same in flight: takes setpoints and positions until it finds a difference, which is `found` from then on.

    The other plants are simulated only where the error of the profile's is large enough to matter: it takes a
    millisecond for a window. Windows begin `after_s` after the first setpoint: the vehicles of a process take turns.
    """

    def __init__(self, plant: Plant, after_s: float = 0.0) -> None:
        self.found: PlantComparison | None = None
        self._own, self._bank = _bank((plant,)), _bank((plant, *others(plant)))
        self._after_s = after_s
        self._windows: deque[_Window] = deque(maxlen=WINDOWS_IN_FLIGHT)
        self._own_m2: deque[float] = deque(maxlen=WINDOWS_IN_FLIGHT)
        self._residuals: dict[_Window, _Residual] = {}
        self.restart()

    def restart(self) -> None:
        """Begin another window: the vehicle has flown without setpoints, or its estimate has jumped."""
        self._setpoints: list[tuple[float, ...]] = []
        self._samples: list[tuple[float, ...]] = []
        self._from_s = inf

    def measured(self, time_s: float, x_m: float, y_m: float) -> None:
        """Take a position."""
        if self._setpoints and (not self._samples or time_s > self._samples[-1][0]):
            self._samples.append((time_s, x_m, y_m))

    def sent(self, arrives_s: float, *setpoint: float) -> None:
        """Take a setpoint (x, y), and its velocity where one is sent, with the time at which it reaches the vehicle."""
        if self.found is not None:
            return
        if self._setpoints and abs(arrives_s - self._setpoints[-1][0]) > _NEAR_S:
            self.restart()
        if self._setpoints:
            arrives_s = max(arrives_s, self._setpoints[-1][0])
        else:
            self._from_s = arrives_s + DELAY_MAX_S + self._after_s
        self._setpoints.append((arrives_s, *setpoint))
        if arrives_s > self._from_s + WINDOW_S + _NEAR_S:
            self._close()

    def _close(self) -> None:
        window = _window(self._from_s, np.array(self._setpoints), np.array(self._samples).reshape(-1, 3))
        self._from_s += WINDOW_S
        oldest_s = self._from_s - DELAY_MAX_S - _NEAR_S
        self._setpoints = [each for each in self._setpoints if each[0] > oldest_s]
        self._samples = [each for each in self._samples if each[0] > oldest_s]
        if window is None:
            return
        self._windows.append(window)
        self._own_m2.append(self._own.residual(window).squared_m2.item(0))
        if sum(self._own_m2) <= MATTERS_SHARE**2 * sum(each.moved_m2 for each in self._windows):
            return
        known = self._residuals
        self._residuals = {each: known.get(each) or self._bank.residual(each) for each in self._windows}
        found = self._bank.comparison(tuple(self._residuals.values()))
        if found is not None and found.difference is not None:
            self.found = found
            self.restart()


@lru_cache(maxsize=64)
def _bank(plants: tuple[Plant, ...]) -> "_Bank":
    return _Bank(plants)


def effect_delay_s(plant: Plant, setpoints: Vector, samples: Vector) -> float | None:
    """Return the delay from setpoint to position with which a plant explains a flight best [s].

    Arguments and None as in `watch`.
    """
    tried_s = np.arange(0.0, DELAY_MAX_S + DELAY_STEP_S / 2.0, DELAY_STEP_S).tolist()
    bank = _Bank(tuple(replace(plant, delay_s=delay_s) for delay_s in tried_s))
    left_m2 = [bank.residual(each).squared_m2 for each in _windows(setpoints, samples)]
    return tried_s[int(np.argmin(np.sum(left_m2, axis=0)))] if len(left_m2) >= WINDOWS_LEAST else None


def others(plant: Plant) -> list[Plant]:
    """Return the plants that a plant is compared with; for one with feed-forward also the same without."""
    tried = [replace(plant, feedforward=0.0)] if plant.feedforward else []
    for a0, a1, later_s in product(SHARES, SHARES, DELAYS_S):
        x, y = (PlantAxis(axis.a0_per_s2 * a0, axis.a1_per_s * a1) for axis in (plant.x, plant.y))
        delay_s = round(plant.delay_s + later_s, 3)
        if 0.0 <= delay_s <= 1.0 and (a0, a1, later_s) != (1.0, 1.0, 0.0):
            tried.append(replace(plant, x=x, y=y, delay_s=delay_s))
    return tried


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """A window: its begin, its positions (N, 2), and all setpoints by time, with their velocities (S, 2).

    `moved_m2` is the sum of the squares of the setpoint's motion.
    """

    from_s: float
    moved_m2: float
    position_m: Vector
    setpoint_s: Vector
    setpoint_m: Vector
    velocity_m_s: Vector


def _windows(setpoints: Vector, samples: Vector) -> Iterator[_Window]:
    setpoints = setpoints[np.isfinite(setpoints).all(axis=1)]
    if len(setpoints) < 2 or len(samples) < 2:
        return
    first_s, last_s = max(setpoints[0, 0] + 1.0, samples[0, 0]), min(setpoints[-1, 0], samples[-1, 0])
    for from_s in np.arange(first_s, last_s - WINDOW_S, WINDOW_S).tolist():
        window = _window(from_s, setpoints, samples)
        if window is not None:
            yield window


def _window(from_s: float, setpoints: Vector, samples: Vector) -> _Window | None:
    """Return the window that begins at a time, None without enough samples or motion of the setpoint."""
    time_s = np.asarray(from_s + STEP_S * np.arange(_COUNT + 1), dtype=np.float64)
    near = samples[(samples[:, 0] >= from_s - _NEAR_S) & (samples[:, 0] <= from_s + WINDOW_S + _NEAR_S)]
    if len(near) < _COUNT / 2.0 or np.diff(near[:, 0]).max() > _NEAR_S:
        return None
    asked = _held(setpoints[:, 0], setpoints[:, 1:3], time_s)
    moved_m2 = float((_without_line(asked) ** 2).sum())
    if moved_m2 < MOVED_LEAST_M**2 * asked.size:
        return None
    place = np.column_stack([np.interp(time_s, near[:, 0], near[:, k]) for k in (1, 2)])
    return _Window(from_s, moved_m2, place, setpoints[:, 0], setpoints[:, 1:3], setpoints[:, 3:])


def _held(at_s: Vector, value: Vector, time_s: Vector) -> Vector:
    return value[np.maximum(np.searchsorted(at_s, time_s + 1e-6, side="right") - 1, 0)]


def _means(at_s: Vector, value: Vector, edges_s: Vector) -> Vector:
    """Return the means of piecewise constant values (S, 2) between successive edges (D, N + 1): (D, 2, N)."""
    total = np.zeros((2, len(value)))
    np.cumsum(value[:-1].T * np.diff(at_s), axis=1, out=total[:, 1:])
    return np.diff(np.stack([np.interp(edges_s, at_s, each) for each in total], axis=1)) / STEP_S


def _without_line(values: Vector) -> Vector:
    base = np.column_stack([np.ones(len(values)), np.arange(len(values))])
    return values - base @ np.linalg.lstsq(base, values, rcond=None)[0]


class _Residual(NamedTuple):
    """The sums of the squared errors of plants in a window over both axes, and that of the setpoint's motion."""

    squared_m2: Vector
    moved_m2: float


class _Bank:
    """Plants that are simulated together; what does not depend on a flight is computed once."""

    def __init__(self, plants: tuple[Plant, ...]) -> None:
        self.plants = plants
        self._delays_s, self._delayed = np.unique([plant.delay_s for plant in plants], return_inverse=True)
        self._lead_s = np.array([plant.lead_s for plant in plants])
        motions = _motions([exact_step(plant, STEP_S) for plant in plants])
        self._free = np.linalg.qr(motions[..., :_FREE])[0]
        self._response = np.fft.rfft(motions[:, :, 1:, _FREE], 2 * _COUNT)

    def residual(self, window: _Window) -> _Residual:
        """Return the errors of the plants in a window."""
        edges_s = window.from_s + STEP_S * np.arange(_COUNT + 1) - self._delays_s[:, None]
        aims = _means(window.setpoint_s, window.setpoint_m, edges_s)[self._delayed]
        if window.velocity_m_s.size:
            rates = _means(window.setpoint_s, window.velocity_m_s, edges_s)[self._delayed]
            aims = aims + self._lead_s[..., None] * rates
        # The response to the aims is a convolution; twice as many samples keep its end out of its begin.
        moved = np.fft.irfft(np.fft.rfft(aims, 2 * _COUNT) * self._response, 2 * _COUNT)[..., :_COUNT]
        off = np.repeat(window.position_m.T[None], len(self.plants), axis=0)
        off[..., 1:] -= moved
        along = (off[..., None, :] @ self._free)[..., 0, :]
        left_m2 = (off**2).sum(axis=(1, 2)) - (along**2).sum(axis=(1, 2))
        return _Residual(np.maximum(left_m2, 0.0), window.moved_m2)  # no error at all may be rounded below 0

    def comparison(self, residuals: Sequence[_Residual]) -> PlantComparison | None:
        """Compare the first plant with the others by their errors in windows; None if these are too few."""
        if len(residuals) < WINDOWS_LEAST:
            return None
        squared, share = np.array([each.squared_m2 for each in residuals]), AGAIN_SHARE**2
        left_m2 = squared.sum(axis=0)
        better = left_m2 < share * left_m2[0]
        better &= left_m2[0] - left_m2 > MATTERS_SHARE**2 * sum(each.moved_m2 for each in residuals)
        better &= (squared < share * squared[:, :1]).sum(axis=0) >= WINDOWS_LEAST
        best = int(np.argmin(np.where(better, left_m2, inf) if better.any() else left_m2))
        own_m, best_m = np.sqrt(left_m2[[0, best]] / (2 * len(squared) * (_COUNT + 1 - _FREE))).tolist()
        found, plant = self.plants[best], self.plants[0]
        difference: Difference = "stiffer" if _slowness(found) < _slowness(plant) else "softer"
        is_unfed = found.feedforward < plant.feedforward
        return PlantComparison(len(squared), own_m, best_m, found, difference if better.any() else None, is_unfed)


def _motions(steps: Sequence[PlantStep]) -> Vector:
    """Return the motions from a position, from a velocity, under a disturbance, and from an aim in the first step.

    They are (plants, axes, N, 4).
    """
    kept = np.array([[step.transition[np.ix_(*2 * [each])] for each in _AXES] for step in steps])
    push = np.array([[step.disturbance_gain[each, each[0]] for each in _AXES] for step in steps])
    aim = np.array([[step.input_gain[each, each[0]] for each in _AXES] for step in steps])
    state = np.zeros((len(steps), 2, 2, _FREE + 1))
    state[..., 0, 0] = state[..., 1, 1] = 1.0
    places = [state[..., 0, :]]
    for k in range(_COUNT):
        state = kept @ state
        state[..., 2] += push
        state[..., 3] += aim * (k == 0)
        places.append(state[..., 0, :])
    return np.stack(places, axis=2)


def _slowness(plant: Plant) -> tuple[float, float]:
    """Return how long a plant is behind setpoints that move steadily, and what decides where that is the same."""
    lags_s = (plant.a1_per_s / plant.a0_per_s2 - plant.lead_s).mean()
    return round(float(lags_s) + plant.delay_s, 6), -float(plant.a0_per_s2.mean())
