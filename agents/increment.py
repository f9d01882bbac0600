"""How far a setpoint moves from tick to tick: an estimate or a plan that jumps is followed, and no faster than this.

The guard comes after it: what keeps vehicles apart moves a setpoint as far as it has to be moved.
"""

from math import inf

from agents.settings import SafetySettings
from agents.situation import Wish, shifted, towards
from agents.tactics import Tactic
from estimation.state import Vector

_FREE = (Tactic.EXCITE, Tactic.LAND, Tactic.STOOD_DOWN)
"""Steps are what a flight for identification is made of, within bounds of its own; and in the others nobody obeys."""


class Increment:
    """Bounds the way of one vehicle's setpoint; remembers the last one that was sent, and so winds nothing up."""

    def __init__(self, safety: SafetySettings) -> None:
        self._speed_max_m_s = safety.setpoint_speed_bound_m_s
        self._sent_m: Vector | None = None
        self._sent_s = -inf

    def bounded(self, tactic: Tactic, wish: Wish, now_s: float) -> Wish:
        """Return the wish, or what of it can be reached by `now_s` from the setpoint sent last."""
        if self._sent_m is None or tactic in _FREE:
            return wish
        return shifted(wish, towards(wish.setpoint_m, self._sent_m, self._speed_max_m_s * (now_s - self._sent_s)))

    def sent(self, setpoint_m: Vector, now_s: float) -> None:
        """Take the setpoint (2,) that is sent."""
        self._sent_m, self._sent_s = setpoint_m, now_s
