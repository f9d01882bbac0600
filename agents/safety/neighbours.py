"""The other vehicles as bodies to keep away from: predicted from their published plans, with the uncertainty."""

from collections.abc import Container, Iterable, Sequence
from math import hypot, sqrt
from typing import Final

from agents.safety.barriers import Body, unsure_m
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.state import Vector
from estimation.vectors import Pair, length

UNPUBLISHED_ACCELERATION_M_S2: Final = 2.0
"""The largest difference between a vehicle's acceleration and its last published plan."""
GOING_ON_S: Final = 1.0
"""A silent vehicle is predicted to follow its last published plan for this long."""
UNMODELLED_M_S2: Final = 0.3
"""The largest lasting part of the acceleration between two vehicles that neither expects, with plants 20 % off.

`barriers.apart` lets the distance fall short by it over the square of the barrier's rate (docs/notes/safety.md).
"""
A_FEW: Final = 3
NEAR_FOR_S: Final = 0.2
"""The selection of near vehicles is valid for this long."""
_MEETS_S: Final = 2.5
_MEETS: Final = 1.5
"""Prediction time, and distance in separations, within which others need this vehicle's states at the full rate."""
_ENCIRCLES = Tactic.ENCIRCLE.value
_TO_A_RING = (Tactic.ENCIRCLE.value, Tactic.TRANSIT.value)
_STANDBY = Tactic.STANDBY.value


def ring_bands_m(config: AgentConfig) -> list[Pair]:
    """Return the lowest and the highest altitude of vehicles on each of the mission's rings; empty with one ring."""
    highest_m = config.altitude_m if config.layers_from_m is None else config.layers_from_m
    above_m, rings = max(highest_m - config.lowest_m, 0.0), config.rings if len(config.rings) > 1 else ()
    return [each.encirclement.band_m(config.lowest_m, above_m) for each in rings]


