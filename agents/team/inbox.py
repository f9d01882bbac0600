"""The inbox of one vehicle: messages that are not from a member, or not fresh, are counted and dropped.

An operator's command is accepted whatever its date: the command handler answers it.
"""

from collections.abc import Collection
from typing import Final

from agents.drops import DropCounter, Reason
from agents.team.clock_watch import ClockWatch
from agents.team.messages import TOPICS, BusMessage, MemberState, OperatorCommand

_CLOCK_AHEAD_MAX_S: Final = 1.0


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
        """Return whether a message is from the team, not too old and not from the future.

        `time_scale` is mission seconds per wall second; transport takes wall time.
        """
        if isinstance(message, OperatorCommand):
            return True
        age_s = (now_s - message.time_s) / time_scale
        known = message.sender in self._others
        if known and isinstance(message, MemberState):
            self._clocks.receive(message.sender, age_s, now_s)
        if not known:
            self.dropped.add(Reason.NOT_A_MEMBER)
        elif age_s < -_CLOCK_AHEAD_MAX_S:
            self.dropped.add(Reason.FROM_FUTURE)
        elif age_s > TOPICS[type(message)].age_max_s:
            self.dropped.add(Reason.TOO_OLD)
        else:
            return True
        return False
