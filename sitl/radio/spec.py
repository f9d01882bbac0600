"""What an emulated radio is like."""

from typing import Self

from pydantic import Field, model_validator

from estimation.settings import Settings

BITS_A_BYTE = 10
BUFFER_MIN_BYTES = 280
"""The longest MAVLink frame."""


class RadioSpec(Settings):
    """A radio of `baud` bits a second, ten for each byte (none: no bound), each way, or with `shared` both ways and all
    vehicles together. A frame arrives `latency_ms` and up to `jitter_ms` after its last bit; frames never overtake each
    other. A share `loss` of the frames is lost, `burst` in a row on average (none: independently), and a share `noise`
    of the bytes that arrive has one bit turned. What waits beyond `buffer_bytes` is dropped.
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
            raise ValueError("frames that are lost so often are lost in longer rows: raise burst, or lower loss")
        return self

    @property
    def bytes_s(self) -> float | None:
        """What it carries [bytes/s], None without a bound."""
        return None if self.baud is None else self.baud / BITS_A_BYTE
