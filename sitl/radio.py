"""The properties of an emulated radio."""

from collections import deque
from dataclasses import dataclass
from math import inf
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from estimation.settings import Settings

BITS_A_BYTE = 10
BUFFER_MIN_BYTES = 280
"""The longest MAVLink frame."""


class RadioSpec(Settings):
    """A radio of `baud` bits a second, ten per byte (none: unlimited), in each direction, or with `shared` in total for
    both directions and all vehicles. A frame arrives `latency_ms`, plus up to `jitter_ms`, after its last bit; frames
    keep their order. A share `loss` of the frames is lost, `burst` in a row on average (none: independently), and a
    share `noise` of the bytes that arrive has one bit flipped. Frames beyond `buffer_bytes` are dropped.
    """

    baud: int | None = Field(None, ge=300, le=10_000_000)
    latency_ms: float = Field(0.0, ge=0.0, le=10_000.0)
    jitter_ms: float = Field(0.0, ge=0.0, le=10_000.0)
    loss: float = Field(0.0, ge=0.0, le=0.9)
    burst: float | None = Field(None, ge=1.0, le=1000.0)
    noise: float = Field(0.0, ge=0.0, le=0.5)
    shared: bool = False
    buffer_bytes: int = Field(2048, ge=BUFFER_MIN_BYTES, le=1_000_000)
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _loses_frames_in_bursts(self) -> Self:
        if self.burst is not None and self.loss > self.burst / (1.0 + self.burst):
            raise ValueError("bursts of this length cannot lose this share of frames: raise burst, or lower loss")
        return self

    @property
    def bytes_s(self) -> float | None:
        """The capacity [bytes/s], None if unlimited."""
        return None if self.baud is None else self.baud / BITS_A_BYTE


@dataclass(slots=True)
class Counts:
    """The counts of one direction: frames sent, lost in the air, and dropped because the buffer was full."""

    sent_frames: int = 0
    sent_bytes: int = 0
    lost_frames: int = 0
    dropped_frames: int = 0


class Air:
    """The air time, used by one frame at a time: of one direction, or of all that share it."""

    def __init__(self, bytes_s: float | None) -> None:
        self._bytes_s = inf if bytes_s is None else bytes_s
        self._free_s = -inf

    def take(self, length: int, now_s: float) -> float:
        """Send this many bytes after all sent before; return when the last one has left [s]."""
        self._free_s = max(self._free_s, now_s) + length / self._bytes_s
        return self._free_s


class Channel:
    """Carries frames one way. With the same seed, the same frames at the same times arrive identically.

    Losses follow Gilbert's model: the channel is good or bad, and each frame of a bad one is lost.
    """

    def __init__(self, spec: RadioSpec, air: Air, seed: tuple[int, ...]) -> None:
        self.counts = Counts()
        self._spec, self._air = spec, air
        self._random = np.random.default_rng(seed)
        leaves = 1.0 - spec.loss if spec.burst is None else 1.0 / spec.burst
        self._turns_bad, self._turns_good = leaves * spec.loss / (1.0 - spec.loss), leaves
        self._is_bad = False
        self._waiting: deque[tuple[float, int]] = deque()
        self._flying: deque[tuple[float, bytes]] = deque()
        self._last_s = -inf

    def send(self, frame: bytes, now_s: float) -> None:
        """Take a frame at a time [s]."""
        if self.waiting_bytes(now_s) + len(frame) > self._spec.buffer_bytes:
            self.counts.dropped_frames += 1
            return
        left_s = self._air.take(len(frame), now_s)
        self._waiting.append((left_s, len(frame)))
        self.counts.sent_frames += 1
        self.counts.sent_bytes += len(frame)
        if self._is_lost():
            self.counts.lost_frames += 1
            return
        delay_s = (self._spec.latency_ms + self._spec.jitter_ms * self._random.random()) / 1e3
        self._last_s = max(left_s + delay_s, self._last_s)
        self._flying.append((self._last_s, self._noisy(frame)))

    def arrived(self, now_s: float) -> list[bytes]:
        """Return the frames that have arrived by a time [s]."""
        frames = []
        while self._flying and self._flying[0][0] <= now_s:
            frames.append(self._flying.popleft()[1])
        return frames

    def arrives_s(self) -> float:
        """Return when the next frame arrives [s], infinity without any."""
        return self._flying[0][0] if self._flying else inf

    def waiting_bytes(self, now_s: float) -> int:
        """Return the number of bytes that have not left."""
        while self._waiting and self._waiting[0][0] <= now_s:
            self._waiting.popleft()
        return sum(length for _, length in self._waiting)

    def _is_lost(self) -> bool:
        turns = self._turns_good if self._is_bad else self._turns_bad
        if self._random.random() < turns:
            self._is_bad = not self._is_bad
        return self._is_bad

    def _noisy(self, frame: bytes) -> bytes:
        if not self._spec.noise:
            return frame
        hit = self._random.random(len(frame)) < self._spec.noise
        bits = np.where(hit, 1 << self._random.integers(0, 8, len(frame)), 0).astype(np.uint8)
        return (np.frombuffer(frame, np.uint8) ^ bits).tobytes()
