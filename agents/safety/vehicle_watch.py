"""The monitor of one vehicle: the autopilot's reports, setpoint tracking, altitude limits, and flight time home."""

from collections.abc import Mapping
from math import inf

from agents.ports import VehicleStatus
from agents.safety.failsafe import Condition
from agents.safety.following import Following
from agents.safety.reported_faults import reported_faults
from agents.safety.way_home import Endurance, way_home_s
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from estimation.filters.own import OwnFilter
from estimation.state import DISTURBANCE, POSITION

PERIOD_S = 1.0
"""The period of its checks: the conditions are slow, and a check takes 7 µs."""
ALTITUDE_TOLERANCE_M = 1.0
"""The guard keeps setpoints within the limits; the height error of an autopilot is up to half a metre."""
_STEERED = (
    Tactic.FORMATION,
    Tactic.ENCIRCLE,
    Tactic.EXCITE,
    Tactic.ASIDE,
    Tactic.HOLD,
    Tactic.RETURN_AND_LAND,
)
_NOTHING: Mapping[Condition, str] = {}


class VehicleWatch:
    """Detects the conditions that concern one vehicle alone, while cordon steers it."""

    def __init__(self, config: AgentConfig, own: OwnFilter) -> None:
        self._config = config
        self._following = Following(config.plant, own)
        self._endurance = Endurance(config.failsafe.battery_critical)
        self.status = VehicleStatus()
        """The autopilot's latest status."""
        self._seen = self.status
        self._reported: Mapping[Condition, str] = _NOTHING
        self._measured: Mapping[Condition, str] = _NOTHING
        self._present: Mapping[Condition, str] = _NOTHING
        self._tactic = Tactic.STANDBY
        self._next_s = -inf

    def faults(self, situation: Situation, tactic: Tactic) -> Mapping[Condition, str]:
        """Return the present conditions, each with the detail shown to people."""
        if self.status is not self._seen:
            self._seen = self.status
            self._endurance.see(situation.now_s, self.status.battery, self.status.endurance_s)
            limits = self._config.failsafe
            self._reported = reported_faults(self.status, limits.tilt_max_deg, limits.wind_max_m_s)
            self._present = {**self._reported, **self._measured}
        if situation.now_s >= self._next_s or tactic is not self._tactic:
            self._tactic, self._next_s = tactic, situation.now_s + PERIOD_S
            self._measured = self._measure(situation, tactic)
            self._present = {**self._reported, **self._measured}
        return self._present

    def _measure(self, situation: Situation, tactic: Tactic) -> Mapping[Condition, str]:
        if tactic not in _STEERED:
            self._following.stop()
            return _NOTHING
        faults: dict[Condition, str] = {}
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
        way_s = way_home_s(self._config, (x, y), situation.height_m, (w_x, w_y))
        if left_s < way_s + self._config.failsafe.reserve_s:
            faults[Condition.NO_WAY_HOME] = f"{left_s:.0f} s of flight left, the flight home takes {way_s:.0f} s"
