"""Admission: a payload from the bus is accepted if it is a message on the key of its type and sender."""

from agents.drops import DropCounter, Drops, Reason
from agents.team.codec import decode
from agents.team.messages import BusMessage, key_of


class Admission:
    """Decodes payloads from the bus once for all receivers; `drops` counts those not admitted."""

    def __init__(self) -> None:
        self._dropped = DropCounter()

    @property
    def drops(self) -> Drops:
        """The counts of payloads not admitted so far."""
        return self._dropped.drops

    def admitted(self, key: str, payload: bytes) -> BusMessage | None:
        """Return the message in a payload on a key below the team's, None if it is malformed or on a wrong key."""
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

    The topic has to match its type, the name in the key its sender; for a command these are verb and operator.
    """
    expected = key_of(message)
    if key == expected:
        return None
    return Reason.WRONG_SENDER if key.partition("/")[0] == expected.partition("/")[0] else Reason.WRONG_TOPIC
