"""When a simulated vehicle's agent is not there: it has not come yet, dies in flight, or comes back as a new one."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

LANDED_AFTER_S = 15.0
"""A vehicle whose agent died hovers, and its autopilot lands it: so long it is in the air, and in others' way."""


@dataclass(frozen=True, slots=True)
class Absence:
    """The agent of `vehicle_id` is gone from `from_s` on (0: it has not come yet) until `to_s` (inf: for good).

    Then a new one is up, at rest at `at_m`; None is where the vehicle was before.
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
    """Return the absence that a moment lies in, None if the agent is there."""
    return next((absence for absence in absences if absence.from_s <= now_s < absence.to_s), None)
