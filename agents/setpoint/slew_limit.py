"""The slew limit: how far an aim may move per tick after a jump of an estimate or a plan.

The guard acts after it, and may move the aim farther.
"""

from agents.control.aims import shifted, towards
from agents.control.plan import Plan
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from estimation.state import Vector

_FREE = (Tactic.EXCITE, Tactic.LAND, Tactic.PILOT_OVERRIDE)
"""An identification flight consists of steps within its own bounds; in the other tactics the aim has no effect."""


class SlewLimit:
    """Bounds the motion of one vehicle's aim, relative to the last aim sent, which prevents wind-up."""

    def __init__(self, config: AgentConfig) -> None:
        # Per tick, not per time: a clock step neither lifts nor tightens the limit.
        self._longest_m = config.safety.setpoint_speed_bound_m_s / config.rate_hz
        self._sent_m: Vector | None = None

    def bounded(self, tactic: Tactic, plan: Plan) -> Plan:
        """Return the plan with its aim within one tick's limit of the aim sent last."""
        if self._sent_m is None or tactic in _FREE:
            return plan
        return shifted(plan, towards(plan.aim_m, self._sent_m, self._longest_m))

    def sent(self, aim_m: Vector) -> None:
        """Record the aim (2,) that is sent."""
        self._sent_m = aim_m
