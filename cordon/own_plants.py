"""Custom plants for a mission's simulated vehicles."""

from collections.abc import Mapping
from dataclasses import replace

from cordon.returned import finite_numbers
from estimation.plant.model import Plant
from gcs.errors import InputError
from gcs.mission.mission import Mission
from sitl.vehicle.plant_step import Motion, Pair, StepFunction


def with_plants(
    mission: Mission, plants: Mapping[int, Plant | StepFunction]
) -> tuple[Mission, dict[int, StepFunction]]:
    """Return the mission with these true plants, and the step functions among them, by vehicle; raises InputError.

    The vehicles' controllers still use the plants of their profiles.
    """
    known = ", ".join(map(str, mission.ids))
    faults = [
        f"plants: the mission has no vehicle {each!r} (it has {known})" for each in plants if each not in mission.ids
    ]
    if faults:
        raise InputError(faults)
    linear = {vehicle_id: plant for vehicle_id, plant in plants.items() if isinstance(plant, Plant)}
    vehicles = tuple(
        replace(vehicle, true_plant=linear.get(vehicle.id, vehicle.true_plant)) for vehicle in mission.vehicles
    )
    steps = {
        vehicle_id: _checked(vehicle_id, plant) for vehicle_id, plant in plants.items() if not isinstance(plant, Plant)
    }
    return replace(mission, vehicles=vehicles), steps


def _checked(vehicle_id: int, step: StepFunction) -> StepFunction:
    """Return a step function that raises InputError if the result is not a motion."""

    def checked(motion: Motion, aim_m: Pair, disturbance_m_s2: Pair, step_s: float) -> Motion:
        returned = step(motion, aim_m, disturbance_m_s2, step_s)
        of = f"plants: the step of vehicle {vehicle_id}"
        x, y, x_rate, y_rate = finite_numbers(returned, ("x", "y", "x'", "y'"), of)
        return x, y, x_rate, y_rate

    return checked