class Neighbours:
    """Makes bodies from the last published states of the team's members."""

    def __init__(self, config: AgentConfig) -> None:
        self._safety = config.safety
        self.change(config)
        self._unnoticed_s = max(config.failsafe.peers_silent_s - GOING_ON_S, 0.0)
        axes = (config.plant.x, config.plant.y)
        self._stiffness = tuple((axis.a0_per_s2, axis.a1_per_s) for axis in axes)
        self._acceleration_max_m_s2 = config.safety.acceleration_max_m_s2
        self._reach_m_s2 = config.safety.setpoint_lead_max_m * max(axis.a0_per_s2 for axis in axes)
        self._damping_per_s = max(axis.a1_per_s for axis in axes)

    def change(self, config: AgentConfig) -> None:
        """Fly the ring of another configuration from now on."""
        self._has_heights = config.encirclement.has_heights
        self._bands_m, self._ring = ring_bands_m(config), config.ring
        self._unmodelled_m = UNMODELLED_M_S2 / config.safety.barrier_rate_per_s**2
        self._passing_m = self._unmodelled_m if self._bands_m else 0.0

    def near(self, situation: Situation, states: Sequence[MemberState]) -> Sequence[MemberState]:
        """Return the members that can affect the guard within `NEAR_FOR_S`: no aim is too close to the others.

        In a team of sixteen these are a few; with so few members all are returned, which costs less than a selection.
        The bound is `barriers.apart` solved for the distance in the worst case: closing head on, and the aim at its
        farthest.
        """
        if len(states) <= A_FEW:
            return states
        safety, rate = self._safety, self._safety.barrier_rate_per_s
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        speed, turned = length(x_rate, y_rate), sqrt(2.0) * self._acceleration_max_m_s2
        reach = self._reach_m_s2 + hypot(*situation.disturbance.tolist()) + self._damping_per_s * speed
        reach *= 1.0 + self._damping_per_s * NEAR_FOR_S
        still_m = 3.0 * safety.separation_m + self._unmodelled_m + 2.0 * (reach + max(reach, turned)) / rate**2
        speed += reach * NEAR_FOR_S
        still_m += (4.0 / rate + NEAR_FOR_S) * speed
        near, until_s = [], situation.acting_s + NEAR_FOR_S
        for member in states:
            it = member.numbers
            ahead_s = min(until_s - it.time_s, GOING_ON_S + NEAR_FOR_S)
            its_x_rate, its_y_rate = it.velocity_m_s
            place_x, place_y = it.position_m
            # The distance that it may close until then, and its closing speed then.
            its_speed, gained = length(its_x_rate, its_y_rate), turned * ahead_s
            come_m, closing_m_s = (its_speed + gained / 2.0) * ahead_s, its_speed + gained
            if length(place_x - x, place_y - y) < still_m + 4.0 / rate * closing_m_s + come_m:
                near.append(member)
        return near

    def meets(self, situation: Situation, near: Sequence[MemberState]) -> bool:
        """Return whether a near vehicle comes about as close as the guard allows, soon and at constant velocity."""
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        safety, own_sigma_m = self._safety, situation.position_sigma_m
        acting_s = situation.acting_s
        for member in near:
            it = member.numbers
            ahead_s = acting_s - it.time_s
            its_x_rate, its_y_rate = it.velocity_m_s
            away_x = it.position_m[0] + its_x_rate * ahead_s - x
            away_y = it.position_m[1] + its_y_rate * ahead_s - y
            rate_x, rate_y = its_x_rate - x_rate, its_y_rate - y_rate
            closing, speed2 = -(away_x * rate_x + away_y * rate_y), rate_x * rate_x + rate_y * rate_y
            meeting_s = min(closing / speed2, _MEETS_S) if closing > 0.0 else 0.0
            close_m = _MEETS * safety.separation_m
            close_m += unsure_m(safety.uncertainty_sigmas, own_sigma_m, it.position_sigma_m)
            if length(away_x + rate_x * meeting_s, away_y + rate_y * meeting_s) < close_m:
                return True
        return False

    def exposed(self, situation: Situation, near: Sequence[MemberState], aim_m: Vector) -> Sequence[MemberState]:
        """Return the near vehicles that an aim (2,) could bring too close.

        For the others the acceleration is small enough in any direction: the bound is `barriers.apart` with the
        vehicles closing head on.
        """
        plant_x, plant_y = self._stiffness
        x, y, x_rate, y_rate = situation.acting_motion.tolist()
        w_x, w_y = situation.disturbance.tolist()
        aim_x, aim_y = aim_m.tolist()
        answer_m_s2 = length(
            plant_x[0] * (aim_x - x) - plant_x[1] * x_rate + w_x, plant_y[0] * (aim_y - y) - plant_y[1] * y_rate + w_y
        )
        safety, own_sigma_m = self._safety, situation.position_sigma_m
        rate, separation_m, sigmas = safety.barrier_rate_per_s, safety.separation_m, safety.uncertainty_sigmas
        limit_m_s2, acting_s = sqrt(2.0) * self._acceleration_max_m_s2, situation.acting_s
        found = []
        for member in near:
            it = member.numbers
            ahead_s = min(acting_s - it.time_s, GOING_ON_S)
            place_x, place_y = it.position_m
            its_x_rate, its_y_rate = it.velocity_m_s
            changed_m_s = limit_m_s2 * ahead_s
            away_m = length(place_x + its_x_rate * ahead_s - x, place_y + its_y_rate * ahead_s - y)
            away_m -= changed_m_s / 2.0 * ahead_s
            unsure = sigmas * (own_sigma_m + it.position_sigma_m)
            evades = it.evades
            keep_m = separation_m + (self._passing_m if evades else self._unmodelled_m) + min(unsure, separation_m)
            keep_m += min(UNPUBLISHED_ACCELERATION_M_S2 / 2.0 * ahead_s * ahead_s, separation_m)
            closing_m_s = length(its_x_rate - x_rate, its_y_rate - y_rate) + changed_m_s
            needed_m_s2 = 2.0 * answer_m_s2 if evades else answer_m_s2 + limit_m_s2
            if (
                ahead_s == GOING_ON_S
                or away_m <= keep_m
                or needed_m_s2 > rate * (rate / 2.0 * (away_m - keep_m * keep_m / away_m) - 2.0 * closing_m_s)
            ):
                found.append(member)
        return found

    def bodies(
        self,
        situation: Situation,
        states: Iterable[MemberState],
        lost: Iterable[MemberState],
        doubtful: Container[int] = (),
        *,
        encircles: bool = True,
    ) -> list[Body]:
        """Return the bodies when the setpoint acts: all received or lost vehicles, except those well above or below.

        On a ring with heights of its own these change: a vehicle that `encircles` and all others then keep apart at any
        height. In a mission of several rings they keep apart unless their heights stay apart, which for each are those
        from where it is to its ring's. A vehicle in standby, or that lands, is lost, is doubtful, or is flown by a
        pilot is not expected to evade.
        """
        members = [(member, member.numbers.evades and member.sender not in doubtful) for member in states]
        members += [(member, False) for member in lost]
        own_sigma_m = situation.position_sigma_m
        return [
            self._body(member, situation, own_sigma_m, shares=shares, passes=self._passes(member, encircles=encircles))
            for member, shares in members
            if self._meets_in_height(member, situation.height_m, encircles=encircles)
        ]

    def _meets_in_height(self, member: MemberState, height_m: float, *, encircles: bool) -> bool:
        """Return whether a member is at the vehicle's height, or may come there on the way to its ring's or on it."""
        apart_m = self._safety.vertical_separation_m
        if abs(member.altitude_m - height_m) < apart_m:
            return True
        if not self._bands_m:
            return self._has_heights and (encircles or member.tactic == _ENCIRCLES)
        low_m = high_m = height_m
        if encircles:
            ring_low_m, ring_high_m = self._bands_m[self._ring]
            low_m, high_m = min(low_m, ring_low_m), max(high_m, ring_high_m)
        its_low_m = its_high_m = member.altitude_m
        if member.tactic in _TO_A_RING:
            ring_low_m, ring_high_m = self._bands_m[member.ring_number]
            its_low_m, its_high_m = min(its_low_m, ring_low_m), max(its_high_m, ring_high_m)
        return its_low_m - high_m < apart_m and low_m - its_high_m < apart_m

    def _passes(self, member: MemberState, *, encircles: bool) -> bool:
        """Return whether the guard alone keeps a member apart: no ring or line has both, whose plans keep distances."""
        if not encircles:
            return member.tactic in _TO_A_RING
        return member.tactic != _ENCIRCLES or member.ring_number != self._ring

    def _body(
        self, member: MemberState, situation: Situation, own_sigma_m: float, *, shares: bool, passes: bool
    ) -> Body:
        safety, it = self._safety, member.numbers
        separation_m, age_s = safety.separation_m, situation.now_s - it.time_s
        ahead_s = min(situation.acting_s - it.time_s, GOING_ON_S)
        (place_x, place_y), (its_x_rate, its_y_rate) = it.position_m, it.velocity_m_s
        aim_x, aim_y = it.position_m if member.tactic == _STANDBY else it.aim_m
        x, x_rate, x_acceleration = self._ahead(0, place_x, its_x_rate, aim_x, ahead_s)
        y, y_rate, y_acceleration = self._ahead(1, place_y, its_y_rate, aim_y, ahead_s)
        moved_m = UNPUBLISHED_ACCELERATION_M_S2 / 2.0 * min(age_s, GOING_ON_S) ** 2
        if ahead_s == GOING_ON_S:
            # By now it hovers or lands; if only its radio failed, it may still fly on until it detects that.
            moved_m += length(x_rate, y_rate) * min(max(age_s - GOING_ON_S, 0.0), self._unnoticed_s)
            x_rate = y_rate = x_acceleration = y_acceleration = 0.0
        unsure = unsure_m(safety.uncertainty_sigmas, own_sigma_m, it.position_sigma_m)
        distance_m = separation_m + min(unsure, separation_m) + min(moved_m, separation_m)
        if not it.evades:
            distance_m += self._unmodelled_m  # neither a plan nor the other one makes up for a plant that is off
        elif passes:
            distance_m += self._passing_m
        acceleration_m_s2 = x_acceleration, y_acceleration
        return Body((x, y), (x_rate, y_rate), acceleration_m_s2, distance_m, shares, member.sender)

    def _ahead(self, axis: int, position: float, rate: float, aim: float, ahead_s: float) -> tuple[float, float, float]:
        """Return position, velocity and acceleration along one axis, from the plant's response to the published aim."""
        a0, a1 = self._stiffness[axis]
        limit = self._acceleration_max_m_s2
        acceleration = a0 * (aim - position) - a1 * rate
        acceleration = min(max(acceleration, -limit), limit)
        return position + (rate + acceleration / 2.0 * ahead_s) * ahead_s, rate + acceleration * ahead_s, acceleration
