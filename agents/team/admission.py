"""Admission: a message counts only on the key that its type and its sender have."""

from agents.drops import Reason
from agents.team.messages import BusMessage, key_of


def refusal(key: str, message: BusMessage) -> Reason | None:
    """Return why a message on a key below the team's is not admitted, None if it is.

    Its topic has to be that of its type, and its sender that of the key; for a command these are verb and operator.
    """
    expected = key_of(message)
    if key == expected:
        return None
    return Reason.WRONG_SENDER if key.partition("/")[0] == expected.partition("/")[0] else Reason.WRONG_TOPIC
