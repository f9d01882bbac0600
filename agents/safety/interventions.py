"""When the guard begins to change aims, for people: once, and not again while it goes on and off."""

from math import hypot, inf

from agents.safety.guard import Guarded
from estimation.state import Vector

QUIET_S = 5.0
"""After this long without an intervention the next one is news again."""


class Interventions:
    """Watches one vehicle's guard; it remembers when that intervened last."""

    def __init__(self) -> None:
        self._last_s = -inf

    def news(self, now_s: float, aim_m: Vector, guarded: Guarded) -> tuple[str, str] | None:
        """Return the causes, and what was done to the planned aim (2,); None if there is nothing new."""
        if not guarded.causes:
            return None
        quiet_s, self._last_s = now_s - self._last_s, now_s
        if quiet_s <= QUIET_S:
            return None
        (x, y), moved_m = aim_m.tolist(), hypot(*(guarded.aim_m - aim_m).tolist())
        causes = ", ".join(cause.words for cause in guarded.causes)
        return causes, f"the planned aim ({x:.2f}, {y:.2f}) m was moved by {moved_m:.2f} m"
