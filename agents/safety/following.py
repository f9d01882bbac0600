"""Whether a vehicle follows its setpoints: its distance from where its plant would have taken it."""

from math import hypot

import numpy as np

from agents.situation.situation import Situation
from estimation.filters.own import OwnFilter
from estimation.plant.model import Plant, exact_step
from estimation.state import MOTION, VELOCITY, Vector

STEP_S = 0.5
_LATE_MAX_S = 1.5
"""The own filter keeps the setpoints of two seconds: after a longer pause the model starts again."""
_NO_DISTURBANCE = np.zeros(2)


class Following:
    """The plant x'' = a0 (u - x) - a1 x', driven by the setpoints sent alone, beside the vehicle.

    Telemetry does not correct it. It needs none: the setpoints themselves attract it, so a steady disturbance w
    displaces the vehicle by w / a0 only. A vehicle that ignores its setpoints is off by up to the setpoint's lead, one
    that is carried away by more.
    """

    def __init__(self, plant: Plant, own: OwnFilter) -> None:
        self._step = exact_step(plant, STEP_S)
        self._own = own
        self._jumps = 0
        self._motion: Vector | None = None
        self._time_s = 0.0

    def stop(self) -> None:
        """Start again at the vehicle's next position: it has flown without setpoints, or its estimate has moved."""
        self._motion = None

    def error_m(self, situation: Situation) -> float:
        """Return how far the vehicle is from the model [m]; to be called at least twice a second."""
        now_s, own = situation.now_s, situation.own.mean
        if self._jumps != self._own.jumps:
            self._jumps = self._own.jumps
            self.stop()
        if self._motion is None or now_s - self._time_s > _LATE_MAX_S:
            self._motion, self._time_s = own[MOTION].copy(), now_s
            return 0.0
        while now_s - self._time_s >= STEP_S:
            aim_m = self._own.mean_aim_m(self._time_s, self._time_s + STEP_S)
            self._motion = self._step.advance(self._motion, np.array(aim_m), _NO_DISTURBANCE)
            self._time_s += STEP_S
        since_s, (x_rate, y_rate) = now_s - self._time_s, own[VELOCITY].tolist()
        x, y, *_ = (own[MOTION] - self._motion).tolist()
        return hypot(x - x_rate * since_s, y - y_rate * since_s)
