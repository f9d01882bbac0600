"""A mission's vehicles with their profiles: the plant that each controller assumes, and the simulation's true plant."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from agents.settings.sections import DecisionSettings
from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis
from estimation.profile.autopilots import DEFAULT
from estimation.profile.profile import Profile
from gcs.errors import KeyFault
from gcs.mission.links import LinkSection
from gcs.mission.mission import MissionVehicle, VehicleSection

LoadedVehicle = tuple[VehicleSection, Profile]


def resolved(section: VehicleSection, profile: Profile) -> MissionVehicle:
    """Return a vehicle with its profile, and the true plant of a simulation: the profile's, scaled by `true_scale`."""
    return MissionVehicle(
        section,
        profile.plant,
        true_plant(section, profile.plant),
        section.decision or DecisionSettings(),
        profile.own_filter,
        section.autopilot or profile.autopilot or DEFAULT,
        profile,
    )


def true_plant(section: VehicleSection, plant: Plant) -> Plant:
    """Return a plant scaled by the `true_scale` of a vehicle."""
    scale = section.true_scale

    def true(axis: PlantAxis) -> PlantAxis:
        return PlantAxis(axis.a0_per_s2 * scale.a0, axis.a1_per_s * scale.a1)

    gain = min(plant.feedforward * scale.feedforward, FEEDFORWARD_MAX)
    return replace(plant, x=true(plant.x), y=true(plant.y), feedforward=gain)


def of_another_kind(link: LinkSection, vehicles: Sequence[LoadedVehicle | None]) -> Iterator[KeyFault]:
    """Return the faults of profiles that do not match `link.feedforward`."""
    if link.feedforward is None:
        return
    for index, vehicle in enumerate(vehicles):
        if vehicle is None:
            continue
        section, gain = vehicle[0], vehicle[1].plant.feedforward
        if (gain > 0.0) is link.feedforward:
            continue
        kind = f"takes velocities beside its setpoints (feedforward = {gain:g})" if gain else "takes no velocities"
        stated, wanted = ("true", "with velocities") if link.feedforward else ("false", "without")
        yield KeyFault(
            f"vehicles[{index}].profile",
            f"'{section.profile}' {kind}, and link.feedforward = {stated}: "
            f"use one identified {wanted}, or leave link.feedforward out: then each profile decides",
        )


def beyond_limits(
    vehicles: Sequence[LoadedVehicle | None], speed_m_s: float, acceleration_m_s2: float
) -> Iterator[KeyFault]:
    """Return the faults of vehicles whose profile's limits are below the mission's speed or acceleration."""
    for index, vehicle in enumerate(vehicles):
        if vehicle is None:
            continue
        section, limits = vehicle[0], vehicle[1].limits
        for key, needed, unit in (
            ("speed_max_m_s", speed_m_s, "m/s"),
            ("acceleration_max_m_s2", acceleration_m_s2, "m/s²"),
        ):
            limit = getattr(limits, key)
            if limit is not None and needed > limit:
                yield KeyFault(
                    f"vehicles[{index}].profile",
                    f"the mission takes {needed:.2f} {unit}, more than limits.{key} = "
                    f"{limit:g} {unit} of '{section.profile}'",
                )
