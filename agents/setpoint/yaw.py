"""The yaw of setpoints, counter-clockwise from the mission's x axis.

It turns at a bounded rate in the shorter direction. If no direction is wanted or known, it stays as it is.
"""

from math import atan2, hypot, radians

from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from estimation.frames import wrap_signed_rad
from estimation.state import POSITION, VELOCITY

STRAYS_M_S, RETURNS_M_S = 0.6, 0.3
"""A vehicle whose velocity differs from the formation's by more than the larger one has left the line, until the
difference is below the smaller one.
"""
SURE_SIGMAS = 2.0
"""The direction to the target is used if its distance is more than this many standard deviations of its position."""


class Yaw:
    """Computes the yaw of one vehicle; its state is the yaw sent last."""

    def __init__(self, config: AgentConfig) -> None:
        self._along_path = config.formation.yaw == "path"
        self._at_target = config.encirclement.yaw == "target"
        self._turns = config.turns_nose
        self._line_m_s = config.formation.speed_m_s
        self._near_m = config.encirclement.radius_min_m
        self._step_rad = radians(config.safety.yaw_rate_max_deg_s) / config.rate_hz
        self._yaw_rad = 0.0
        self._strays = False

    def turn(self, tactic: Tactic, situation: Situation) -> float:
        """Return the yaw of the next setpoint; to be called once for each."""
        if not self._turns:
            return 0.0
        wanted_rad = self._wanted_rad(tactic, situation)
        if wanted_rad is not None:
            left_rad = wrap_signed_rad(wanted_rad - self._yaw_rad)
            step_rad = min(max(left_rad, -self._step_rad), self._step_rad)
            self._yaw_rad = wrap_signed_rad(self._yaw_rad + step_rad)
        return self._yaw_rad

    def _wanted_rad(self, tactic: Tactic, situation: Situation) -> float | None:
        if tactic is Tactic.FORMATION:
            return self._path_rad(situation) if self._along_path else 0.0
        if tactic is Tactic.ENCIRCLE:
            return self._target_rad(situation) if self._at_target else 0.0
        return None

    def _path_rad(self, situation: Situation) -> float:
        """Return the direction of flight; at the formation's velocity that of the mission line."""
        x_rate, y_rate = situation.acting_motion[VELOCITY].tolist()
        off_m_s = hypot(x_rate - self._line_m_s, y_rate)
        self._strays = off_m_s > (RETURNS_M_S if self._strays else STRAYS_M_S)
        own_way = self._strays and hypot(x_rate, y_rate) > RETURNS_M_S
        return atan2(y_rate, x_rate) if own_way else 0.0

    def _target_rad(self, situation: Situation) -> float | None:
        """Return the direction to the estimated target, None if it is too near for one."""
        if situation.target is None or situation.acting_target is None:
            return None
        x, y = (situation.acting_target - situation.acting_motion)[POSITION].tolist()
        unsure_m = SURE_SIGMAS * situation.target.position_sigma_m
        return atan2(y, x) if hypot(x, y) > max(self._near_m, unsure_m) else None
