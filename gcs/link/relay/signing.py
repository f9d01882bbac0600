"""MAVLink 2 message signing of one vehicle's link, both ways (https://mavlink.io/en/guide/message_signing.html).

The signature is the first 48 bits of SHA-256 over the key and the signed frame. Times count 10 us since 2015.
"""

import hashlib
import hmac
import time
from collections.abc import Callable
from enum import Enum

from fastcrc.crc16 import mcrf4xx

from gcs.link.relay.frames import CHECKSUM_LENGTH, HEAD_V2, MAGIC_V2, SIGNED_FLAG, header, is_signed

KEY_LENGTH = 32
LINK_ID = 0
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01T00:00:00Z, the beginning of MAVLink's time."""
TICKS_PER_S = 100_000
NEW_STREAM_AGE_MAX = 60 * TICKS_PER_S
"""A new stream may begin at most a minute in the past: older frames are replayed ones."""
DIGEST_LENGTH, TIME_LENGTH = 6, 6
CRC_EXTRA_LENGTH = 1


class SignatureCheck(Enum):
    """Whether a received frame is the vehicle's."""

    AUTHENTIC = "authentic"
    UNSIGNED = "not signed"
    WRONG_KEY = "signed with another key, or damaged"
    OLD = "signed at an earlier time"


def wall_ticks() -> int:
    """Return the present time of the wall clock in MAVLink's units, 10 us since 2015."""
    return int((time.time() - EPOCH_UNIX_S) * TICKS_PER_S)


class Signing:
    """Signs the frames to one vehicle, and verifies the frames from it. Use from one thread at a time.

    The time of a sent frame is the wall clock's, and later than that of every frame sent or accepted before. So it also
    increases from one run to the next: frames of a vehicle whose time is ahead arrive before any is sent to it.
    """

    def __init__(self, key: bytes, ticks: Callable[[], int] = wall_ticks) -> None:
        """Use a key of 32 bytes; raises ValueError for another length."""
        if len(key) != KEY_LENGTH:
            raise ValueError(f"a MAVLink signing key has {KEY_LENGTH} bytes, not {len(key)}")
        self._key = key
        self._ticks = ticks
        self._latest = 0
        self._received: dict[tuple[int, int], int] = {}

    def sign(self, frame: bytes) -> bytes:
        """Return a MAVLink 2 frame with the flag, the checksum that follows from it, and the signature."""
        if frame[0] != MAGIC_V2 or is_signed(frame):
            raise ValueError("only an unsigned MAVLink 2 frame can be signed")
        self._latest = max(self._ticks(), self._latest + 1)
        length = frame[1]
        checksum = int.from_bytes(frame[-CHECKSUM_LENGTH:], "little") ^ _FLAG_IN_CHECKSUM[length]
        signed = b"".join(
            (
                frame[:2],
                bytes((frame[2] | SIGNED_FLAG,)),
                frame[3:-CHECKSUM_LENGTH],
                checksum.to_bytes(CHECKSUM_LENGTH, "little"),
                bytes((LINK_ID,)),
                self._latest.to_bytes(TIME_LENGTH, "little"),
            )
        )
        return signed + self._digest(signed)

    def verify(self, frame: bytes) -> SignatureCheck:
        """Return the verdict on a received frame; an authentic one is accepted once, and older ones not any more."""
        if not is_signed(frame):
            return SignatureCheck.UNSIGNED
        if not hmac.compare_digest(self._digest(frame[:-DIGEST_LENGTH]), frame[-DIGEST_LENGTH:]):
            return SignatureCheck.WRONG_KEY
        at = int.from_bytes(frame[-DIGEST_LENGTH - TIME_LENGTH : -DIGEST_LENGTH], "little")
        stream = (frame[-DIGEST_LENGTH - TIME_LENGTH - 1], header(frame).component)
        oldest = self._received.get(stream, max(self._ticks(), self._latest) - NEW_STREAM_AGE_MAX - 1)
        if at <= oldest:
            return SignatureCheck.OLD
        self._received[stream] = at
        self._latest = max(self._latest, at)
        return SignatureCheck.AUTHENTIC

    def _digest(self, data: bytes) -> bytes:
        return hashlib.sha256(self._key + data).digest()[:DIGEST_LENGTH]


_FLAG_IN_CHECKSUM = tuple(
    mcrf4xx(bytes((SIGNED_FLAG,)) + bytes(HEAD_V2 - 3 + length + CRC_EXTRA_LENGTH), 0) for length in range(256)
)
"""By payload length how the checksum changes with the flag of a signed frame.

The checksum is linear: the change is the CRC, begun at 0, of the changed bit and of a zero for each later byte. So the
CRC_EXTRA byte of each message is not needed.
"""
