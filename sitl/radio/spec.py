"""The properties of an emulated radio."""

from typing import Self

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
