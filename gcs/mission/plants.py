"""A mission's plants: what each vehicle's file says, what it truly is in simulation, and whether it fits the link."""

from collections.abc import Iterator, Sequence

from agents.settings.sections import DecisionSettings
from estimation.plant.file import PlantFile
from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis
from gcs.mission.mission import LinkSection, MissionVehicle, VehicleSection

LoadedVehicle = tuple[VehicleSection, PlantFile]


def resolved(section: VehicleSection, file: PlantFile) -> MissionVehicle:
    """Return a vehicle with its plant, and the one that a simulation flies: off by its `true_scale`."""
    scale, plant = section.true_scale, file.plant

    def true(axis: PlantAxis) -> PlantAxis:
        return PlantAxis(axis.a0_per_s2 * scale.a0, axis.a1_per_s * scale.a1)

    gain = min(plant.feedforward * scale.feedforward, FEEDFORWARD_MAX)
    true_plant = Plant(true(plant.x), true(plant.y), plant.delay_s, gain)
    return MissionVehicle(section, plant, true_plant, section.decision or DecisionSettings(), file.identified)


def fed_as_told(link: LinkSection, vehicles: Sequence[LoadedVehicle | None]) -> Iterator[str]:
    """Return the faults of plants that are not of the kind of setpoints that the mission says it sends."""
    if link.feedforward is None:
        return
    for index, vehicle in enumerate(vehicles):
        if vehicle is None:
            continue
        section, gain = vehicle[0], vehicle[1].plant.feedforward
        if (gain > 0.0) is link.feedforward:
            continue
        kind = f"takes velocities beside its setpoints (feedforward = {gain:g})" if gain else "takes no velocities"
        told, wanted = ("true", "with velocities") if link.feedforward else ("false", "without")
        yield (
            f"vehicles[{index}].plant: '{section.plant}' {kind}, and link.feedforward = {told}: "
            f"name one identified {wanted}, or leave link.feedforward out, and each plant file decides"
        )
