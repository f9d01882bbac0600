"""Admission: what comes over the bus counts when it is a message, on the key that its type and its sender have."""

from agents.drops import DropCounter, Drops, Reason
from agents.team.codec import decode
from agents.team.messages import BusMessage, key_of


class Admission:
    """Decodes what comes over the bus, once for all receivers; `drops` counts what is not admitted."""

    def __init__(self) -> None:
        self._dropped = DropCounter()

    @property
    def drops(self) -> Drops:
        """The payloads that were not admitted so far."""
        return self._dropped.drops

    def admitted(self, key: str, payload: bytes) -> BusMessage | None:
        """Return the message in a payload on a key below the team's, None when it is malformed or on another's key."""
        try:
            message = decode(payload)
        except ValueError:
            self._dropped.add(Reason.MALFORMED)
            return None
        reason = refusal(key, message)
        if reason is not None:
            self._dropped.add(reason)
            return None
        return message


def refusal(key: str, message: BusMessage) -> Reason | None:
    """Return why a message on a key below the team's is not admitted, None if it is.

    Its topic has to be that of its type, and its sender that of the key; for a command these are verb and operator.
    """
    expected = key_of(message)
    if key == expected:
        return None
    return Reason.WRONG_SENDER if key.partition("/")[0] == expected.partition("/")[0] else Reason.WRONG_TOPIC
