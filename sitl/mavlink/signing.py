"""MAVLink 2 signing of a stub vehicle, by pymavlink, as ArduPilot does it: with a key, nothing unsigned is accepted."""

import hashlib
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

KEY_LENGTH, DIGEST_LENGTH = 32, 6
REFUSED = "Invalid signature"
"""pymavlink's reason for a frame that is unsigned, wrongly signed or old."""


@dataclass(frozen=True, slots=True)
class SigningKey:
    """A key of 32 bytes, and the time from which its messages are signed [10 us since 2015]. Raises ValueError."""

    secret: bytes
    time: int = 0

    def __post_init__(self) -> None:
        """Check what can be checked."""
        if len(self.secret) != KEY_LENGTH or self.time < 0:
            raise ValueError("a signing key has 32 bytes, and no negative time")

    def __repr__(self) -> str:
        """Return no secret."""
        return f"SigningKey(time={self.time})"


class Signing:
    """What a vehicle signs with and requires: its key, and the times of the messages that it sent and received.

    Its time follows that of the messages it accepts; it has no clock of its own for that.
    """

    def __init__(self, key: SigningKey | None) -> None:
        self._state = mavlink.MAVLinkSigning()
        if key is not None:
            self.set_up(key.secret, key.time)

    def set_up(self, secret: bytes, time: int) -> None:
        """Use another key from now on; none of it and no time ends signing."""
        on = any(secret) or time > 0
        self._state.secret_key = bytes(secret) if on else None
        self._state.sign_outgoing = on
        self._state.timestamp = time
        self._state.stream_timestamps.clear()

    def writer(self, outbox: Any, system_id: int, component: int) -> Any:
        """Return pymavlink's object that signs what it sends."""
        writer = mavlink.MAVLink(outbox, system_id, component)
        writer.signing = self._state
        return writer

    def parser(self) -> Any:
        """Return pymavlink's object that parses received bytes; what is not signed as required is bad data to it."""
        parser = _Parser(None)
        parser.robust_parsing = True
        parser.signing = self._state
        return parser


class _Parser(mavlink.MAVLink):  # type: ignore[misc]  # pymavlink is untyped
    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803  # pymavlink's
        """Compare the signature before the time: pymavlink notes the time of a forged message too."""
        digest = hashlib.sha256(self.signing.secret_key + bytes(msgbuf[:-DIGEST_LENGTH])).digest()
        if digest[:DIGEST_LENGTH] != bytes(msgbuf[-DIGEST_LENGTH:]):
            return False
        return bool(super().check_signature(msgbuf, srcSystem, srcComponent))
