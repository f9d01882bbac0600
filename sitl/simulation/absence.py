"""The absence of a simulated vehicle's agent: it starts late, ends in flight, or is replaced by a new one."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

LANDED_AFTER_S = 15.0
"""The time in the air of a vehicle whose agent has ended: it hovers, and its autopilot lands it."""


@dataclass(frozen=True, slots=True)
class Absence:
    """The agent of `vehicle_id` is absent from `from_s` (0: it starts late) until `to_s` (inf: to the end).

    Then a new agent begins with the vehicle at rest at `at_m` (None: its present position).
    """

    vehicle_id: int
    from_s: float
    to_s: float = inf
    at_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse a time that ends before it begins."""
        if not 0.0 <= self.from_s < self.to_s:
            raise ValueError(f"vehicle {self.vehicle_id} is to be away from {self.from_s} s until {self.to_s} s")


def absence_at(absences: Sequence[Absence], now_s: float) -> Absence | None:
    """Return the absence at a time, None if the agent is present."""
    return next((absence for absence in absences if absence.from_s <= now_s < absence.to_s), None)
