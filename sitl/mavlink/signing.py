"""MAVLink 2 signing of a stub vehicle, by pymavlink, as in ArduPilot: with a key, unsigned messages are refused."""

import hashlib
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

DIGEST_LENGTH = 6
REFUSED = "Invalid signature"
"""pymavlink's reason for a frame that is unsigned, wrongly signed or old."""


@dataclass(frozen=True, slots=True)
class SigningKey:
    """A key of 32 bytes, and the time from which its messages are signed [10 us since 2015]."""

    secret: bytes
    time: int = 0

    def __repr__(self) -> str:
        return f"SigningKey(time={self.time})"


class SigningState:
    """The signing state of a vehicle: its key, and the times of the messages sent and received.

    Its time follows that of accepted messages; it has no clock for signing.
    """

    def __init__(self, key: SigningKey | None) -> None:
        self._state = mavlink.MAVLinkSigning()
        if key is not None:
            self.set_up(key.secret, key.time)

    def set_up(self, secret: bytes, time: int) -> None:
        """Use another key from now on; an all-zero key with time 0 ends signing."""
        on = any(secret) or time > 0
        self._state.secret_key = bytes(secret) if on else None
        self._state.sign_outgoing = on
        self._state.timestamp = time
        self._state.stream_timestamps.clear()

    def writer(self, outbox: Any, system_id: int, component: int) -> Any:
        """Return pymavlink's object that signs sent messages."""
        writer = mavlink.MAVLink(outbox, system_id, component)
        writer.signing = self._state
        return writer

    def parser(self) -> Any:
        """Return pymavlink's object that parses received bytes; a missing or wrong signature makes bad data."""
        parser = _Parser(None)
        parser.robust_parsing = True
        parser.signing = self._state
        return parser


class _Parser(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink is untyped
    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803  # pymavlink's
        """Check the signature before the time: pymavlink also stores the time of a forged message."""
        digest = hashlib.sha256(self.signing.secret_key + bytes(msgbuf[:-DIGEST_LENGTH])).digest()
        if digest[:DIGEST_LENGTH] != bytes(msgbuf[-DIGEST_LENGTH:]):
            return False
        return bool(super().check_signature(msgbuf, srcSystem, srcComponent))
