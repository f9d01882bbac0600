"""What comes over the bus, before anybody believes it: what is not a fresh word of a member is counted and dropped."""

from collections.abc import Collection

from agents.team.clock_watch import ClockWatch
from agents.team.messages import (
    TOPICS,
    BusMessage,
    MemberState,
    OperatorCommand,
    decode,
)

_CLOCK_AHEAD_MAX_S = 1.0
_AGE_MAX_S = {kind: topic.age_max_s for kind, topic in TOPICS.items()}


class Inbox:
    """Takes the bus's payloads for one vehicle."""

    def __init__(self, vehicle_id: int, members: Collection[int], clocks: ClockWatch) -> None:
        """Take the team; `clocks` sees how every member dates what it says, believed or not."""
        self._others = frozenset(members) - {vehicle_id}
        self._clocks = clocks
        self.dropped = 0

    def take(self, payload: bytes, now_s: float, time_scale: float) -> BusMessage | None:
        """Return the message, or None when it is malformed, foreign, too old or from the future.

        `patience` is how many times as long as on the wall's clock a message may take.
        """
        try:
            message = decode(payload)
        except ValueError:
            self.dropped += 1
            return None
        age_s = (now_s - message.time_s) / time_scale
        known = isinstance(message, OperatorCommand) or message.sender in self._others
        if known and isinstance(message, MemberState):
            self._clocks.hear(message.sender, age_s, now_s)
        if not (known and -_CLOCK_AHEAD_MAX_S <= age_s <= _AGE_MAX_S[type(message)]):
            self.dropped += 1
            return None
        return message
