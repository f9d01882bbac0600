"""The true motion of one simulated vehicle: its plant, shaped or not, in wind, with delayed setpoints."""

from collections import deque
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Final

import numpy as np

from estimation.plant.model import Plant
from estimation.vectors import rounded
from sitl.vehicle.imperfections import Imperfections
from sitl.vehicle.plant_step import FunctionStep, Motion, MotionStep, NumericStep, Pair, StepFunction
from sitl.vehicle.shaping import ShapedStep
from sitl.vehicle.wind import Wind, low_altitude

STEP_S: Final = 0.02
"""The physics step of motion without an exact solution: shaped, or in wind that changes or causes drag."""
_STEPS_KEPT: Final = 16
"""The number of cached discretisations: setpoints and samples divide each tick in few different ways."""


class VehicleBody:
    """Moves one vehicle; setpoints act one delay after they were sent."""

    def __init__(
        self,
        plant: Plant,
        start_m: Pair,
        altitude_m: float,
        disturbance_m_s2: Pair,
        imperfections: Imperfections,
        random: np.random.Generator,
        step: StepFunction | None = None,
    ) -> None:
        """Put it at rest at `start_m`, at time 0; `step` replaces the plant and the shaping limits."""
        x, y = start_m
        self._motion: Motion = (x, y, 0.0, 0.0)
        self.disturbance_m_s2 = disturbance_m_s2
        self._aim_m, self._off_m = start_m, (0.0, 0.0)
        self._delay_s = plant.delay_s
        self._pending: deque[tuple[float, Pair]] = deque()
        new_step: Callable[[float], MotionStep] = partial(FunctionStep, step) if step else partial(NumericStep, plant)
        self._exact_step = lru_cache(_STEPS_KEPT)(new_step)
        shape = None if step else imperfections.shape
        self._shaped = None if shape is None else ShapedStep(plant, STEP_S, shape)
        self._acceleration = (0.0, 0.0)
        windy = imperfections.gusts or imperfections.wind_m_s != (0.0, 0.0)
        gusts = low_altitude(float(np.hypot(*imperfections.wind_m_s)), altitude_m) if imperfections.gusts else None
        self._wind = Wind(imperfections.wind_m_s, gusts, STEP_S, random) if windy else None
        self._drag_per_s = imperfections.drag_per_s
        self._in_steps = self._shaped is not None or self._wind is not None
        self._now_s = self._flown_s = 0.0

    @property
    def motion(self) -> Motion:
        """The present true motion, extrapolated from the last whole physics step."""
        ahead_s = self._now_s - self._flown_s
        if not self._in_steps or ahead_s <= 0.0:
            return self._motion
        x, y, x_rate, y_rate = self._motion
        return x + x_rate * ahead_s, y + y_rate * ahead_s, x_rate, y_rate

    def command(self, now_s: float, aim_m: Pair) -> None:
        """Send an aim: a setpoint, with its velocity if the plant has feed-forward."""
        self._pending.append((now_s + self._delay_s, aim_m))

    def rest(self, at_m: Pair | None = None) -> None:
        """Hold the present position, or put the vehicle at rest at a place; pending setpoints are dropped."""
        if at_m is not None:
            self._motion = (*at_m, 0.0, 0.0)
        self._pending.clear()
        (x, y, _, _), (off_x, off_y) = self._motion, self._off_m
        self._aim_m = x + off_x, y + off_y

    def advance(self, from_s: float, to_s: float, off_m: Pair) -> None:
        """Move with the estimation error `off_m`: the autopilot steers the estimate to the setpoint.

        In exact motion setpoints act exactly when they are due, otherwise at the next step.
        """
        self._off_m = off_m
        self._now_s = to_s
        if self._in_steps:
            self._advance_in_steps(to_s)
            return
        while self._pending and self._pending[0][0] <= to_s:
            acts_s, aim_m = self._pending.popleft()
            if acts_s > from_s:
                self._fly_exactly(acts_s - from_s)
                from_s = acts_s
            self._aim_m = aim_m
        self._fly_exactly(to_s - from_s)

    def _fly_exactly(self, step_s: float) -> None:
        step_s = rounded(step_s, 9)
        if step_s > 0.0:
            self._motion = self._exact_step(step_s).advance(self._motion, self._steered_m, self.disturbance_m_s2)

    @property
    def _steered_m(self) -> Pair:
        """The true position that the autopilot steers to: the aim less the error of its estimate."""
        (x, y), (off_x, off_y) = self._aim_m, self._off_m
        return x - off_x, y - off_y

    def _advance_in_steps(self, to_s: float) -> None:
        while self._flown_s + STEP_S <= to_s + 1e-9:
            while self._pending and self._pending[0][0] <= self._flown_s + 1e-9:
                self._aim_m = self._pending.popleft()[1]
            self._step(self.disturbance_m_s2 if self._wind is None else self._pushed(self._wind))
            self._flown_s = rounded(self._flown_s + STEP_S, 9)

    def _pushed(self, wind: Wind) -> Pair:
        """Return the disturbance by the wind of the next step."""
        (x, y), (push_x, push_y) = wind.blow(), self.disturbance_m_s2
        _, _, x_rate, y_rate = self._motion
        return push_x + self._drag_per_s * (x - x_rate), push_y + self._drag_per_s * (y - y_rate)

    def _step(self, push: Pair) -> None:
        before = self._motion
        if self._shaped is None:
            self._motion = self._exact_step(STEP_S).advance(before, self._steered_m, push)
            return
        self._motion = self._shaped.advance(before, self._acceleration, self._steered_m, push)
        self._acceleration = (self._motion[2] - before[2]) / STEP_S, (self._motion[3] - before[3]) / STEP_S
