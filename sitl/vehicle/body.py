"""The true motion of one simulated vehicle: its plant, bounded or not, in the wind, with setpoints that come late."""

import numpy as np

from estimation.plant.model import Plant, exact_step
from estimation.state import POSITION, VELOCITY, Vector
from sitl.vehicle.imperfections import Imperfections
from sitl.vehicle.shaping import ShapedStep
from sitl.vehicle.wind import Wind, low_altitude

STEP_S = 0.02
"""The physics step wherever the motion is not exact: shaped, or in a wind that changes or drags."""


class Body:
    """Moves one vehicle; setpoints act one delay after they were sent."""

    def __init__(
        self,
        plant: Plant,
        start_m: tuple[float, float],
        altitude_m: float,
        disturbance_m_s2: tuple[float, float],
        imperfections: Imperfections,
        random: np.random.Generator,
    ) -> None:
        """Put it at rest at `start_m`, at time 0."""
        self._motion: Vector = np.array([*start_m, 0.0, 0.0])
        self._plant = plant
        self._disturbance = np.array(disturbance_m_s2)
        self._aim_m: Vector = np.array(start_m)
        self._off_m: Vector = np.zeros(2)
        self._pending: list[tuple[float, Vector]] = []
        self._shaped = None if imperfections.shape is None else ShapedStep(plant, STEP_S, imperfections.shape)
        self._acceleration: Vector = np.zeros(2)
        windy = imperfections.gusts or imperfections.wind_m_s != (0.0, 0.0)
        gusts = low_altitude(float(np.hypot(*imperfections.wind_m_s)), altitude_m) if imperfections.gusts else None
        self._wind = Wind(imperfections.wind_m_s, gusts, STEP_S, random) if windy else None
        self._drag_per_s = imperfections.drag_per_s
        self._in_steps = self._shaped is not None or self._wind is not None
        self._now_s = self._flown_s = 0.0

    @property
    def motion(self) -> Vector:
        """The true motion (4,) now; since the last whole physics step it goes on straight."""
        ahead_s = self._now_s - self._flown_s
        if not self._in_steps or ahead_s <= 0.0:
            return self._motion
        motion = self._motion.copy()
        motion[POSITION] += motion[VELOCITY] * ahead_s
        return motion

    def command(self, now_s: float, aim_m: Vector) -> None:
        """Send an aim (2,) on its way: a setpoint, with the velocity beside it where the plant takes one."""
        self._pending.append((now_s + self._plant.delay_s, aim_m))

    def rest(self, at_m: tuple[float, float] | None = None) -> None:
        """Let the autopilot hold it where it is, or put it at rest at a place; setpoints on their way are lost."""
        if at_m is not None:
            self._motion = np.array([*at_m, 0.0, 0.0])
        self._pending.clear()
        self._aim_m = self._motion[POSITION] + self._off_m

    def advance(self, from_s: float, to_s: float, off_m: tuple[float, float]) -> None:
        """Move on while the vehicle's own estimate is off by `off_m`: what it steers to a setpoint is its estimate.

        An exact motion changes setpoints exactly when they take effect, any other at its next step.
        """
        self._off_m = np.array(off_m)
        self._now_s = to_s
        if self._in_steps:
            self._advance_in_steps(to_s)
            return
        while self._pending and self._pending[0][0] <= to_s:
            acts_s, aim_m = self._pending.pop(0)
            self._fly_exactly(max(acts_s, from_s) - from_s)
            from_s = max(acts_s, from_s)
            self._aim_m = aim_m
        self._fly_exactly(to_s - from_s)

    def _fly_exactly(self, step_s: float) -> None:
        step_s = round(step_s, 9)
        if step_s > 0.0:
            step = exact_step(self._plant, step_s)
            self._motion = step.advance(self._motion, self._aim_m - self._off_m, self._disturbance)

    def _advance_in_steps(self, to_s: float) -> None:
        while self._flown_s + STEP_S <= to_s + 1e-9:
            while self._pending and self._pending[0][0] <= self._flown_s + 1e-9:
                self._aim_m = self._pending.pop(0)[1]
            self._step(self._disturbance + self._push())
            self._flown_s = round(self._flown_s + STEP_S, 9)

    def _push(self) -> Vector:
        if self._wind is None:
            return np.zeros(2)
        x, y = self._wind.blow()
        x_rate, y_rate = self._motion[VELOCITY].tolist()
        return np.array([self._drag_per_s * (x - x_rate), self._drag_per_s * (y - y_rate)])

    def _step(self, push: Vector) -> None:
        before, aim_m = self._motion, self._aim_m - self._off_m
        if self._shaped is None:
            self._motion = exact_step(self._plant, STEP_S).advance(before, aim_m, push)
        else:
            self._motion = self._shaped.advance(before, self._acceleration, aim_m, push)
            self._acceleration = (self._motion[VELOCITY] - before[VELOCITY]) / STEP_S
