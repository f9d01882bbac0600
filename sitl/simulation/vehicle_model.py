"""The model of one simulated vehicle: plant, start, imperfections and seed."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from estimation.plant.model import Plant
from sitl.vehicle.imperfections import IDEAL, Imperfections
from sitl.vehicle.plant_step import StepFunction

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


@dataclass(frozen=True, slots=True)
class TelemetryNoise:
    """White noise on the telemetry of a vehicle; standard deviations per axis."""

    position_m: float = 0.0
    velocity_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """A simulated vehicle, hovering at rest at `start_m` and `altitude_m` in the mission frame at time 0.

    `plant` is its true plant, which may differ from the one that its core assumes. `seed` seeds all its random
    generators. `disturbance_m_s2` is a constant acceleration (x, y). A vehicle that `climbs` follows the altitude of
    its setpoints; any other keeps `altitude_m`. During `absences` its agent is absent. `step` is a dynamics function in
    place of the plant's equation and the shaping limits; delay and feed-forward remain the plant's.
    """

    plant: Plant
    start_m: tuple[float, float]
    altitude_m: float
    seed: tuple[int, ...]
    noise: TelemetryNoise = TelemetryNoise()
    disturbance_m_s2: tuple[float, float] = (0.0, 0.0)
    imperfections: Imperfections = IDEAL
    absences: Sequence[Absence] = ()
    climbs: bool = False
    step: StepFunction | None = None
