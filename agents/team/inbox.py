"""The bus's payloads for one vehicle: what is not a fresh message of a member is counted and dropped."""

from collections.abc import Collection

from agents.team.clock_watch import ClockWatch
from agents.team.messages import TOPICS, BusMessage, MemberState, OperatorCommand, decode

_CLOCK_AHEAD_MAX_S = 1.0
_AGE_MAX_S = {kind: topic.age_max_s for kind, topic in TOPICS.items()}


class Inbox:
    """Decodes payloads, and accepts the messages that are for this vehicle's team."""

    def __init__(self, vehicle_id: int, members: Collection[int], clocks: ClockWatch) -> None:
        """Take the team; `clocks` takes how every member dates its messages, accepted or not."""
        self._others = frozenset(members) - {vehicle_id}
        self._clocks = clocks
        self.dropped = 0

    def decoded(self, payload: bytes) -> BusMessage | None:
        """Return the message in a payload, None when it is malformed."""
        try:
            return decode(payload)
        except ValueError:
            self.dropped += 1
            return None

    def accepts(self, message: BusMessage, now_s: float, time_scale: float) -> bool:
        """Return whether a message is neither foreign, nor too old, nor from the future.

        It may take `time_scale` times as long as on the wall's clock.
        """
        age_s = (now_s - message.time_s) / time_scale
        known = isinstance(message, OperatorCommand) or message.sender in self._others
        if known and isinstance(message, MemberState):
            self._clocks.hear(message.sender, age_s, now_s)
        if not (known and -_CLOCK_AHEAD_MAX_S <= age_s <= _AGE_MAX_S[type(message)]):
            self.dropped += 1
            return False
        return True
