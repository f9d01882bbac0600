"""The plant over one time step on plain numbers, because for two axes arrays cost more than their arithmetic."""

from collections.abc import Callable

from estimation.plant.model import Plant, PlantStep, exact_step

Pair = tuple[float, float]
Motion = tuple[float, float, float, float]
"""[x y x' y'] in the mission frame."""
StepFunction = Callable[[Motion, Pair, Pair, float], Motion]
"""A dynamics function: from motion, aim [m], disturbance [m/s²] and step duration [s] to the motion after the step.

A step is any part of a period of the loop: it ends when a setpoint begins to act. Aims act one delay of the plant after
they were sent, and include the feed-forward of velocities. A function with state serves one vehicle in one flight.
"""
_Axis = tuple[float, float, float, float, float, float, float, float]


class FunctionStep:
    """Dynamics by a function."""

    def __init__(self, function: StepFunction, step_s: float) -> None:
        self._function, self._step_s = function, step_s

    def advance(self, motion: Motion, aim_m: Pair, disturbance_m_s2: Pair) -> Motion:
        """Return the motion one step later."""
        return self._function(motion, aim_m, disturbance_m_s2, self._step_s)


class NumericStep:
    """The same as `estimation.plant.model.PlantStep`, bit for bit: none of its entries couples the axes."""

    def __init__(self, plant: Plant, step_s: float) -> None:
        step = exact_step(plant, step_s)
        self._x, self._y = _axis(step, 0), _axis(step, 1)

    def advance(self, motion: Motion, aim_m: Pair, disturbance_m_s2: Pair) -> Motion:
        """Return the motion one step later."""
        x, y, x_rate, y_rate = motion
        (aim_x, aim_y), (push_x, push_y) = aim_m, disturbance_m_s2
        a_pp, a_pv, b_p, e_p, a_vp, a_vv, b_v, e_v = self._x
        later_x = a_pp * x + a_pv * x_rate + (b_p * aim_x + e_p * push_x)
        later_x_rate = a_vp * x + a_vv * x_rate + (b_v * aim_x + e_v * push_x)
        a_pp, a_pv, b_p, e_p, a_vp, a_vv, b_v, e_v = self._y
        later_y = a_pp * y + a_pv * y_rate + (b_p * aim_y + e_p * push_y)
        later_y_rate = a_vp * y + a_vv * y_rate + (b_v * aim_y + e_v * push_y)
        return later_x, later_y, later_x_rate, later_y_rate


MotionStep = FunctionStep | NumericStep
"""A vehicle's dynamics over one time step."""


def _axis(step: PlantStep, position: int) -> _Axis:
    """Return one axis: for its position and then its velocity the gains of position, velocity, aim and disturbance."""
    velocity = position + 2
    rows = (
        (
            *step.transition[row, [position, velocity]],
            step.input_gain[row, position],
            step.disturbance_gain[row, position],
        )
        for row in (position, velocity)
    )
    a_pp, a_pv, b_p, e_p, a_vp, a_vv, b_v, e_v = (float(gain) for row in rows for gain in row)
    return a_pp, a_pv, b_p, e_p, a_vp, a_vv, b_v, e_v
