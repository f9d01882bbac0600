"""Cyclic pursuit: each vehicle follows the angle to the next one on the ring, and no other.

The rate of vehicle i is w + k (phi_ahead - phi_i - 2 pi / n): all gaps become even from any start, with messages of one
neighbour. Radius and rate are the mission's, the formation is flown by cordon's planner.
"""

from math import cos, sin, tau

import numpy as np

import cordon

SPACING_GAIN_PER_S = 0.15
RADIUS_GAIN_PER_S = 0.4
VELOCITY_GAIN_PER_S = 1.5
RATE_CHANGE_MAX = 0.5
"""The most by which the spacing changes the rate, as a share of the mission's."""
INWARD_MAX_M_S = 1.0


class CyclicPursuit:
    """Plans one vehicle's ring."""

    def __init__(self, config: cordon.AgentConfig) -> None:
        ring = config.encirclement
        self._radius_m, self._rate_rad_s = ring.radius_m, ring.angular_rate_rad_s
        self._plant = config.plant

    def plan(self, task: cordon.Task) -> cordon.Plan | None:
        """Return the aim at which the plant follows the wanted velocity; None in formation and without a target."""
        situation = task.situation
        if task.tactic.value != "encircle" or situation.acting_centre is None:
            return None
        x, y, x_rate, y_rate = situation.acting_motion - situation.acting_centre
        radius_m, bearing_rad = float(np.hypot(x, y)), float(np.arctan2(y, x))
        gap_rad, even_rad = self._gap_rad(task, bearing_rad)
        most = RATE_CHANGE_MAX * abs(self._rate_rad_s)
        rate_rad_s = self._rate_rad_s + float(np.clip(SPACING_GAIN_PER_S * (gap_rad - even_rad), -most, most))
        inward = RADIUS_GAIN_PER_S * (self._radius_m - radius_m)
        out_m_s = float(np.clip(inward, -INWARD_MAX_M_S, INWARD_MAX_M_S))
        outwards = np.array([cos(bearing_rad), sin(bearing_rad)])
        along = np.array([-sin(bearing_rad), cos(bearing_rad)])
        wanted_m_s = out_m_s * outwards + radius_m * rate_rad_s * along
        velocity_m_s = np.array([x_rate, y_rate])
        pull_m_s2 = VELOCITY_GAIN_PER_S * (wanted_m_s - velocity_m_s) - radius_m * rate_rad_s**2 * outwards
        own_m_s = situation.acting_motion[2:]
        push_m_s2 = pull_m_s2 + self._plant.a1_per_s * own_m_s
        undisturbed_m = situation.acting_motion[:2] + push_m_s2 / self._plant.a0_per_s2
        aim_m = undisturbed_m - situation.compensation / self._plant.a0_per_s2
        return cordon.Plan(aim_m, undisturbed_m, own_m_s, values={"gap_rad": gap_rad, "rate_rad_s": rate_rad_s})

    def _gap_rad(self, task: cordon.Task, bearing_rad: float) -> tuple[float, float]:
        """Return the angle to the next vehicle ahead, counter-clockwise, and that of even gaps."""
        at_s = task.situation.acting_s
        angles = [peer.angle for peer in task.peers if peer.tactic == "encircle" and peer.angle is not None]
        ahead = [
            (each.bearing_rad + each.angular_rate_rad_s * (at_s - each.time_s) - bearing_rad) % tau for each in angles
        ]
        return min(ahead, default=tau), tau / (1 + len(ahead))
