"""How far a setpoint moves from tick to tick: an estimate or a plan that jumps is followed, and no faster than this.

The guard comes after it: what keeps vehicles apart moves a setpoint as far as it has to be moved.
"""

from agents.control.plan import Plan, shifted, towards
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from estimation.state import Vector

_FREE = (Tactic.EXCITE, Tactic.LAND, Tactic.PILOT_OVERRIDE)
"""Steps are what a flight for identification is made of, within bounds of its own; and in the others nobody obeys."""


class SlewLimit:
    """Bounds the way of one vehicle's setpoint; remembers the last one that was sent, and so winds nothing up."""

    def __init__(self, config: AgentConfig) -> None:
        # By ticks, not by time: a clock that steps neither frees a setpoint nor holds it.
        self._longest_m = config.safety.setpoint_speed_bound_m_s / config.rate_hz
        self._sent_m: Vector | None = None

    def bounded(self, tactic: Tactic, plan: Plan) -> Plan:
        """Return the wish, or what of it can be reached in a tick from the setpoint that was sent last."""
        if self._sent_m is None or tactic in _FREE:
            return plan
        return shifted(plan, towards(plan.aim_m, self._sent_m, self._longest_m))

    def sent(self, aim_m: Vector) -> None:
        """Take the aim (2,) of what is sent."""
        self._sent_m = aim_m
