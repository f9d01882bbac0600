"""Whether a vehicle follows its setpoints: its distance from the position that its plant model predicts."""

from math import hypot

from agents.situation.situation import Situation
from estimation.filters.own import OwnFilter
from estimation.plant.model import Plant, exact_step

STEP_S = 0.5
_LATE_MAX_S = 1.9
"""The own filter keeps the setpoints of two seconds: after a longer pause the model restarts."""


class Following:
    """The plant model x'' = a0 (u + w / a0 - x) - a1 x', driven by the setpoints sent, to compare with the vehicle.

    Telemetry does not correct its position, and need not: the model converges to the setpoints. The disturbance w is
    the own filter's, which is bounded and contains what the controller compensates: wind and errors of the plant. The
    error of a vehicle that ignores its setpoints reaches the setpoint's lead less the bound of w / a0; that of a
    drifting vehicle exceeds it.
    """

    def __init__(self, plant: Plant, own: OwnFilter) -> None:
        step = exact_step(plant, STEP_S)
        # The discrete model by axis, with scalars, which take a fifth of the time of matrices.
        self._steps = [
            (*step.transition[[p, p, v, v], [p, v, p, v]].tolist(), *step.input_gain[[p, v], [p, p]].tolist())
            for p, v in ((0, 2), (1, 3))
        ]
        self._stiffness = (plant.x.a0_per_s2, plant.y.a0_per_s2)
        self._own = own
        self._jumps = 0
        self._axes: list[tuple[float, float]] = []
        self._time_s = 0.0

    def stop(self) -> None:
        """Restart at the vehicle's next position: it has flown without setpoints, or its estimate has jumped."""
        self._axes = []

    def error_m(self, situation: Situation) -> float:
        """Return the distance of the vehicle from the model [m]; to be called about once a second."""
        now_s = situation.now_s
        x, y, x_rate, y_rate, x_disturbance, y_disturbance = situation.own.mean.tolist()
        if self._jumps != self._own.jumps:
            self._jumps = self._own.jumps
            self.stop()
        if not self._axes or now_s - self._time_s > _LATE_MAX_S:
            self._axes, self._time_s = [(x, x_rate), (y, y_rate)], now_s
            return 0.0
        while now_s - self._time_s >= STEP_S:
            self._advance((x_disturbance, y_disturbance))
        since_s = now_s - self._time_s
        (model_x, _), (model_y, _) = self._axes
        return hypot(x - model_x - x_rate * since_s, y - model_y - y_rate * since_s)

    def _advance(self, disturbance_m_s2: tuple[float, float]) -> None:
        sent_m = self._own.mean_aim_m(self._time_s, self._time_s + STEP_S)
        acting = zip(sent_m, disturbance_m_s2, self._stiffness, strict=True)
        aims_m = [aim_m + along_m_s2 / a0_per_s2 for aim_m, along_m_s2, a0_per_s2 in acting]
        self._axes = [
            (pp * p + pv * v + aimed_p * aim_m, vp * p + vv * v + aimed_v * aim_m)
            for (p, v), (pp, pv, vp, vv, aimed_p, aimed_v), aim_m in zip(self._axes, self._steps, aims_m, strict=True)
        ]
        self._time_s += STEP_S
