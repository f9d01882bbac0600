"""Target blending: the centre of the ring follows the target's estimate without a jump after a blackout.

When the target is seen again, the centre starts at its last position, catches up with the target with bounded
acceleration and speed, and is then blended into the estimate over some seconds.
"""

from math import hypot

import numpy as np

from agents.settings.config import AgentConfig
from agents.situation.situation import moved
from agents.tactics import mixing_share
from estimation.filters.target import OUT_OF_SIGHT_S
from estimation.state import POSITION, VELOCITY, TargetEstimate, Vector
from estimation.vectors import clipped

_ACCELERATION_M_S2 = 0.8
_RATE_PER_S = 0.8
_SPEED_SHARE = 0.8
_CAUGHT_M, _CAUGHT_M_S, _HAND_OVER_S = 0.5, 0.5, 5.0


class TargetBlend:
    """Follows one vehicle's estimate of the target; its state is the centre while it differs from the estimate."""

    def __init__(self, config: AgentConfig) -> None:
        ring = config.encirclement
        # Meanwhile the ring's rate is lowered (agents/ring/feasibility.py), which leaves speed for catching up.
        self._speed_max_m_s = _SPEED_SHARE * min(ring.speed_max_m_s, config.safety.speed_max_m_s)
        self._before: TargetEstimate | None = None
        self._centre: Vector | None = None
        self._time_s = 0.0
        self._caught_s: float | None = None

    @property
    def catching_up(self) -> bool:
        """Whether the centre differs from the estimate of the target."""
        return self._centre is not None

    def centre(self, estimate: TargetEstimate | None, now_s: float) -> Vector | None:
        """Return the centre's motion (4,), None without an estimate."""
        before, self._before = self._before, estimate
        if estimate is None:
            self._centre = None
            return None
        if before is not None and estimate.sighted_s - before.sighted_s > OUT_OF_SIGHT_S:
            self._centre = moved(before.mean, 0.0) if self._centre is None else self._centre
            self._caught_s = None
        if self._centre is None:
            self._time_s = now_s
            return estimate.mean
        self._follow(self._centre, estimate.mean, now_s - self._time_s)
        self._time_s = now_s
        return self._mixed(self._centre, estimate.mean, now_s)

    def _follow(self, centre: Vector, goal: Vector, step_s: float) -> None:
        """Move the centre by a step towards a goal (4,), critically damped."""
        way = goal[POSITION] - centre[POSITION]
        wanted = clipped(goal[VELOCITY] + _RATE_PER_S / 2.0 * way, self._speed_max_m_s)
        change = clipped(2.0 * _RATE_PER_S * (wanted - centre[VELOCITY]), _ACCELERATION_M_S2)
        centre[POSITION] += centre[VELOCITY] * step_s + change * step_s**2 / 2.0
        centre[VELOCITY] += change * step_s

    def _mixed(self, centre: Vector, goal: Vector, now_s: float) -> Vector:
        away = goal - centre
        if self._caught_s is None:
            near = hypot(*away[POSITION].tolist()) < _CAUGHT_M and hypot(*away[VELOCITY].tolist()) < _CAUGHT_M_S
            self._caught_s = now_s if near else None
            return centre.copy()
        share = mixing_share(now_s - self._caught_s, _HAND_OVER_S)
        if share >= 1.0:
            self._centre = None
            return goal
        return np.asarray(centre + share * away, dtype=np.float64)
