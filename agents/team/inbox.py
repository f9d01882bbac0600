"""The inbox of one vehicle: messages that are not from a member, or not fresh, are counted and dropped.

An operator's command is accepted whatever its date: the command handler answers it.
"""

from collections.abc import Collection
from typing import Final

from agents.drops import DropCounter, Reason
from agents.team.clock_watch import ClockWatch
from agents.team.messages import TOPICS, BusMessage, MemberState, OperatorCommand

_CLOCK_AHEAD_MAX_S: Final = 1.0
_STATE_AGE_MAX_S: Final = TOPICS[MemberState].age_max_s


class Inbox:
    """Accepts the messages of this vehicle's team; `dropped` counts the others by reason."""

    def __init__(self, vehicle_id: int, members: Collection[int], clocks: ClockWatch) -> None:
        """Take the team; the ages of all members' messages are passed to `clocks`, accepted or not."""
        self._others = frozenset(members) - {vehicle_id}
        self._clocks = clocks
        self.dropped = DropCounter()

    def admit(self, vehicle_id: int) -> None:
        """Accept the messages of a vehicle that joins the team in flight."""
        self._others |= {vehicle_id}

    def accepts(self, message: BusMessage, now_s: float, time_scale: float) -> bool:
        """Return whether a message other than a state is from the team, not too old and not from the future.

        `time_scale` is mission seconds per wall second; transport takes wall time.
        """
        if isinstance(message, OperatorCommand):
            return True
        age_max_s, is_known = TOPICS[type(message)].age_max_s, message.sender in self._others
        return self._is_fresh((now_s - message.time_s) / time_scale, age_max_s, is_known=is_known)

    def accepts_state(self, state: MemberState, now_s: float, time_scale: float) -> bool:
        """Return the same for a vehicle's state."""
        numbers = state.numbers
        age_s, is_known = (now_s - numbers.time_s) / time_scale, numbers.sender in self._others
        if is_known:
            self._clocks.receive(numbers.sender, age_s, now_s)
        return self._is_fresh(age_s, _STATE_AGE_MAX_S, is_known=is_known)

    def _is_fresh(self, age_s: float, age_max_s: float, *, is_known: bool) -> bool:
        if not is_known:
            self.dropped.add(Reason.NOT_A_MEMBER)
        elif age_s < -_CLOCK_AHEAD_MAX_S:
            self.dropped.add(Reason.FROM_FUTURE)
        elif age_s > age_max_s:
            self.dropped.add(Reason.TOO_OLD)
        else:
            return True
        return False
