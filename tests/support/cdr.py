"""Messages of ROS 2 as bytes, packed and unpacked by hand from the rules of CDR (OMG formal/02-06-51, 15.3).

Four bytes of encapsulation, 00 01 for little-endian; then each number at a multiple of its size, counted from behind
these; a string has its length with the closing zero in 4 bytes before it.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

LITTLE_ENDIAN = bytes((0, 1, 0, 0))


@dataclass(frozen=True)
class Pose:
    """A PoseStamped: stamp, frame, position [m], and quaternion x, y, z, w."""

    seconds: int
    nanoseconds: int
    frame: str
    place_m: tuple[float, ...]
    rotation: tuple[float, ...]


def pose_bytes(
    place_m: Sequence[float],
    *,
    stamp: tuple[int, int] = (0, 0),
    frame: str = "map",
    covariance: Sequence[float] = (),
) -> bytes:
    """Return a PoseStamped, or with a covariance, of 36 numbers, a PoseWithCovarianceStamped."""
    name = frame.encode() + b"\0"
    head = struct.pack("<iII", *stamp, len(name)) + name
    head += bytes(-len(head) % 8)
    return LITTLE_ENDIAN + head + struct.pack(f"<{7 + len(covariance)}d", *place_m, 0.0, 0.0, 0.0, 1.0, *covariance)


def pose_of(payload: bytes) -> Pose:
    """Return the PoseStamped in bytes."""
    assert payload[:4] == LITTLE_ENDIAN
    body = payload[4:]
    seconds, nanoseconds, length = struct.unpack_from("<iII", body)
    frame = body[12 : 12 + length]
    assert frame.endswith(b"\0")
    begin = 12 + length + -(12 + length) % 8
    assert len(body) == begin + 7 * 8
    numbers = struct.unpack_from("<7d", body, begin)
    return Pose(seconds, nanoseconds, frame[:-1].decode(), numbers[:3], numbers[3:])
