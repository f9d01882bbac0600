"""The record of a flight: the input of metrics, figures and reports."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from agents.safety.guard import Guarded
from estimation.state import Vector

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class VehicleTrack:
    """One vehicle's flight on the record's time grid of T samples.

    `position_m`, `velocity_m_s` (T, 2) in the mission frame; `tactic` (T,) names (`formation`, `encircle`, ...);
    rows without data of the vehicle are NaN with tactic `unknown`.
    """

    vehicle_id: int
    position_m: Vector
    velocity_m_s: Vector
    tactic: np.ndarray[tuple[int], np.dtype[np.str_]]


@dataclass(frozen=True, slots=True)
class LoopStatistics:
    """Timing of the control loop: `tick_us` (ticks,) are computing times in microseconds."""

    rate_hz: float
    ticks: int
    missed: int
    tick_us: Vector = field(default_factory=lambda: np.empty(0))


@dataclass(slots=True)
class GuardTally:
    """Counts the setpoints that the guard moved, in all and by cause; one setpoint may have several causes."""

    interventions: int = 0
    causes: Counter[str] = field(default_factory=Counter)

    def note(self, guarded: Guarded | None) -> None:
        """Count one tick."""
        if guarded is not None:
            self.count([cause.words for cause in guarded.causes])

    def count(self, causes: Sequence[str]) -> None:
        """Count one tick by its causes; without any the guard did not move the setpoint."""
        if causes:
            self.interventions += 1
            self.causes.update(causes)


@dataclass(frozen=True, slots=True)
class FlightEvent:
    """An event of a vehicle, of one of the kinds of `agents.outputs.Note`, with its text."""

    time_s: float
    vehicle: int
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """A whole flight on an even grid `time_s` (T,) since the mission's start; the target's motion has shape (T, 2).

    `source` is simulation, sitl or flight; `reference` is truth or estimate: the source of the positions; `guard`
    counts the interventions, None if unknown. `events` are in order, their times since the mission's start as well.
    `truth` are the true tracks of the same vehicles beside their estimates, where their simulators sent them.
    """

    mission: str
    seed: int
    source: str
    reference: str
    time_s: Vector
    target_position_m: Vector
    target_velocity_m_s: Vector
    vehicles: tuple[VehicleTrack, ...]
    loop: LoopStatistics
    wall_time_s: float
    guard: GuardTally | None = None
    events: tuple[FlightEvent, ...] = ()
    truth: tuple[VehicleTrack, ...] = ()


def in_order(events: Iterable[FlightEvent], start_s: float = 0.0) -> tuple[FlightEvent, ...]:
    """Return events by time since the mission's start at `start_s` [ms], then by vehicle, else in given order."""
    since = (replace(event, time_s=round(event.time_s - start_s, 3)) for event in events)
    return tuple(sorted(since, key=lambda event: (event.time_s, event.vehicle)))
