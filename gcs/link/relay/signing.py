"""MAVLink 2 message signing of one vehicle's link, both ways (https://mavlink.io/en/guide/message_signing.html).

The signature is the first 48 bits of SHA-256 over the key and the signed frame. Times count 10 us since 2015.
"""

import hashlib
import hmac
import os
import time
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from pathlib import Path

from fastcrc.crc16 import mcrf4xx

from gcs.keys.private_files import make_folder, write
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
    Frames up to the time `accepted_before`, that of earlier runs, are refused.
    """

    def __init__(self, key: bytes, ticks: Callable[[], int] = wall_ticks, accepted_before: int = 0) -> None:
        """Use a key of 32 bytes; raises ValueError for another length."""
        if len(key) != KEY_LENGTH:
            raise ValueError(f"a MAVLink signing key has {KEY_LENGTH} bytes, not {len(key)}")
        self.key = key
        self._ticks = ticks
        self._before = self.accepted = self._latest = accepted_before
        self._received: dict[tuple[int, int], int] = {}

    @property
    def ahead_s(self) -> float:
        """By how much the messages of earlier runs are ahead of this computer's clock [s]."""
        return (self._before - self._ticks()) / TICKS_PER_S

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
        first = max(self._before, max(self._ticks(), self._latest) - NEW_STREAM_AGE_MAX - 1)
        if at <= self._received.get(stream, first):
            return SignatureCheck.OLD
        self._received[stream] = at
        self.accepted = max(self.accepted, at)
        self._latest = max(self._latest, at)
        return SignatureCheck.AUTHENTIC

    def _digest(self, data: bytes) -> bytes:
        return hashlib.sha256(self.key + data).digest()[:DIGEST_LENGTH]


SAVE_PERIOD_S = 1.0


def times_folder() -> Path:
    """Return the folder of the times of signed messages; raises OSError without a home folder."""
    shared = os.environ.get("XDG_DATA_HOME")
    try:
        return Path(shared or Path.home() / ".local" / "share") / "cordon" / "signing"
    except RuntimeError as error:
        raise OSError("there is no home folder; set XDG_DATA_HOME to a folder") from error


class SigningTimes:
    """The signing of each key, and the time of the newest message that was accepted with it, in a file for each key.

    What was sent in one run is so refused in the next. A file is ahead by the period in which it is written: messages
    that were accepted after it was written last are refused as well. A lost or damaged file permits what a new stream
    does.
    """

    def __init__(self) -> None:
        self._signings: dict[bytes, Signing] = {}
        self._saved: dict[bytes, int] = {}

    def signing(self, key: bytes) -> Signing:
        """Return the signing of a key, which goes on after that of earlier runs."""
        if key not in self._signings:
            before = _time_in(self.path(key))
            self._signings[key] = Signing(key, accepted_before=before)
            self._saved[key] = before
        return self._signings[key]

    def save(self) -> None:
        """Write the times that have changed; to be called every `SAVE_PERIOD_S`. Raises InputError, OSError."""
        for key, signing in tuple(self._signings.items()):
            ahead = signing.accepted + round(SAVE_PERIOD_S * TICKS_PER_S)
            if signing.accepted > self._saved[key]:
                path = self.path(key)
                make_folder(path.parent)
                write(path, str(max(ahead, _time_in(path))).encode())
                self._saved[key] = signing.accepted

    @staticmethod
    def path(key: bytes) -> Path:
        """Return the file of a key, whose name does not contain it; raises OSError without a home folder."""
        return times_folder() / hashlib.sha256(b"cordon" + key).hexdigest()[:16]


def _time_in(path: Path) -> int:
    with suppress(OSError, ValueError):
        return int(path.read_bytes()[:20])
    return 0


_FLAG_IN_CHECKSUM = tuple(
    mcrf4xx(bytes((SIGNED_FLAG,)) + bytes(HEAD_V2 - 3 + length + CRC_EXTRA_LENGTH), 0) for length in range(256)
)
"""By payload length how the checksum changes with the flag of a signed frame.

The checksum is linear: the change is the CRC, begun at 0, of the changed bit and of a zero for each later byte. So the
CRC_EXTRA byte of each message is not needed.
"""
