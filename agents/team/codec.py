"""The codec of the messages on the bus.

Every vehicle sends its state several times a second. A state is packed (`agents/team/packing.py`): its numbers are
encoded as integer multiples of units far below the resolution of sensors, which takes a third of the bytes. Reports to
operators and observers are packed in the same way.
"""

from typing import Any, Union

import msgspec

from agents.drops import DropCounter, Drops, Reason, Refusals
from agents.team.messages import (
    BusMessage,
    CommandAnswer,
    MemberState,
    OperatorCommand,
    StartProposal,
    VehicleReport,
    key_of,
)
from agents.team.packing import Packing

_PACKINGS: dict[type[msgspec.Struct], Packing[Any]] = {
    MemberState: Packing(MemberState, "s"),
    VehicleReport: Packing(VehicleReport, "r"),
}
_BY_WIRE = {packing.wire: packing for packing in _PACKINGS.values()}
_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(
    Union[(*_BY_WIRE, StartProposal, OperatorCommand, CommandAnswer)]
)


def encode(message: BusMessage) -> bytes:
    """Return the payload of a message."""
    packing = _PACKINGS.get(type(message))
    return _encoder.encode(message if packing is None else packing.packed(message))


def decode(payload: bytes) -> BusMessage:
    """Return the message in a payload; raises ValueError if it has no known type or a number is out of bounds."""
    try:
        message = _decoder.decode(payload)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    packing = _BY_WIRE.get(type(message))
    return message if packing is None else packing.unpacked(message)  # type: ignore[no-any-return]  # of a union made here


class Admission:
    """Decodes payloads from the bus once for all receivers; `drops` counts those not admitted."""

    def __init__(self) -> None:
        self._dropped = DropCounter()

    @property
    def drops(self) -> Drops:
        """The counts of payloads not admitted so far."""
        return self._dropped.drops

    @property
    def refusals(self) -> Refusals:
        """The same by sender."""
        return self._dropped.refusals

    def admitted(self, key: str, payload: bytes) -> BusMessage | None:
        """Return the message in a payload on a key below the team's, None if it is malformed or on a wrong key."""
        try:
            message = decode(payload)
        except ValueError:
            self._dropped.add(Reason.MALFORMED, key)
            return None
        reason = refusal(key, message)
        if reason is not None:
            self._dropped.add(reason, key)
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
