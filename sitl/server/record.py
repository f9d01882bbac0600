"""The record of stub vehicles: true tracks, also of what other simulators send. Imports nothing that serves them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from estimation.state import Vector


@dataclass(frozen=True, slots=True)
class TruthTrack:
    """The true track of one vehicle, ten times a second: `time_s` (T,) on the common clock, the rest (T, 3)."""

    vehicle_id: int
    time_s: Vector
    position_m: Vector
    velocity_m_s: Vector

    @classmethod
    def of(cls, vehicle_id: int, numbers: ArrayLike) -> "TruthTrack":
        """Return the track of true motions, whose times, positions and velocities follow one another."""
        rows = np.array(numbers).reshape(-1, 7)
        return cls(vehicle_id, rows[:, 0], rows[:, 1:4], rows[:, 4:7])


@dataclass(frozen=True, slots=True)
class StubRecord:
    """The record of a run: tracks, the simulated time dropped, and messages dropped by vehicle."""

    tracks: tuple[TruthTrack, ...]
    slipped_s: float
    dropped: dict[int, dict[str, int]]
