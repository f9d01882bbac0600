"""The inbox of one vehicle: messages that are not from a member, or not fresh, are counted and dropped.

The age of an operator's command is for the command handler, which answers it.
"""

from collections.abc import Collection
from math import inf

from agents.drops import DropCounter, Reason
from agents.team.clock_watch import ClockWatch
from agents.team.messages import TOPICS, BusMessage, MemberState, OperatorCommand

_CLOCK_AHEAD_MAX_S = 1.0
_AGE_MAX_S = {kind: topic.age_max_s for kind, topic in TOPICS.items() if kind is not OperatorCommand}


class Inbox:
    """Accepts the messages of this vehicle's team; `dropped` counts the others by reason."""

    def __init__(self, vehicle_id: int, members: Collection[int], clocks: ClockWatch) -> None:
        """Take the team; the ages of all members' messages are passed to `clocks`, accepted or not."""
        self._others = frozenset(members) - {vehicle_id}
        self._clocks = clocks
        self.dropped = DropCounter()

    def accepts(self, message: BusMessage, now_s: float, time_scale: float) -> bool:
        """Return whether a message is from the team, not too old and not from the future.

        `time_scale` is mission seconds per wall second; transport takes wall time.
        """
        age_s = (now_s - message.time_s) / time_scale
        known = isinstance(message, OperatorCommand) or message.sender in self._others
        if known and isinstance(message, MemberState):
            self._clocks.receive(message.sender, age_s, now_s)
        if not known:
            self.dropped.add(Reason.NOT_A_MEMBER)
        elif age_s < -_CLOCK_AHEAD_MAX_S:
            self.dropped.add(Reason.FROM_FUTURE)
        elif age_s > _AGE_MAX_S.get(type(message), inf):
            self.dropped.add(Reason.TOO_OLD)
        else:
            return True
        return False
