"""The model of one simulated vehicle: plant, start, imperfections and seed."""

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.plant.model import Plant
from sitl.simulation.absence import Absence
from sitl.vehicle.imperfections import IDEAL, Imperfections
from sitl.vehicle.plant_step import StepFunction


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
