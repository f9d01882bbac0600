"""How far a setpoint moves from tick to tick: an estimate or a plan that jumps is followed, and no faster than this.

The guard comes after it: what keeps vehicles apart moves a setpoint as far as it has to be moved.
"""

from agents.settings import AgentConfig
from agents.situation import Wish, shifted, towards
from agents.tactics import Tactic
from estimation.state import Vector

_FREE = (Tactic.EXCITE, Tactic.LAND, Tactic.STOOD_DOWN)
"""Steps are what a flight for identification is made of, within bounds of its own; and in the others nobody obeys."""


class Increment:
    """Bounds the way of one vehicle's setpoint; remembers the last one that was sent, and so winds nothing up."""

    def __init__(self, config: AgentConfig) -> None:
        # By ticks, not by time: a clock that steps neither frees a setpoint nor holds it.
        self._longest_m = config.safety.setpoint_speed_bound_m_s / config.rate_hz
        self._sent_m: Vector | None = None

    def bounded(self, tactic: Tactic, wish: Wish) -> Wish:
        """Return the wish, or what of it can be reached in a tick from the setpoint that was sent last."""
        if self._sent_m is None or tactic in _FREE:
            return wish
        return shifted(wish, towards(wish.setpoint_m, self._sent_m, self._longest_m))

    def sent(self, setpoint_m: Vector) -> None:
        """Take the setpoint (2,) that is sent."""
        self._sent_m = setpoint_m
