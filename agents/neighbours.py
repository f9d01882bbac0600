"""The other vehicles as bodies to keep away from: where their published plans take them, and how sure that is."""

from collections.abc import Iterable

from agents.barriers import Body, unsure_m
from agents.messages import MemberState
from agents.settings import AgentConfig
from agents.situation import Situation
from agents.tactics import Tactic

UNTOLD_ACCELERATION_M_S2 = 2.0
"""How much a vehicle may have changed its mind since it last spoke."""
GOING_ON_S = 1.0
"""How long a silent vehicle is believed to go on as it said."""
_DOES_NOT_EVADE = (Tactic.LAND.value, Tactic.STOOD_DOWN.value)


class Neighbours:
    """Makes bodies of what the team's members said last."""

    def __init__(self, config: AgentConfig) -> None:
        self._safety = config.safety
        axes = (config.plant.x, config.plant.y)
        self._stiffness = tuple((axis.a0_per_s2, axis.a1_per_s) for axis in axes)

    def bodies(
        self, situation: Situation, height_m: float, heard: Iterable[MemberState], lost: Iterable[MemberState]
    ) -> list[Body]:
        """Return the bodies at the moment when the setpoint acts: all heard or lost, but those well above or below.

        One that lands, is lost, or that somebody else flies does not keep away itself.
        """
        members = [(member, member.tactic not in _DOES_NOT_EVADE) for member in heard]
        members += [(member, False) for member in lost]
        apart_m, own_sigma_m = self._safety.vertical_separation_m, situation.position_sigma_m
        return [
            self._body(member, situation, own_sigma_m, shares=shares)
            for member, shares in members
            if abs(member.altitude_m - height_m) < apart_m
        ]

    def _body(self, member: MemberState, situation: Situation, own_sigma_m: float, *, shares: bool) -> Body:
        ahead_s = min(situation.acting_s - member.time_s, GOING_ON_S)
        (x, x_rate, x_acceleration), (y, y_rate, y_acceleration) = (
            self._ahead(axis, member, ahead_s) for axis in (0, 1)
        )
        age_s = situation.now_s - member.time_s
        if ahead_s == GOING_ON_S:  # it hovers by now, or is on its way to the ground
            x_rate = y_rate = x_acceleration = y_acceleration = 0.0
        moved_m = min(UNTOLD_ACCELERATION_M_S2 / 2.0 * age_s**2, self._safety.separation_m)
        unsure = unsure_m(self._safety.uncertainty_sigmas, own_sigma_m, member.position_sigma_m)
        distance_m = self._safety.separation_m + min(unsure, self._safety.separation_m) + moved_m
        return Body((x, y), (x_rate, y_rate), (x_acceleration, y_acceleration), distance_m, shares)

    def _ahead(self, axis: int, member: MemberState, ahead_s: float) -> tuple[float, float, float]:
        """Return position, velocity and acceleration along one axis, as the plant answers the setpoint it published."""
        a0, a1 = self._stiffness[axis]
        rate = member.velocity_m_s[axis]
        limit = self._safety.acceleration_max_m_s2
        acceleration = a0 * (member.setpoint_m[axis] - member.position_m[axis]) - a1 * rate
        acceleration = min(max(acceleration, -limit), limit)
        position = member.position_m[axis] + rate * ahead_s + acceleration / 2.0 * ahead_s**2
        return position, rate + acceleration * ahead_s, acceleration
