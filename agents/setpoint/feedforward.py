"""Velocity feed-forward: the aim is split into a position setpoint and a velocity.

In the plant model all pairs with the same aim have the same effect, so the guard's result holds for any velocity. The
choice matters where the vehicle differs from its profile. The velocity sent is the one that the plant reaches under the
aim after half the time constant of its damping. At a steady speed the setpoint then needs no lead, and errors of a0 and
a1 have no effect; during acceleration they have half their effect. The velocity follows the guarded aim, so a braked
vehicle is sent less at once. A vehicle that stays is sent none, and comes to rest at the setpoint for any plant.
"""

from agents.control.plan import Plan
from agents.safety.guard import Guarded, GuardStatus
from agents.situation.situation import Situation
from estimation.plant.model import Plant
from estimation.vectors import Pair, clipped_pair

_REACHED = 0.5
"""The prediction time of the velocity, in time constants 1 / a1."""
_STILL = (0.0, 0.0)


class FeedForward:
    """Splits the aims of one vehicle; it has no state."""

    def __init__(self, plant: Plant, speed_max_m_s: float) -> None:
        self._plant = plant
        self._lead_s = plant.lead_s
        self._feeds = plant.feedforward > 0.0
        self._speed_max_m_s = speed_max_m_s

    def split(self, situation: Situation, plan: Plan, guarded: Guarded) -> tuple[Pair, tuple[float, ...]]:
        """Return the setpoint, and the velocity (x, y, z) to send with it, empty if the plant has no feed-forward."""
        x, y = guarded.aim_m.tolist()
        if not self._feeds:
            return (x, y), ()
        velocity = plan.velocity_m_s
        if guarded.status is GuardStatus.BRAKED:
            velocity = _STILL
        elif velocity is None:
            velocity = self._reached(situation, (x, y))
        x_rate, y_rate = clipped_pair(velocity, self._speed_max_m_s)
        lead_x, lead_y = self._lead_s
        return (x - lead_x * x_rate, y - lead_y * y_rate), (x_rate, y_rate, 0.0)

    def _reached(self, situation: Situation, aim_m: Pair) -> Pair:
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        w_x, w_y = situation.disturbance.tolist()
        along_x, along_y = self._plant.x, self._plant.y
        push_x = along_x.a0_per_s2 * (aim_m[0] - x) + w_x - along_x.a1_per_s * x_rate
        push_y = along_y.a0_per_s2 * (aim_m[1] - y) + w_y - along_y.a1_per_s * y_rate
        return x_rate + _REACHED * push_x / along_x.a1_per_s, y_rate + _REACHED * push_y / along_y.a1_per_s
