"""When a vehicle's state is sent: as soon as the peers' prediction of it becomes wrong, and at a minimum rate.

Peers extrapolate a state: the position at its velocity, the aim and the reference on the ring at their rates.
While this agrees with the vehicle's present state, a few states a second are sufficient. This rate does not depend on
the number of vehicles, and allows for the loss of a state.
"""

from math import inf
from typing import Final

from agents.tactics import Tactic
from agents.team.messages import TOPICS, MemberState, NeighbourAngle, RingChoice
from estimation.vectors import length, wrap_signed_rad

HEARTBEAT_S: Final = 0.2
"""The period of states that continue as predicted: a sender is gone after ten of them are missing."""
_AGAIN_S: Final = 0.5
"""A change is repeated at the full rate for this long, because messages get lost."""
_POSITION_M: Final = 0.1
_VELOCITY_M_S: Final = 0.2
_ALTITUDE_M: Final = 0.2
_SIGMA_M: Final = 0.1
"""The largest differences from the predicted state: at least three standard deviations with noisy telemetry."""
_FOLLOWED_M: Final = 0.1
_AIM_M: Final = 0.5
"""The same for the aim: in formation, where followers keep station on it, and where only the guard uses it."""
_REFERENCE_M: Final = 0.02
_SHARE: Final = 0.01
"""The same for the reference along the ring, and for the shares of the ring that a vehicle can fly."""
_FORMATION = Tactic.FORMATION.value


class SendRate:
    """Decides whether the state of one vehicle is due."""

    def __init__(self, rate_hz: float) -> None:
        """Take the rate of the states to decide on."""
        # Half a tick less, so that a tick that is a little early is due as well.
        early_s = 0.5 / rate_hz
        self._period_s, self._heartbeat_s = TOPICS[MemberState].period_s - early_s, HEARTBEAT_S - early_s
        self._sent: MemberState | None = None
        self._often_until_s = -inf

    def may(self, now_s: float) -> bool:
        """Return whether the full rate allows a state now."""
        return self._sent is None or not 0.0 <= now_s - self._sent.time_s < self._period_s

    def due(self, state: MemberState, *, often: bool) -> bool:
        """Return whether to send a state: if `often`, with a sighting, after a change, or at the minimum rate."""
        sent = self._sent
        if sent is None or not goes_on(sent, state):
            self._often_until_s = state.time_s + _AGAIN_S
        elif not (
            often
            or state.sightings
            or state.time_s < self._often_until_s
            or not 0.0 <= state.time_s - sent.time_s < self._heartbeat_s
        ):
            return False
        self._sent = state
        return True


def goes_on(before: MemberState, state: MemberState) -> bool:
    """Return whether a state agrees with its prediction from an earlier one."""
    step_s = state.time_s - before.time_s
    if (
        not task_goes_on(before, state)
        or abs(state.altitude_m - before.altitude_m) > _ALTITUDE_M
        or abs(state.position_sigma_m - before.position_sigma_m) > _SIGMA_M
    ):
        return False
    (x, y), (x_rate, y_rate) = state.position_m, state.velocity_m_s
    (before_x, before_y), (before_x_rate, before_y_rate) = before.position_m, before.velocity_m_s
    (aim_x, aim_y), (before_aim_x, before_aim_y) = state.aim_m, before.aim_m
    aim_x_rate, aim_y_rate = before.aim_rate_m_s
    return (
        length(x - before_x - before_x_rate * step_s, y - before_y - before_y_rate * step_s) <= _POSITION_M
        and length(x_rate - before_x_rate, y_rate - before_y_rate) <= _VELOCITY_M_S
        and length(aim_x - before_aim_x - aim_x_rate * step_s, aim_y - before_aim_y - aim_y_rate * step_s)
        <= (_FOLLOWED_M if state.tactic == _FORMATION else _AIM_M)
    )


def task_goes_on(before: MemberState, state: MemberState) -> bool:
    """Return whether a vehicle's task is unchanged, and its place on the ring agrees with the prediction."""
    return (
        state.tactic == before.tactic
        and state.alert == before.alert
        and state.shaped_s == before.shaped_s
        and state.ring == before.ring
        and state.goal == before.goal
        and _same_choice(before.choice, state.choice)
        and place_goes_on(before.angle, state.angle)
    )


def _same_choice(before: RingChoice | None, choice: RingChoice | None) -> bool:
    """Return whether a vehicle's ring and the commanded ones are unchanged; its bids are for the auction alone."""
    if choice is None or before is None:
        return choice is before
    return choice.ring == before.ring and choice.commanded == before.commanded


def place_goes_on(before: NeighbourAngle | None, place: NeighbourAngle | None) -> bool:
    """Return whether a place on the ring (None: off it) agrees with its prediction from an earlier one."""
    if place is None or before is None:
        return place is before
    if place.references != before.references:
        return False
    if abs(place.rate_share - before.rate_share) > _SHARE or abs(place.radius_share - before.radius_share) > _SHARE:
        return False
    if place.reference_rad is None or before.reference_rad is None:
        return place.reference_rad is before.reference_rad
    moved_rad = before.reference_rate_rad_s * (place.time_s - before.time_s)
    off_rad = wrap_signed_rad(place.reference_rad - before.reference_rad - moved_rad)
    return abs(off_rad) * place.radius_m <= _REFERENCE_M
