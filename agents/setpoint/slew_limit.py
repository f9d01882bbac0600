"""How far an aim moves from tick to tick: an estimate or a plan that jumps is followed, and no faster than this.

The guard comes after it: it moves an aim as far as separation needs.
"""

from agents.control.plan import Plan, shifted, towards
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from estimation.state import Vector

_FREE = (Tactic.EXCITE, Tactic.LAND, Tactic.PILOT_OVERRIDE)
"""A flight for identification is made of steps, within bounds of its own; in the others the aim steers nothing."""


class SlewLimit:
    """Bounds the way of one vehicle's aim; it remembers the last one that was sent, and so does not wind up."""

    def __init__(self, config: AgentConfig) -> None:
        # By ticks, not by time: a clock that steps neither frees an aim nor holds it.
        self._longest_m = config.safety.setpoint_speed_bound_m_s / config.rate_hz
        self._sent_m: Vector | None = None

    def bounded(self, tactic: Tactic, plan: Plan) -> Plan:
        """Return the plan, its aim no farther than one tick's way from the one that was sent last."""
        if self._sent_m is None or tactic in _FREE:
            return plan
        return shifted(plan, towards(plan.aim_m, self._sent_m, self._longest_m))

    def sent(self, aim_m: Vector) -> None:
        """Take the aim (2,) of what is sent."""
        self._sent_m = aim_m
