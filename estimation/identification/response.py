"""The response of a linear plant to setpoints that change at any time, in closed form: used by identification.

Control and simulation step through time with `plant.exact_step`; a fit needs the same plant at measured times, with
setpoints that act between them, for any delay. Here the response is a sum over the poles: the unit step response is 1 +
sum c_i exp(p_i t).
"""

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from estimation.state import Vector

Poles = NDArray[np.complex128]

_POLES_APART = 1e-4
_JUMP_S, _JUMP_SHARE = 1e-3, 0.2
"""A change is a jump if the changes before and after it are smaller than this share of it."""


class InputHold(Enum):
    """The assumption about the input between two setpoints of a log."""

    HELD = "held from each until the next"
    MIDWAY = "changed halfway between two"
    LINEAR = "moved straight from each to the next"
    MIXED = "changed halfway between two where it stood before and after, moved straight elsewhere"


@dataclass(frozen=True, slots=True)
class SetpointSteps:
    """A setpoint as a sum of steps or of ramps that begin at `time_s` (n,): `size` (n,) in m, or in m/s for ramps.

    Before the first of them it is `before_m`.
    """

    time_s: Vector
    size: Vector
    before_m: float
    ramps: bool


@dataclass(frozen=True, slots=True)
class AxisInput:
    """The input of one axis: its setpoints, and the feed-forward velocities sent with them, if any."""

    position: SetpointSteps
    velocity: SetpointSteps | None = None


def steps_of(time_s: Vector, setpoint_m: Vector, between: InputHold) -> SetpointSteps:
    """Return logged setpoints (n,) at times (n,) as the assumed continuous input."""
    before_m = float(setpoint_m[0])
    if between is InputHold.MIXED:
        time_s, setpoint_m = _with_jumps(time_s, setpoint_m)
    if between in (InputHold.LINEAR, InputHold.MIXED):
        slopes = np.diff(setpoint_m) / np.diff(time_s)
        changes = np.diff(slopes, prepend=0.0, append=0.0)
        return SetpointSteps(time_s, changes, before_m, ramps=True)
    at_s = time_s[1:] if between is InputHold.HELD else (time_s[1:] + time_s[:-1]) / 2.0
    changes = np.diff(setpoint_m)
    moved = changes != 0.0
    return SetpointSteps(at_s[moved], changes[moved], before_m, ramps=False)


