"""Motion shaping as in ArduCopter: the identified plant within limits of speed, acceleration and jerk.

A small motion is exactly the linear plant's; a large one is as fast as the limits allow.
"""

from dataclasses import dataclass, fields
from typing import Final

from estimation.plant.model import Plant
from sitl.vehicle.plant_step import Motion, NumericStep, Pair

SPEED_KEPT: Final = 0.98
"""The share of the speed limit that is aimed at: the overshoot due to the jerk limit is less than the rest."""


@dataclass(frozen=True, slots=True)
class ShapeLimits:
    """Limits of a horizontal motion, as norms in the plane. Raises ValueError unless all are positive."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float

    def __post_init__(self) -> None:
        for each in fields(self):
            if not getattr(self, each.name) > 0.0:
                raise ValueError(f"{each.name} = {getattr(self, each.name)}: it must be positive")


class ShapedStep:
    """The plant over one time step, with bounded speed, acceleration and jerk."""

    def __init__(self, plant: Plant, step_s: float, limits: ShapeLimits) -> None:
        self._linear = NumericStep(plant, step_s)
        self._stiffness = plant.x.a0_per_s2, plant.y.a0_per_s2
        self._damping = plant.x.a1_per_s, plant.y.a1_per_s
        self._step_s = step_s
        self._limits = limits

    def advance(self, motion: Motion, before_m_s2: Pair, aim_m: Pair, disturbance_m_s2: Pair) -> Motion:
        """Return the motion one step later; `before_m_s2` is the acceleration over the previous step."""
        step_s, limits = self._step_s, self._limits
        x, y, x_rate, y_rate = motion
        linear = self._linear.advance(motion, self._nearer(x, y, aim_m, disturbance_m_s2), disturbance_m_s2)
        wanted = (linear[2] - x_rate) / step_s, (linear[3] - y_rate) / step_s
        bounded = _shortened(wanted, limits.acceleration_m_s2)
        change = bounded[0] - before_m_s2[0], bounded[1] - before_m_s2[1]
        allowed = _shortened(change, limits.jerk_m_s3 * step_s)
        if bounded == wanted and allowed == change:
            return linear
        later_x_rate = x_rate + (before_m_s2[0] + allowed[0]) * step_s
        later_y_rate = y_rate + (before_m_s2[1] + allowed[1]) * step_s
        later_x = x + (x_rate + later_x_rate) / 2.0 * step_s
        later_y = y + (y_rate + later_y_rate) / 2.0 * step_s
        return later_x, later_y, later_x_rate, later_y_rate

    def _nearer(self, x: float, y: float, aim_m: Pair, disturbance_m_s2: Pair) -> Pair:
        """Move the aim nearer until the plant's steady speed is within the limit."""
        (aim_x, aim_y), (push_x, push_y) = aim_m, disturbance_m_s2
        (stiff_x, stiff_y), (damped_x, damped_y) = self._stiffness, self._damping
        tended = (stiff_x * (aim_x - x) + push_x) / damped_x, (stiff_y * (aim_y - y) + push_y) / damped_y
        bounded = _shortened(tended, SPEED_KEPT * self._limits.speed_m_s)
        if bounded == tended:
            return aim_m
        return x + (damped_x * bounded[0] - push_x) / stiff_x, y + (damped_y * bounded[1] - push_y) / stiff_y


def _shortened(vector: Pair, longest: float) -> Pair:
    """Return the same as `estimation.vectors.clipped`, with the length of complex numbers, which is C's `hypot`.

    `math.hypot` differs in the last digit of one length in 170, which would change recorded simulations.
    """
    length = abs(complex(*vector))
    if length <= longest:
        return vector
    share = longest / length
    return vector[0] * share, vector[1] * share
