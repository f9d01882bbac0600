"""The identified plant: the response of one horizontal axis of a vehicle to a position setpoint.

`x'' = a0 (X_d - x) - a1 x' + w` per axis (section 2 of the paper). Filters, controllers, simulation and stub use the
same discretisation.

With feed-forward g it has a velocity V_d as a second input: `x'' = a0 (X_d - x) + a1 (g V_d - x') + w`. This is the
same plant with one input, the aim `X_d + (g a1 / a0) V_d`, the position where it would come to rest. Filters, planners
and guard use aims only; an aim becomes a setpoint and a velocity just before it is sent.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import cos, exp, isfinite, sin, sqrt

import numpy as np

from estimation.state import Vector

FEEDFORWARD_MAX = 2.0
"""The largest g: PX4's and ArduCopter's is 1, and correctly identified plants are near that."""


@dataclass(frozen=True, slots=True)
class PlantAxis:
    """One axis of the plant; `a0` is the stiffness [1/s²] and `a1` the damping [1/s], both positive.

    Raises ValueError when the axis is not asymptotically stable.
    """

    a0_per_s2: float
    a1_per_s: float

    def __post_init__(self) -> None:
        for name, value in (("a0_per_s2", self.a0_per_s2), ("a1_per_s", self.a1_per_s)):
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value} makes the plant unstable: it must be positive")


@dataclass(frozen=True, slots=True)
class Plant:
    """Both horizontal axes of the mission frame, and the delay between a setpoint and its effect [s].

    `feedforward` is the gain g of the velocity sent with the setpoint; 0 is a plant without feed-forward.
    """

    x: PlantAxis
    y: PlantAxis
    delay_s: float = 0.0
    feedforward: float = 0.0

    def __post_init__(self) -> None:
        if not (isfinite(self.delay_s) and 0.0 <= self.delay_s <= 1.0):
            raise ValueError(f"delay_s = {self.delay_s}: it must lie between 0 and 1 s")
        if not (isfinite(self.feedforward) and 0.0 <= self.feedforward <= FEEDFORWARD_MAX):
            raise ValueError(f"feedforward = {self.feedforward}: it must lie between 0 and {FEEDFORWARD_MAX:g}")

    @property
    def a0_per_s2(self) -> Vector:
        """Stiffness of both axes, shape (2,)."""
        return np.array([self.x.a0_per_s2, self.y.a0_per_s2])

    @property
    def a1_per_s(self) -> Vector:
        """Damping of both axes, shape (2,)."""
        return np.array([self.x.a1_per_s, self.y.a1_per_s])

    @property
    def lead_s(self) -> tuple[float, float]:
        """The lead time of the aim by a velocity, g a1 / a0 along both axes [s]."""
        x, y, gain = self.x, self.y, self.feedforward
        return gain * x.a1_per_s / x.a0_per_s2, gain * y.a1_per_s / y.a0_per_s2

    def aim_m(self, setpoint_m: Sequence[float], velocity_m_s: Sequence[float]) -> Vector:
        """Return the aim (2,) of a setpoint and its velocity, which is empty if none is sent."""
        x, y = setpoint_m[0], setpoint_m[1]
        if velocity_m_s and self.feedforward:
            lead_x, lead_y = self.lead_s
            x, y = x + lead_x * velocity_m_s[0], y + lead_y * velocity_m_s[1]
        return np.array([x, y])


@dataclass(frozen=True, slots=True)
class PlantStep:
    """The plant over one time step: `next = transition @ state + input_gain @ aim + disturbance_gain @ w`.

    Shapes (4, 4), (4, 2) and (4, 2); the state is [x y x' y'], aim and `w` are held over the step. Without feed-forward
    the aim is the setpoint.
    """

    transition: Vector
    input_gain: Vector
    disturbance_gain: Vector

    def advance(self, state: Vector, aim_m: Vector, disturbance_m_s2: Vector) -> Vector:
        """Return the state (4,) one step later."""
        forced = self.input_gain.dot(aim_m) + self.disturbance_gain.dot(disturbance_m_s2)
        return np.asarray(self.transition.dot(state) + forced, dtype=np.float64)


@lru_cache(maxsize=1024)
def exact_step(plant: Plant, step_s: float) -> PlantStep:
    """Discretise the plant exactly for inputs held over `step_s` (the matrix exponential in closed form)."""
    transition = np.zeros((4, 4))
    input_gain = np.zeros((4, 2))
    for index, axis in enumerate((plant.x, plant.y)):
        position, velocity = index, index + 2
        free, decay, slope, rate = _axis_response(axis, step_s)
        transition[position, position] = free
        transition[position, velocity] = decay
        transition[velocity, position] = slope
        transition[velocity, velocity] = rate
        input_gain[position, index] = 1.0 - free
        input_gain[velocity, index] = -slope
    disturbance_gain = input_gain / plant.a0_per_s2
    for matrix in (transition, input_gain, disturbance_gain):
        matrix.setflags(write=False)
    return PlantStep(transition, input_gain, disturbance_gain)


def _axis_response(axis: PlantAxis, step_s: float) -> tuple[float, float, float, float]:
    """Return the four entries of exp([[0, 1], [-a0, -a1]] step) of one axis, row by row."""
    half = axis.a1_per_s / 2.0
    discriminant = half**2 - axis.a0_per_s2
    root = sqrt(abs(discriminant))
    if root * step_s < 1e-6:  # critically damped: the limit of both branches below
        even, odd = exp(-half * step_s), exp(-half * step_s) * step_s
    elif discriminant > 0.0:
        slow, fast = exp((root - half) * step_s), exp(-(root + half) * step_s)
        even, odd = (slow + fast) / 2.0, (slow - fast) / (2.0 * root)
    else:
        envelope = exp(-half * step_s)
        even, odd = envelope * cos(root * step_s), envelope * sin(root * step_s) / root
    return even + half * odd, odd, -axis.a0_per_s2 * odd, even - half * odd
