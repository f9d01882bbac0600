"""Checks of a mission's no-fly zones: their shapes, and that starts, target and ring are outside of them."""

from collections.abc import Iterator, Sequence
from math import cos, sin, tau

from agents.ring.bent_ring import Bender, waiting_places_m
from agents.ring.place import even_places
from agents.safety.fence import Fence, NoFlyZone
from agents.safety.routes import ZONE_MARGIN_M, heights_m, routes_between, zones_between
from agents.settings.sections import (
    ZONE_AREA_LEAST_M2,
    ChoreographySettings,
    EncirclementSettings,
    NoFlySection,
    SafetySettings,
)
from gcs.errors import KeyFault
from gcs.mission.geometry import IndexedVehicles, at, sound
from gcs.mission.mission import TargetSection

_BEARINGS = 180


def zones_fit(
    safety: SafetySettings,
    vehicles: IndexedVehicles,
    ring: EncirclementSettings | None,
    target: TargetSection | None,
    layers: ChoreographySettings | None,
    places: int,
) -> Iterator[KeyFault]:
    """Check every zone: its polygon, its name, and that no take-off place, target or whole ring lies in it."""
    names = [each.name for each in safety.no_fly]
    zones: list[tuple[str, NoFlyZone]] = []
    for i, section in enumerate(safety.no_fly):
        key = f"safety.no_fly[{i}]"
        if section.name in names[:i]:
            yield KeyFault(f"{key}.name", f"two zones have the name '{section.name}'")
        faults = list(_sound(key, section)) if section.polygon_m else []
        yield from faults
        if not faults:
            zones.append((_shape_key(key, section), NoFlyZone(section)))
    if not vehicles:
        return
    sections = [vehicle for _, vehicle in vehicles]
    low_m, high_m = heights_m([each.altitude_m for each in sections], len(sections), ring, layers)
    yield from _starts_outside(zones, vehicles, high_m)
    flown = zones_between(safety, low_m, high_m)
    if ring is None or target is None or not flown:
        return
    closed = {each.name for each in flown}
    faults = list(_target_outside([each for each in zones if each[1].name in closed], ring, target))
    yield from faults
    if not faults and len(zones) == len(safety.no_fly) and target.has_planned_path and not target.speed_max_m_s:
        weights = [each.gap for each in sections]
        room_for = even_places(weights) if places == len(weights) else float(places)
        yield from _flyable(safety, flown, vehicles, ring, target, room_for)


def _sound(key: str, section: NoFlySection) -> Iterator[KeyFault]:
    """Check that a polygon is one, and encloses an area."""
    key = f"{key}.polygon_m"
    faults = list(sound(key, section.polygon_m, "zone"))
    yield from faults
    if not faults and Fence(section.polygon_m).area_m2 < ZONE_AREA_LEAST_M2:
        yield KeyFault(key, f"the zone '{section.name}' encloses less than {ZONE_AREA_LEAST_M2:g} m²")


def _flyable(
    safety: SafetySettings,
    zones: tuple[NoFlySection, ...],
    vehicles: IndexedVehicles,
    ring: EncirclementSettings,
    target: TargetSection,
    places: float,
) -> Iterator[KeyFault]:
    """Check that the ring about a target at rest can bend around zones, and that every vehicle can fly there."""
    names = ", ".join(f"'{each.name}'" for each in zones)
    bend = Bender(zones, ring, safety, places).bend(target.start_m)
    if bend is None:
        yield KeyFault(
            "safety.no_fly",
            f"the ring of {ring.radius_m} m about the target cannot bend around {names}: no way inside or outside of "
            "them keeps encirclement.speed_max_m_s, encirclement.acceleration_max_m_s2, safety.separation_m, "
            "safety.keep_out_m and safety.fence_m; change the ring's radius or rate",
        )
        return
    on_ring = waiting_places_m(target.start_m, ring.radius_m, 0.0, bend)
    for i, vehicle in vehicles:
        limits = vehicle.limits(safety)
        routes = routes_between(zones, limits.fence_m, ZONE_MARGIN_M)
        if not routes.way_m(vehicle.start_m, on_ring):
            reason = f"no way leads from {at(vehicle.start_m)} to the ring around {names}"
            yield KeyFault(f"vehicles[{i}].start_m", reason)


def _shape_key(key: str, section: NoFlySection) -> str:
    return f"{key}.polygon_m" if section.polygon_m else f"{key}.center_m"


def _starts_outside(
    zones: Sequence[tuple[str, NoFlyZone]], vehicles: IndexedVehicles, highest_m: float
) -> Iterator[KeyFault]:
    """Check that vehicles can climb and land vertically at their take-off places."""
    for key, zone in zones:
        if zone.floor_m > highest_m + ZONE_MARGIN_M:
            continue
        for i, vehicle in vehicles:
            clearance_m = zone.boundary.clearance_m(vehicle.start_m)
            if clearance_m < 0.0:
                yield KeyFault(
                    f"vehicles[{i}].start_m", f"{at(vehicle.start_m)} is in the no-fly zone '{zone.name}' ({key})"
                )
            elif clearance_m < ZONE_MARGIN_M:
                yield KeyFault(
                    f"vehicles[{i}].start_m",
                    f"{at(vehicle.start_m)} is {clearance_m:.2f} m from the no-fly zone '{zone.name}' ({key}), which "
                    f"overlaps the room of {ZONE_MARGIN_M:g} m for take-off and landing",
                )


def _target_outside(
    zones: Sequence[tuple[str, NoFlyZone]], ring: EncirclementSettings, target: TargetSection
) -> Iterator[KeyFault]:
    """Check that neither the target, where it starts, nor the whole ring about it lies in a zone."""
    x, y = target.start_m
    angles_rad = [tau * k / _BEARINGS for k in range(_BEARINGS)]
    on_ring = [(x + ring.radius_m * cos(angle), y + ring.radius_m * sin(angle)) for angle in angles_rad]
    for key, zone in zones:
        if not any(zone.boundary.contains(place) for place in on_ring):
            yield KeyFault(key, f"the zone '{zone.name}' covers the whole ring of {ring.radius_m} m about the target")
        elif not zone.boundary.contains((x, y)):
            yield KeyFault(key, f"the zone '{zone.name}' covers the target at {at((x, y))}")