def _with_jumps(time_s: Vector, setpoint_m: Vector) -> tuple[Vector, Vector]:
    """Return setpoints with two added at each jump: the old value just before the midpoint, the new one just after."""
    change = np.diff(setpoint_m)
    around = np.maximum(np.abs(np.append(0.0, change[:-1])), np.abs(np.append(change[1:], 0.0)))
    jumps = np.flatnonzero(np.abs(change) * _JUMP_SHARE > around)
    middle_s = (time_s[jumps] + time_s[jumps + 1]) / 2.0
    times_s = np.concatenate((time_s, middle_s - _JUMP_S / 2.0, middle_s + _JUMP_S / 2.0))
    values_m = np.concatenate((setpoint_m, setpoint_m[jumps], setpoint_m[jumps + 1]))
    order = np.argsort(times_s)
    return times_s[order], values_m[order]


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """A stable plant with unit steady gain: poles (k,) and the residues (k,) of its step response."""

    poles: Poles
    residues: Poles

    def free(self, time_s: Vector) -> Vector:
        """Return a basis of all motions without input at times from 0 (T,), shape (T, k)."""
        if self.poles.size == 2:  # well conditioned also for equal poles
            first, second = (np.exp(pole * time_s) for pole in self.poles)
            apart = self.poles[0] - self.poles[1]
            return np.column_stack((((first + second) / 2.0).real, ((first - second) / apart).real))
        powers = np.exp(np.outer(time_s, self.poles))
        columns = [powers[:, at].real for at, pole in enumerate(self.poles) if pole.imag >= 0.0]
        columns += [powers[:, at].imag for at, pole in enumerate(self.poles) if pole.imag > 0.0]
        return np.column_stack(columns)

    def step(self, time_s: Vector) -> Vector:
        """Return the response to a unit step at times from 0 (T,)."""
        return np.asarray(1.0 + (np.exp(np.outer(time_s, self.poles)) @ self.residues).real, dtype=np.float64)

    def gain(self, rate_rad_s: Vector) -> Poles:
        """Return the complex gain at angular rates (W,)."""
        s = 1j * rate_rad_s
        return np.asarray(1.0 + (s[:, None] / (s[:, None] - self.poles)) @ self.residues, dtype=np.complex128)

    def forced(self, steps: SetpointSteps, delay_s: float, begin_s: float, step_s: float, count: int) -> Vector:
        """Return the response (count,) to the setpoint from rest, at begin_s, begin_s + step_s and so on.

        It starts at rest at the setpoint of `begin_s`.
        """
        at_s = steps.time_s + delay_s - begin_s
        late = at_s > 0.0
        sizes = np.append(steps.size[~late].sum(), steps.size[late])  # the setpoint at the beginning, as one change
        since_begin_s = np.append(0.0, at_s[late])
        index = np.ceil(since_begin_s / step_s - 1e-9).astype(np.int64)
        inside = index < count
        change = _Changes(index[inside], since_begin_s[inside], sizes[inside])
        if steps.ramps:
            begin_m = steps.before_m - float(steps.size[~late] @ at_s[~late])
            slope = change.summed(change.size, count)
            level = begin_m + slope * np.arange(count) * step_s - change.summed(change.size * change.time_s, count)
            return level + self._decaying(change, 1.0 / self.poles, slope, step_s, count)
        level = steps.before_m + change.summed(change.size, count)
        change.size[0] = 0.0  # no response: the plant begins at rest
        return level + self._decaying(change, np.ones_like(self.poles), 0.0, step_s, count)

    def answer(
        self, inputs: AxisInput, lead_s: float, delay_s: float, begin_s: float, step_s: float, count: int
    ) -> Vector:
        """Return the response (count,) to setpoints and feed-forward velocities, which lead the aim by `lead_s`."""
        answered = self.forced(inputs.position, delay_s, begin_s, step_s, count)
        if inputs.velocity is None or lead_s == 0.0:
            return answered
        return answered + lead_s * self.forced(inputs.velocity, delay_s, begin_s, step_s, count)

    def _decaying(self, change: "_Changes", weights: Poles, slope: Vector | float, step_s: float, count: int) -> Vector:
        """Return the transient response (count,): sum over i of c_i w_i (sum of changes exp(p_i t) - slope)."""
        total = np.zeros(count)
        since_s = change.index * step_s - change.time_s
        for pole, residue, weight in zip(self.poles, self.residues, weights, strict=True):
            if pole.imag < 0.0:
                continue  # the complex conjugate of another pole
            stirred = change.size * np.exp(pole * since_s)
            injected = change.arriving(stirred.real, count) + 1j * change.arriving(stirred.imag, count)
            mode = lfilter([1.0], [1.0, -np.exp(pole * step_s)], injected)
            total += (2.0 if pole.imag > 0.0 else 1.0) * (residue * weight * (mode - slope)).real
        return total


@dataclass(frozen=True, slots=True, eq=False)
class _Changes:
    """Changes (n,) at times since the beginning, and the first grid point after each."""

    index: NDArray[np.int64]
    time_s: Vector
    size: Vector

    def arriving(self, values: Vector, count: int) -> Vector:
        """Return the sum of the values of the changes that arrive at each grid point (count,)."""
        return np.asarray(np.bincount(self.index, values, count), dtype=np.float64)

    def summed(self, values: Vector, count: int) -> Vector:
        """Return the cumulative sum of the values up to each grid point (count,)."""
        return np.asarray(np.cumsum(self.arriving(values, count)), dtype=np.float64)


@lru_cache(8)
def response_of(a0_per_s2: float, a1_per_s: float, lag_s: float = 0.0, lead_s: float = 0.0) -> Response:
    """Return the response of lag x''' + x'' = a0 (X_d + lead X_d' - x) - a1 x'.

    Without an actuator lag it is of second order; the lead is that of velocity feed-forward.
    """
    denominator = np.array([1.0, a1_per_s, a0_per_s2])
    if lag_s > 0.0:
        denominator = np.append(lag_s, denominator)
    poles = _parted(np.roots(denominator).astype(np.complex128))
    others = np.array([np.prod(pole - np.delete(poles, at)) for at, pole in enumerate(poles)])
    residues = a0_per_s2 / denominator[0] * (1.0 + lead_s * poles) / (poles * others)
    return Response(poles, residues)


def _parted(poles: Poles) -> Poles:
    """Return poles with a minimum distance: for equal poles the sum over poles is singular."""
    poles = poles[np.argsort(poles.real, kind="stable")]
    for at in range(poles.size - 1):
        scale = abs(poles[at])
        if abs(poles[at + 1] - poles[at]) < _POLES_APART * scale:
            mean = (poles[at] + poles[at + 1]).real / 2.0
            poles[at : at + 2] = mean + _POLES_APART * scale * np.array([-0.5, 0.5])
    return poles
