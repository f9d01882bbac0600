"""The yaw of its setpoints, counter-clockwise from the mission's x axis.

It turns at a bounded rate, the shorter way around, whatever the wanted direction does. Where no direction is wanted,
or none is known, it stays as it is.
"""

from math import atan2, hypot, radians

from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from estimation.frames import wrap_signed_rad
from estimation.state import POSITION, VELOCITY

STRAYS_M_S, RETURNS_M_S = 0.6, 0.3
"""A vehicle whose velocity is this far off the formation's flies off the line, until it is this near again."""
SURE_SIGMAS = 2.0
"""The target has a direction where it is farther away than so many standard deviations of its place."""


class Yaw:
    """Turns one vehicle; it remembers the yaw that was sent last."""

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
        """Return the yaw of the next setpoint; called once for each."""
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
        """Return the way that the vehicle flies; as fast as the formation, that is the mission's line."""
        x_rate, y_rate = situation.acting_motion[VELOCITY].tolist()
        off_m_s = hypot(x_rate - self._line_m_s, y_rate)
        self._strays = off_m_s > (RETURNS_M_S if self._strays else STRAYS_M_S)
        own_way = self._strays and hypot(x_rate, y_rate) > RETURNS_M_S
        return atan2(y_rate, x_rate) if own_way else 0.0

    def _target_rad(self, situation: Situation) -> float | None:
        """Return the direction of the target's estimate, None where that is too near to have one."""
        if situation.target is None or situation.acting_target is None:
            return None
        x, y = (situation.acting_target - situation.acting_motion)[POSITION].tolist()
        unsure_m = SURE_SIGMAS * situation.target.position_sigma_m
        return atan2(y, x) if hypot(x, y) > max(self._near_m, unsure_m) else None
