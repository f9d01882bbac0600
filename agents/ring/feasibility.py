"""Ring feasibility: a ring that is too fast about the present target is slowed, then widened.

Each vehicle computes the ring that it can fly from its own estimate, in steps and with hysteresis, and publishes it.
All members fly the most restricted of these, so they have the same rate and keep their spacing.
"""

from math import inf, sqrt
from typing import Final

from agents.ring.commanded_ring import ChangingRing
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from agents.team.ring_members import FULL_RING, RingScale

RESERVE: Final = 0.95
"""The share of the speed limit that target speed and ring speed may use together."""
BROKEN_MAX: Final = 0.25
"""The largest radius error, as a share of the radius, when the target turns by 90 degrees."""
_FLOOR: Final = 0.3
_WIDEST: Final = 2.0
_STEPS: Final = 10.0
_WORSE_S: Final = 0.5
_BETTER_S: Final = 8.0
_UNKNOWN_S: Final = 3.0
"""For this long after the first sighting the estimated speed is unreliable: two outliers can determine it."""
_RATE_PER_S: Final = 0.1
_RADIUS_PER_S: Final = 0.05
_LITTLE: Final = 0.1
"""A ring that leaves less than this share of its speed for the target's motion is the cause by itself."""


class RingFeasibility:
    """Computes the ring that one vehicle can fly, and moves smoothly to the one that all members can fly."""

    def __init__(self, config: AgentConfig) -> None:
        ring, safety = config.encirclement, config.safety
        self._ring = ChangingRing(ring)
        self._speed_m_s = RESERVE * min(ring.speed_max_m_s, safety.speed_max_m_s)
        self._acceleration_m_s2 = min(ring.acceleration_max_m_s2, safety.acceleration_max_m_s2)
        self._easy_m_s = self._slow_enough_m_s()
        self._target_m_s = 0.0
        self._is_relaxing = False
        self._worse_s = self._better_s = inf
        self._flown = FULL_RING
        self._time_s: float | None = None
        self._began_s = -inf
        self.needed = FULL_RING
        self.orbit = self._ring.orbit(1.0, 1.0)

    def reset(self) -> None:
        """Restart, when the vehicle comes to a new ring."""
        self.needed = self._flown = FULL_RING
        self._ring.arrive()
        self.orbit = self._ring.orbit(1.0, 1.0)
        self._worse_s = self._better_s = inf
        self._time_s = None

    def change(self, ring: EncirclementSettings) -> None:
        """Begin the way to another ring."""
        self._ring.change(ring)
        self._easy_m_s = self._slow_enough_m_s()

    def find(self, target_m_s: float, others: RingScale, now_s: float, *, joined: bool = True) -> str | None:
        """Update the ring for the target's speed; return a description of what has changed, None if nothing.

        `others` is the ring that all other members can fly. A vehicle that has not `joined` adopts it at once, so that
        its waiting place is not on their ring.
        """
        before, step_s = self.needed, 0.0 if self._time_s is None else now_s - self._time_s
        step_s = step_s if joined else inf
        if self._time_s is None:
            self._began_s = now_s
        self._time_s = now_s
        changed = self._change(step_s)
        if target_m_s <= self._easy_m_s and before == self._flown == others == FULL_RING:
            self._worse_s = inf
            if changed:
                self.orbit = self._ring.orbit(1.0, 1.0)
            return None
        if now_s - self._began_s >= _UNKNOWN_S:
            self._need(self.shares(target_m_s), target_m_s, now_s)
        wanted = self.needed.with_(others)
        if changed or (wanted is not self._flown and wanted != self._flown):
            self._flown = RingScale(
                _nearer(self._flown.rate, wanted.rate, _RATE_PER_S * step_s),
                _nearer(self._flown.radius, wanted.radius, _RADIUS_PER_S * step_s),
            )
            self.orbit = self._ring.orbit(self._flown.radius, self._flown.rate)
        return None if self.needed == before else self.words

    def _change(self, step_s: float) -> bool:
        """Continue the way to a commanded ring; return whether the ring has changed."""
        if not self._ring.changes:
            return False
        if step_s == inf:
            self._ring.arrive()
        elif step_s > 0.0:
            self._ring.advance(step_s)
        return True

    def shares(self, target_m_s: float) -> RingScale:
        """Return the feasible shares of the whole ring at a target speed, in whole steps.

        On one side of the ring the speeds of target and ring add up. A target that turns by 90 degrees changes its
        velocity by the root of two times its speed V: vehicles that respond with the acceleration A left by the ring
        fall behind by V²/A, which is limited to a share of the radius. The rate is lowered first, down to a floor; then
        the radius is raised; then the rate is lowered to what the speed limit allows.
        """
        ring = self._ring.settings
        radius_m, rate_rad_s = ring.radius_m, abs(ring.angular_rate_rad_s)
        turning = target_m_s**2 / BROKEN_MAX
        left_m_s2 = max(self._acceleration_m_s2 - turning / radius_m, 0.0)
        rate = min(1.0, _share(sqrt(left_m_s2 / radius_m), rate_rad_s))
        radius = 1.0
        if rate < _FLOOR:
            rate = min(_FLOOR, 1.0)
            squared = (rate * rate_rad_s) ** 2
            # The smallest root of squared R² - A R + turning = 0.
            root = self._acceleration_m_s2**2 - 4.0 * squared * turning
            wide_m = 2.0 * turning / (self._acceleration_m_s2 + sqrt(root)) if root >= 0.0 else inf
            radius = min(max(_whole_step(wide_m / radius_m, up=True), 1.0), _WIDEST)
        fast = _share(max(self._speed_m_s - target_m_s, 0.0), rate_rad_s * radius * radius_m)
        return RingScale(_whole_step(min(rate, fast), up=False), radius)

    def _slow_enough_m_s(self) -> float:
        """Return the target speed up to which the whole ring is flown."""
        ring = self._ring.settings
        along_m_s = abs(ring.angular_rate_rad_s) * ring.radius_m
        left_m_s2 = self._acceleration_m_s2 - along_m_s**2 / ring.radius_m
        return min(self._speed_m_s - along_m_s, sqrt(max(left_m_s2, 0.0) * BROKEN_MAX * ring.radius_m))

    @property
    def words(self) -> str:
        """How the flown ring differs from the whole one, and why, as text; empty if it does not."""
        if self.needed == FULL_RING:
            return ""
        rate, radius = self.needed.rate, self.needed.radius
        wider = f" and {radius:.0%} of its radius" if radius > 1.0 else ""
        return f"ring at {rate:.0%} of its rate{wider}: {self._why()}"

    def _why(self) -> str:
        target = f"the target moves at {self._target_m_s:.1f} m/s"
        ring = self._ring.settings
        along_m_s = abs(ring.angular_rate_rad_s) * ring.radius_m
        if self._target_m_s >= self._speed_m_s:
            return f"{target}, faster than the vehicles can follow"
        if self._is_relaxing:
            return f"{target} now; the rate rises by {1.0 / _STEPS:.0%} every {_BETTER_S:g} s"
        if self._target_m_s >= _LITTLE * along_m_s:
            return target
        if self._speed_m_s - along_m_s <= self._easy_m_s:
            return (
                f"the whole ring of {along_m_s:.2f} m/s leaves {max(self._easy_m_s, 0.0):.2f} m/s of the vehicles' "
                f"{self._speed_m_s:.2f} m/s for the motion of the target"
            )
        return (
            f"the whole ring needs {along_m_s**2 / ring.radius_m:.2f} m/s² of the vehicles' "
            f"{self._acceleration_m_s2:.2f} m/s², which leaves too little for the motion of the target"
        )

    def _need(self, found: RingScale, target_m_s: float, now_s: float) -> None:
        """Adopt a feasible ring once it has persisted: soon if it is more restricted, later if less."""
        worse = found.rate < self.needed.rate or found.radius > self.needed.radius
        better = not worse and found != self.needed
        self._worse_s = min(self._worse_s, now_s) if worse else inf
        self._better_s = min(self._better_s, now_s) if better else inf
        if self._is_relaxing:
            self._is_relaxing, self._target_m_s = better, target_m_s
        if now_s - self._worse_s >= _WORSE_S:
            self.needed, self._target_m_s, self._worse_s = self.needed.with_(found), target_m_s, inf
        elif now_s - self._better_s >= _BETTER_S:
            # Relax one step at a time: the improvement may not last.
            rate = min(found.rate, _whole_step(self.needed.rate + 1.0 / _STEPS, up=False))
            radius = max(found.radius, _whole_step(self.needed.radius - 1.0 / _STEPS, up=True))
            self.needed, self._target_m_s, self._better_s = RingScale(rate, radius), target_m_s, now_s
            self._is_relaxing = self.needed != found


def _share(allowed: float, wanted: float) -> float:
    return allowed / wanted if wanted > 0.0 else inf


def _whole_step(share: float, *, up: bool) -> float:
    """Return the share in whole steps, tolerant of rounding errors."""
    steps = share * _STEPS
    nearest = round(steps) if abs(steps) < inf else steps
    if abs(steps - nearest) > 1e-6:
        nearest = int(steps) + up
    return nearest / _STEPS


def _nearer(here: float, there: float, step: float) -> float:
    return there if abs(there - here) <= step else here + (step if there > here else -step)
