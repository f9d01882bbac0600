"""Whether a vehicle follows its setpoints: its distance from where its plant would have taken it."""

from math import hypot

from agents.situation.situation import Situation
from estimation.filters.own import OwnFilter
from estimation.plant.model import Plant, exact_step

STEP_S = 0.5
_LATE_MAX_S = 1.9
"""The own filter keeps the setpoints of two seconds: after a longer pause the model starts again."""


class Following:
    """The plant x'' = a0 (u - x) - a1 x', driven by the setpoints sent alone, beside the vehicle.

    Telemetry does not correct it. It needs none: the setpoints themselves attract it, so a steady disturbance w
    displaces the vehicle by w / a0 only. A vehicle that ignores its setpoints is off by up to the setpoint's lead, one
    that is carried away by more.
    """

    def __init__(self, plant: Plant, own: OwnFilter) -> None:
        step = exact_step(plant, STEP_S)
        # By axis: position and velocity from each other, and from the aim. Scalars cost a fifth of matrices.
        self._steps = [
            (*step.transition[[p, p, v, v], [p, v, p, v]].tolist(), *step.input_gain[[p, v], [p, p]].tolist())
            for p, v in ((0, 2), (1, 3))
        ]
        self._own = own
        self._jumps = 0
        self._axes: list[tuple[float, float]] = []
        self._time_s = 0.0

    def stop(self) -> None:
        """Start again at the vehicle's next position: it has flown without setpoints, or its estimate has moved."""
        self._axes = []

    def error_m(self, situation: Situation) -> float:
        """Return how far the vehicle is from the model [m]; to be called about once a second."""
        now_s = situation.now_s
        x, y, x_rate, y_rate, *_ = situation.own.mean.tolist()
        if self._jumps != self._own.jumps:
            self._jumps = self._own.jumps
            self.stop()
        if not self._axes or now_s - self._time_s > _LATE_MAX_S:
            self._axes, self._time_s = [(x, x_rate), (y, y_rate)], now_s
            return 0.0
        while now_s - self._time_s >= STEP_S:
            self._advance()
        since_s = now_s - self._time_s
        (model_x, _), (model_y, _) = self._axes
        return hypot(x - model_x - x_rate * since_s, y - model_y - y_rate * since_s)

    def _advance(self) -> None:
        aims_m = self._own.mean_aim_m(self._time_s, self._time_s + STEP_S)
        self._axes = [
            (pp * p + pv * v + aimed_p * aim_m, vp * p + vv * v + aimed_v * aim_m)
            for (p, v), (pp, pv, vp, vv, aimed_p, aimed_v), aim_m in zip(self._axes, self._steps, aims_m, strict=True)
        ]
        self._time_s += STEP_S
