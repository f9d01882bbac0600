"""Notes of guard interventions: one for each intervention, including its short interruptions."""

from math import hypot, inf

from agents.safety.guard import Guarded
from estimation.state import Vector

QUIET_S = 5.0
"""After this long without an intervention the next one is reported again."""


class Interventions:
    """Monitors one vehicle's guard; its state is the time of the last intervention."""

    def __init__(self) -> None:
        self._last_s = -inf

    def news(self, now_s: float, aim_m: Vector, guarded: Guarded) -> tuple[str, str] | None:
        """Return the causes, and the change of the planned aim (2,), as text; None if there is nothing new."""
        if not guarded.causes:
            return None
        quiet_s, self._last_s = now_s - self._last_s, now_s
        if quiet_s <= QUIET_S:
            return None
        (x, y), moved_m = aim_m.tolist(), hypot(*(guarded.aim_m - aim_m).tolist())
        causes = ", ".join(cause.words for cause in guarded.causes)
        return causes, f"the planned aim ({x:.2f}, {y:.2f}) m was moved by {moved_m:.2f} m"
