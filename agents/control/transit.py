"""The way from one ring to another: out of the ring that the vehicle leaves, around others, towards the next.

The vehicle flies straight to the next ring's centre unless a ring is in its way. It leaves a ring outwards until the
way is free, and passes others along the tangents of a circle that is clear of them. Once nothing is in its way and the
next ring is within reach, that ring's law takes over (`agents/control/ring_flight.py`).
"""

from collections.abc import Sequence
from math import asin, atan2, cos, dist, hypot, pi, sin
from typing import Final, NamedTuple

from agents.control.aims import along
from agents.control.encirclement import aim_for_acceleration, undisturbed_m
from agents.control.plan import Plan
from agents.ring.joining import ASIDE
from agents.safety.routes import WAY_SHARE, Way, way_of
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from estimation.state import POSITION, VELOCITY
from estimation.vectors import Pair, clipped_pair, wrap_signed_rad

FAR_SHARE: Final = 0.8
"""The share of the radius up to which the law of a ring holds, at which it takes over."""
_SPEED_SHARE: Final = 0.8
_ACCELERATION_SHARE: Final = 0.5
_GAIN_PER_S: Final = 1.0
"""The shares of the ring's limits that are flown, and the rate at which an error of the velocity is corrected."""


class Disc(NamedTuple):
    """A ring with the room outside of it that its vehicles need, seen from above."""

    centre_m: Pair
    radius_m: float


def heading_rad(from_m: Pair, to_m: Pair, discs: Sequence[Disc]) -> tuple[float, bool]:
    """Return the direction of the way from a position to another around discs, and whether it is straight."""
    (x, y), (to_x, to_y) = from_m, to_m
    straight_rad, left_m = atan2(to_y - y, to_x - x), hypot(to_x - x, to_y - y)
    in_way = [(hypot(each.centre_m[0] - x, each.centre_m[1] - y), each) for each in discs]
    for away_m, disc in sorted(in_way, key=lambda each: each[0] - each[1].radius_m):
        to_centre_rad = atan2(disc.centre_m[1] - y, disc.centre_m[0] - x)
        off_rad = wrap_signed_rad(straight_rad - to_centre_rad)
        if cos(off_rad) <= 0.0 or away_m * cos(off_rad) >= left_m + disc.radius_m:
            continue  # behind the vehicle, or beyond the goal
        if away_m <= disc.radius_m:
            return to_centre_rad + pi, False
        if away_m * abs(sin(off_rad)) < disc.radius_m:
            aside_rad = asin(disc.radius_m / away_m)
            return to_centre_rad + (aside_rad if off_rad >= 0.0 else -aside_rad), False
    return straight_rad, True


class Transit:
    """Plans one vehicle's way to its ring, in a mission of several rings; without its target it stays."""

    def __init__(self, config: AgentConfig) -> None:
        self._way: Way | None = None
        self.change(config)

    @property
    def arrived(self) -> bool:
        """Whether the ring's own law can take over."""
        return self._arrived

    def change(self, config: AgentConfig) -> None:
        """Fly to the ring of another configuration from now on."""
        self._config, self._arrived = config, False
        way_m_s = WAY_SHARE * min(config.encirclement.speed_max_m_s, config.safety.speed_max_m_s)
        self._way = way_of(config, way_m_s, before=self._way)

    def plan(self, situation: Situation) -> Plan | None:
        """Return the plan of this tick, None if the target is not known."""
        if situation.acting_target is None:
            return None
        config, ring = self._config, self._config.encirclement
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        goal_x, goal_y = situation.acting_target[POSITION].tolist()
        direction_rad, is_straight = heading_rad((x, y), (goal_x, goal_y), self._discs(situation))
        away_m, there_m = hypot(goal_x - x, goal_y - y), ring.radius_m + ASIDE * config.safety.separation_m
        around_m = self._around_m((x, y), (goal_x, goal_y), away_m - there_m)
        is_straight = is_straight and around_m is None
        self._arrived = away_m < there_m or (is_straight and away_m < FAR_SHARE * ring.far_m)
        if around_m is not None:
            way_m_s = WAY_SHARE * min(ring.speed_max_m_s, config.safety.speed_max_m_s)
            return along(situation, around_m, config.plant, way_m_s)
        speed_m_s = _SPEED_SHARE * min(ring.speed_max_m_s, config.safety.speed_max_m_s)
        missing_m_s = speed_m_s * cos(direction_rad) - x_rate, speed_m_s * sin(direction_rad) - y_rate
        most_m_s2 = _ACCELERATION_SHARE * min(ring.acceleration_max_m_s2, config.safety.acceleration_max_m_s2)
        wanted_m_s2 = clipped_pair((_GAIN_PER_S * missing_m_s[0], _GAIN_PER_S * missing_m_s[1]), most_m_s2)
        motion, compensation = situation.acting_motion, situation.compensation
        aim = aim_for_acceleration(motion, wanted_m_s2, compensation, config.plant)
        return Plan(aim, undisturbed_m(aim, compensation, config.plant), motion[VELOCITY])

    def _around_m(self, here_m: Pair, goal_m: Pair, left_m: float) -> Pair | None:
        """Return the next place of the way around zones to the ring, None where it is straight."""
        if self._way is None or left_m <= 0.0:
            return None
        share = left_m / max(dist(here_m, goal_m), left_m)
        entry_m = here_m[0] + share * (goal_m[0] - here_m[0]), here_m[1] + share * (goal_m[1] - here_m[1])
        return None if self._way.routes.is_straight(here_m, entry_m) else self._way.next_m(here_m, goal_m)

    def _discs(self, situation: Situation) -> list[Disc]:
        """Return the rings about other targets that are known, but those that the goal is in."""
        config, discs = self._config, []
        for each in config.rings:
            target, goal = situation.acting_others.get(each.target), situation.acting_target
            if target is not None and goal is not None:
                radius_m = each.encirclement.radius_m + ASIDE * config.safety.separation_m
                if hypot(*(target - goal)[POSITION].tolist()) > radius_m:
                    discs.append(Disc((target.item(0), target.item(1)), radius_m))
        return discs
