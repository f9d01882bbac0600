"""Motion as ArduCopter shapes it: the identified plant as long as speed, acceleration and jerk allow.

A small motion is the linear plant's own, exactly; a large one is as fast as the limits let it be.
"""

from dataclasses import dataclass, fields

import numpy as np

from estimation.plant.model import Plant, PlantStep, exact_step
from estimation.state import POSITION, VELOCITY, Vector

SPEED_KEPT = 0.98
"""The share of the speed limit that is steered for: the jerk limit lets the speed swing over by less than the rest."""


@dataclass(frozen=True, slots=True)
class ShapeLimits:
    """Bounds on a horizontal motion: norms in the plane. Raises ValueError unless all are positive."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float

    def __post_init__(self) -> None:
        """Refuse what would nail the vehicle down."""
        for each in fields(self):
            if not getattr(self, each.name) > 0.0:
                raise ValueError(f"{each.name} = {getattr(self, each.name)}: it must be positive")


class ShapedStep:
    """The plant over one time step, with bounded speed, acceleration and jerk."""

    def __init__(self, plant: Plant, step_s: float, limits: ShapeLimits) -> None:
        self._linear: PlantStep = exact_step(plant, step_s)
        self._a0_per_s2, self._a1_per_s = plant.a0_per_s2, plant.a1_per_s
        self._step_s = step_s
        self._limits = limits

    def advance(self, state: Vector, before_m_s2: Vector, aim_m: Vector, disturbance_m_s2: Vector) -> Vector:
        """Return the state (4,) one step later; `before_m_s2` (2,) is the acceleration over the step before."""
        aim_m = self._nearer(state[POSITION], aim_m, disturbance_m_s2)
        linear = self._linear.advance(state, aim_m, disturbance_m_s2)
        wanted = (linear[VELOCITY] - state[VELOCITY]) / self._step_s
        bounded = _shortened(wanted, self._limits.acceleration_m_s2)
        change = bounded - before_m_s2
        allowed = _shortened(change, self._limits.jerk_m_s3 * self._step_s)
        if bounded is wanted and allowed is change:
            return linear
        velocity = state[VELOCITY] + (before_m_s2 + allowed) * self._step_s
        position = state[POSITION] + (state[VELOCITY] + velocity) / 2.0 * self._step_s
        return np.concatenate([position, velocity])

    def _nearer(self, position_m: Vector, aim_m: Vector, disturbance_m_s2: Vector) -> Vector:
        """Draw the aim nearer, until the speed that the plant tends to is one allowed."""
        tended = (self._a0_per_s2 * (aim_m - position_m) + disturbance_m_s2) / self._a1_per_s
        bounded = _shortened(tended, SPEED_KEPT * self._limits.speed_m_s)
        if bounded is tended:
            return aim_m
        return np.asarray(position_m + (self._a1_per_s * bounded - disturbance_m_s2) / self._a0_per_s2)


def _shortened(vector: Vector, longest: float) -> Vector:
    """Return what `estimation.vectors.clipped` does, with numpy's `hypot` for the length.

    The two differ in the last digit of one length in 170, and the simulations recorded so far were made with this one.
    """
    length = float(np.hypot(*vector))
    return vector if length <= longest else vector * (longest / length)
