"""The monitor of one vehicle: the autopilot's reports, setpoint tracking, altitude limits, and flight time home."""

from collections.abc import Mapping
from math import hypot, inf
from typing import Final

from agents.ports import VehicleStatus
from agents.safety.endurance import Endurance, WayHome, return_duration_s
from agents.safety.failsafe import ALTITUDE_TOLERANCE_M, Condition, reported_faults
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from estimation.filters.own import OwnFilter
from estimation.plant.model import Plant, exact_step
from estimation.plant.watch import PlantWatch
from estimation.state import DISTURBANCE, POSITION

STEP_S: Final = 0.5
_LATE_MAX_S: Final = 1.9
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


PERIOD_S: Final = 1.0
"""The period of its checks: the conditions are slow, and a check takes 7 µs."""
_STEERED = (
    Tactic.FORMATION,
    Tactic.ENCIRCLE,
    Tactic.TRANSIT,
    Tactic.EXCITE,
    Tactic.ASIDE,
    Tactic.HOLD,
    Tactic.RETURN_AND_LAND,
)
_NOTHING: Mapping[Condition, str] = {}
_STAGGERED: Final = 8
_STAGGER_S: Final = 0.35
"""The vehicles of a process take turns in comparing plants, which takes a millisecond every ten seconds."""


class VehicleWatch:
    """Detects the conditions that concern one vehicle alone, while cordon steers it."""

    def __init__(self, config: AgentConfig, own: OwnFilter) -> None:
        self._config = config
        self._way_home = WayHome(config)
        self._following = Following(config.plant, own)
        self._endurance = Endurance(config.failsafe.battery_critical)
        self.plant = PlantWatch(config.plant, config.slots.index(config.vehicle_id) % _STAGGERED * _STAGGER_S)
        """Compares the vehicle's motion with its profile's plant."""
        self.status = VehicleStatus()
        """The autopilot's latest status."""
        self._seen = self.status
        self._reported: Mapping[Condition, str] = _NOTHING
        self._measured: Mapping[Condition, str] = _NOTHING
        self._present: Mapping[Condition, str] = _NOTHING
        self._tactic = Tactic.STANDBY
        self._next_s = -inf

    def change(self, config: AgentConfig) -> None:
        """Come home from the heights of another ring from now on."""
        self._config = config
        self._way_home.change(config)

    def faults(self, situation: Situation, tactic: Tactic) -> Mapping[Condition, str]:
        """Return the present conditions, each with the detail shown to people."""
        if self.status is not self._seen:
            self._seen = self.status
            self._endurance.see(situation.now_s, self.status.battery, self.status.endurance_s)
            self._reported = reported_faults(self.status, self._config.failsafe)
            self._present = {**self._reported, **self._measured}
        if situation.now_s >= self._next_s or tactic is not self._tactic:
            self._tactic, self._next_s = tactic, situation.now_s + PERIOD_S
            self._measured = self._measure(situation, tactic)
            self._present = {**self._reported, **self._measured}
        return self._present

    def _measure(self, situation: Situation, tactic: Tactic) -> Mapping[Condition, str]:
        faults: dict[Condition, str] = {}
        if (found := self.plant.found) is not None:
            differs = Condition.STIFFER if found.difference == "stiffer" else Condition.SOFTER
            faults[differs] = f"'{self._config.profile}': {found.text}"
        if tactic not in _STEERED:
            self._following.stop()
            return faults
        error_m = self._following.error_m(situation)
        if error_m > self._config.failsafe.following_m:
            faults[Condition.NOT_FOLLOWING] = f"{error_m:.1f} m from its predicted position"
        left_s = self._endurance.left_s(situation.now_s)
        if left_s < inf:
            self._compare(faults, situation, left_s)
        safety, height_m = self._config.safety, situation.height_m
        if tactic is not Tactic.RETURN_AND_LAND and (
            (safety.altitude_max_m is not None and height_m > safety.altitude_max_m + ALTITUDE_TOLERANCE_M)
            or (safety.altitude_min_m is not None and height_m < safety.altitude_min_m - ALTITUDE_TOLERANCE_M)
        ):
            faults[Condition.ALTITUDE_LEFT] = f"at {height_m:.1f} m"
        return faults

    def _compare(self, faults: dict[Condition, str], situation: Situation, left_s: float) -> None:
        x, y = situation.own.mean[POSITION].tolist()
        w_x, w_y = situation.own.mean[DISTURBANCE].tolist()
        way_s = return_duration_s(self._config, self._way_home.places_m((x, y)), (x, y), situation.height_m, (w_x, w_y))
        if left_s < way_s + self._config.failsafe.reserve_s:
            faults[Condition.NO_WAY_HOME] = f"{left_s:.0f} s of flight left, the flight home takes {way_s:.0f} s"
