"""Checks of rally points: every vehicle's spot is inside its fence, outside of zones, and apart from the others."""

from collections.abc import Iterator
from math import dist

from agents.safety.fence import Fence, NoFlyZone
from agents.safety.routes import ZONE_MARGIN_M, heights_m
from agents.settings.sections import ChoreographySettings, SafetySettings
from estimation.vectors import Pair
from gcs.errors import KeyFault
from gcs.mission.geometry import IndexedVehicles, at
from gcs.mission.mission import rally_spot_m


def rally_fits(
    safety: SafetySettings, vehicles: IndexedVehicles, layers: ChoreographySettings | None
) -> Iterator[KeyFault]:
    """Check every rally point: its name, and the spots of all vehicles there."""
    if not (vehicles and safety.rally):
        return
    starts_m = [vehicle.start_m for _, vehicle in vehicles]
    taken = [(f"the start of vehicle {vehicle.id}", vehicle.start_m) for _, vehicle in vehicles]
    _, high_m = heights_m([vehicle.altitude_m for _, vehicle in vehicles], len(vehicles), None, layers)
    zones = [zone for zone in map(NoFlyZone, safety.no_fly) if zone.floor_m <= high_m + ZONE_MARGIN_M]
    for k, rally in enumerate(safety.rally):
        key = f"safety.rally[{k}].place_m"
        if rally.name in (each.name for each in safety.rally[:k]):
            yield KeyFault(f"safety.rally[{k}].name", f"two rally points have the name '{rally.name}'")
        spots = [
            (
                f"the spot of vehicle {vehicle.id} at '{rally.name}'",
                rally_spot_m(vehicle.start_m, starts_m, rally.place_m),
            )
            for _, vehicle in vehicles
        ]
        for (what, spot_m), (_, vehicle) in zip(spots, vehicles, strict=True):
            fence_m = vehicle.limits(safety).fence_m
            if len(fence_m) >= 3 and Fence(fence_m).clearance_m(spot_m) < 0.0:
                yield KeyFault(key, f"{what}, {at(spot_m)}, is outside of its fence")
            for zone in zones:
                if zone.boundary.clearance_m(spot_m) < ZONE_MARGIN_M:
                    yield KeyFault(key, f"{what}, {at(spot_m)}, is in or at the no-fly zone '{zone.name}'")
        yield from _apart(key, spots, taken, safety.separation_m)
        taken += spots


def _apart(
    key: str, spots: list[tuple[str, Pair]], taken: list[tuple[str, Pair]], separation_m: float
) -> Iterator[KeyFault]:
    """Yield the nearest spot to another landing place if they are closer than the separation."""
    away_m, what, other = min(
        (dist(spot_m, place_m), what, other) for what, spot_m in spots for other, place_m in taken
    )
    if away_m < separation_m:
        yield KeyFault(
            key, f"{what} is {away_m:.2f} m from {other}, less than safety.separation_m = {separation_m:g} m"
        )
