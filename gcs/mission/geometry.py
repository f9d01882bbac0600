"""Checks of a mission against its own limits: fence, altitude band, keep-out disc and speeds.

Also distances of vehicles from each other, their fences and zones.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, pairwise
from math import degrees, dist

from agents.ring.heights import altitude_refusal, tilt_refusal
from agents.ring.place import chord_m
from agents.safety.fence import Area, Fence
from agents.settings.sections import ChoreographySettings, EncirclementSettings, FormationSettings, SafetySettings
from agents.settings.shapes import gap_m
from gcs.errors import KeyFault
from gcs.mission.mission import MissionSection, NetworkSection, TargetSection, VehicleSection, lowest_between_m

_PATH_POINTS = 200

IndexedVehicles = Sequence[tuple[int, VehicleSection]]
Place = tuple[float, float]


def areas(vehicles: Sequence[VehicleSection], safety: SafetySettings) -> dict[int, Area]:
    """Return where each vehicle that has a fence or no-fly zones may fly, by its id."""
    limits = {vehicle.id: vehicle.limits(safety) for vehicle in vehicles}
    return {vehicle_id: Area(each) for vehicle_id, each in limits.items() if each.fence_m or each.no_fly}


def nearest_other(vehicle_id: int, places_m: Mapping[int, Place]) -> tuple[int, float] | None:
    """Return the horizontally nearest other vehicle and its distance [m], from the positions (x, y) of all.

    None without others, or if the vehicle's own position is unknown.
    """
    here_m = places_m.get(vehicle_id)
    if here_m is None:
        return None
    others = ((dist(here_m, place_m), other) for other, place_m in places_m.items() if other != vehicle_id)
    nearest_m, nearest_id = min(others, default=(0.0, 0))
    return (nearest_id, nearest_m) if nearest_id else None


def slots_fit(
    vehicles: IndexedVehicles,
    safety: SafetySettings,
    formation: FormationSettings | None,
    network: NetworkSection | None,
) -> Iterator[KeyFault]:
    """Check that all vehicles or none have a slot, that slots are apart, and that followers are in radio range."""
    placed = [(i, vehicle.slot_m) for i, vehicle in vehicles if vehicle.slot_m is not None]
    if placed and len(placed) < len(vehicles):
        i = next(i for i, vehicle in vehicles if vehicle.slot_m is None)
        yield KeyFault(
            f"vehicles[{i}].slot_m", f"this key is missing; vehicles[{placed[0][0]}] has one: all have one, or none"
        )
    if formation is not None and formation.shape == "free" and vehicles and not placed:
        yield KeyFault("formation.shape", "a free formation needs every vehicle's slot_m, and none has one")
    for (i, one_m), (k, other_m) in combinations(placed, 2):
        apart_m = dist(one_m, other_m)
        if apart_m < safety.separation_m:
            yield KeyFault(
                f"vehicles[{k}].slot_m",
                f"{apart_m:.2f} m from vehicles[{i}]'s, less than safety.separation_m = {safety.separation_m} m",
            )
    shape = None if formation is None else formation.shape or ("free" if placed else "line")
    if formation is not None and len(vehicles) > 1 and shape != "free" and formation.spacing_m < safety.separation_m:
        yield KeyFault(
            "formation.spacing_m", f"{formation.spacing_m} m is less than safety.separation_m = {safety.separation_m} m"
        )
    if formation is not None and formation.station == "predecessor" and network is not None:
        range_m = network.range_m
        yield from () if range_m is None else _neighbours_in_range(vehicles, formation, range_m)


def _neighbours_in_range(vehicles: IndexedVehicles, formation: FormationSettings, range_m: float) -> Iterator[KeyFault]:
    """Check that a vehicle hears its neighbour in line order, on which it keeps station.

    Shapes that operators command later are possible only within the range as well (`AgentConfig.shapes`).
    """
    follows = f"out of network.range_m = {range_m:g} m: one keeps station on the other (formation.station)"
    placed = [(i, vehicle.slot_m) for i, vehicle in vehicles if vehicle.slot_m is not None]
    for (i, one_m), (k, other_m) in pairwise(placed):
        apart_m = dist(one_m, other_m)
        if apart_m > range_m:
            yield KeyFault(
                f"vehicles[{k}].slot_m",
                f"{apart_m:g} m from vehicles[{i}]'s, its neighbour in line order, and {follows}",
            )
    ids = [vehicle.id for _, vehicle in vehicles]
    shape = formation.shape or ("free" if placed else "line")
    if shape == "free" or formation.leader not in ids:
        return
    apart_m = gap_m(shape, len(ids), ids.index(formation.leader), formation.spacing_m)
    if apart_m > range_m:
        yield KeyFault(
            "formation.spacing_m",
            f"{formation.spacing_m:g} m puts neighbours in a {shape} up to {apart_m:g} m apart, {follows}",
        )


def ring_in_range(ring: EncirclementSettings, range_m: float, count: int) -> Iterator[KeyFault]:
    """Check that neighbours on the ring, which keep their spacing to each other, are in radio range.

    The first two are opposite each other until more come. In simulations of three, four and six vehicles that did not
    hear each other there, no ring became even, and teams of three and four were ended by failsafes.
    """
    if count > 1 and (apart_m := chord_m(ring.radius_m, 2)) > range_m:
        yield KeyFault(
            "encirclement.radius_m",
            f"the first two vehicles on a ring of {ring.radius_m:g} m are {apart_m:g} m apart, out of "
            f"network.range_m = {range_m:g} m: neighbours keep their spacing to each other",
        )


def limits_agree(
    safety: SafetySettings, ring: EncirclementSettings | None, formation: FormationSettings | None
) -> Iterator[KeyFault]:
    """Check that limits contradict neither each other nor what the tactics need."""
    low, high = safety.altitude_min_m, safety.altitude_max_m
    if low is not None and high is not None and low >= high:
        yield KeyFault("safety.altitude_min_m", f"{low} m is not below altitude_max_m = {high} m")
    setpoints_m_s = safety.setpoint_speed_max_m_s
    if setpoints_m_s is not None and setpoints_m_s < safety.speed_max_m_s:
        yield KeyFault(
            "tuning.safety.setpoint_speed_max_m_s",
            f"at {setpoints_m_s} m/s setpoints cannot keep up with vehicles at "
            f"safety.speed_max_m_s = {safety.speed_max_m_s} m/s",
        )
    if ring is not None and safety.keep_out_m >= ring.radius_m:
        yield KeyFault(
            "safety.keep_out_m",
            f"{safety.keep_out_m} m about the target leaves no room for the ring of "
            f"encirclement.radius_m = {ring.radius_m} m",
        )
    if ring is not None and ring.yaw == "target":
        turning_deg_s = degrees(abs(ring.angular_rate_rad_s))
        if turning_deg_s > safety.yaw_rate_max_deg_s:
            yield KeyFault(
                "safety.yaw_rate_max_deg_s",
                f"{safety.yaw_rate_max_deg_s} degrees/s is less than the "
                f"{turning_deg_s:.1f} degrees/s of encirclement.angular_rate_rad_s = {ring.angular_rate_rad_s} rad/s, "
                'which encirclement.yaw = "target" takes',
            )
    along_m_s = 0.0 if ring is None else abs(ring.angular_rate_rad_s) * ring.radius_m
    if ring is not None and along_m_s > ring.speed_max_m_s:
        return  # reported by the cross-check of the ring
    line_m_s = 0.0 if formation is None else formation.speed_m_s
    for needed_m_s, what in ((along_m_s, "the ring"), (line_m_s, "the formation")):
        if needed_m_s > safety.speed_max_m_s:
            yield KeyFault(
                "safety.speed_max_m_s", f"{safety.speed_max_m_s} m/s is less than the {needed_m_s:.2f} m/s of {what}"
            )
    inwards_m_s2 = 0.0 if ring is None else along_m_s**2 / ring.radius_m
    if inwards_m_s2 > safety.acceleration_max_m_s2:
        yield KeyFault(
            "safety.acceleration_max_m_s2",
            f"{safety.acceleration_max_m_s2} m/s² is less than v²/R = {inwards_m_s2:.2f} m/s² of the ring",
        )


def altitudes_fit(
    vehicles: IndexedVehicles, safety: SafetySettings, layers: ChoreographySettings | None
) -> Iterator[KeyFault]:
    """Check that every vehicle's altitude and layers are inside its altitude limits."""
    if vehicles and layers is not None and layers.layer_m > 0.0:
        yield from _layers_fit(vehicles, safety, layers)
    for i, vehicle in vehicles:
        limits = vehicle.limits(safety)
        low, high = limits.altitude_min_m, limits.altitude_max_m
        low_key, high_key = (_limit(i, vehicle, key) for key in ("altitude_min_m", "altitude_max_m"))
        if low is not None and high is not None and low >= high:
            if vehicle.altitude_min_m is not None or vehicle.altitude_max_m is not None:  # else the team's own fault
                yield KeyFault(low_key, f"{low} m is not below {high_key} = {high} m")
        elif low is not None and vehicle.altitude_m < low:
            yield KeyFault(f"vehicles[{i}].altitude_m", f"{vehicle.altitude_m} m is below {low_key} = {low} m")
        elif high is not None and vehicle.altitude_m > high:
            yield KeyFault(f"vehicles[{i}].altitude_m", f"{vehicle.altitude_m} m is above {high_key} = {high} m")


def _layers_fit(vehicles: IndexedVehicles, safety: SafetySettings, layers: ChoreographySettings) -> Iterator[KeyFault]:
    """Check the higher of each vehicle's layers at take-off and landing; one fault for all with the team's limit."""
    ids = tuple(vehicle.id for _, vehicle in vehicles)
    order = layers.in_landing_order(ids)
    from_m = max(vehicle.altitude_m for _, vehicle in vehicles)
    above: dict[str, tuple[float, float, str]] = {}
    for i, vehicle in vehicles:
        layer_m = from_m + max(ids.index(vehicle.id), order.index(vehicle.id) + 1) * layers.layer_m
        high, key = vehicle.limits(safety).altitude_max_m, _limit(i, vehicle, "altitude_max_m")
        if high is not None and layer_m > high:
            whose = "the" if vehicle.altitude_max_m is None else "its"
            above[key] = (high, max(layer_m, above[key][1] if key in above else layer_m), whose)
    for key, (high, layer_m, whose) in above.items():
        yield KeyFault(
            key, f"{high} m is below {whose} highest layer, {layer_m:g} m, of choreography.layer_m = {layers.layer_m} m"
        )


def follows_fit(
    vehicles: IndexedVehicles,
    safety: SafetySettings,
    ring: EncirclementSettings | None,
    target: TargetSection | None,
) -> Iterator[KeyFault]:
    """Check the heights of a ring; one that follows the target's altitude needs an offset and altitude limits."""
    if ring is None:
        return
    yield from _heights_fit(vehicles, safety, ring)
    offset_m = ring.altitude_offset_m
    if ring.altitude == "layers":
        if offset_m is not None:
            yield KeyFault(
                "encirclement.altitude_offset_m",
                f'{offset_m} m counts from the target\'s altitude: it needs encirclement.altitude = "target"',
            )
        return
    limits = [vehicle.limits(safety) for _, vehicle in vehicles] or [safety]
    missing = [
        *(["encirclement.altitude_offset_m"] if offset_m is None else []),
        *(["safety.altitude_min_m"] if any(each.altitude_min_m is None for each in limits) else []),
        *(["safety.altitude_max_m"] if any(each.altitude_max_m is None for each in limits) else []),
    ]
    yield from (KeyFault(key, 'this key is missing; encirclement.altitude = "target" needs it') for key in missing)
    if missing or offset_m is None or target is None or target.altitude_m is None or not vehicles:
        return
    lowest_m = target.altitude_m + offset_m
    yield from _follows_inside(
        vehicles, safety, lowest_m, f"{offset_m} m above target.altitude_m = {target.altitude_m} m"
    )


def _heights_fit(vehicles: IndexedVehicles, safety: SafetySettings, ring: EncirclementSettings) -> Iterator[KeyFault]:
    """Check that the tilt and the altitude of a ring keep every vehicle inside its limits."""
    if not vehicles:
        return
    sections = [vehicle for _, vehicle in vehicles]
    between_m = lowest_between_m(sections, safety)
    if refusal := tilt_refusal(ring, between_m):
        yield KeyFault("encirclement.tilt_deg", refusal)
    elif refusal := altitude_refusal(ring, min(vehicle.altitude_m for vehicle in sections), between_m):
        yield KeyFault("encirclement.altitude_m", refusal)


def _follows_inside(
    vehicles: IndexedVehicles, safety: SafetySettings, lowest_m: float, above: str
) -> Iterator[KeyFault]:
    """Check that all vehicles are inside their limits when the lowest, above the target, flies at `lowest_m`."""
    altitudes_m = [vehicle.altitude_m for _, vehicle in vehicles]
    outside: list[tuple[int, VehicleSection, float]] = []
    for i, vehicle in vehicles:
        own, flies_m = vehicle.limits(safety), lowest_m + vehicle.altitude_m - min(altitudes_m)
        low, high = own.altitude_min_m, own.altitude_max_m
        if (low is not None and flies_m < low) or (high is not None and flies_m > high):
            outside.append((i, vehicle, flies_m))
    if any(vehicle.limits(safety) is safety for _, vehicle, _ in outside):
        highest_m = lowest_m + max(altitudes_m) - min(altitudes_m)
        yield KeyFault(
            "encirclement.altitude_offset_m",
            f"{above} vehicles fly at {lowest_m:g} to {highest_m:g} m, not between "
            f"safety.altitude_min_m = {safety.altitude_min_m} m and altitude_max_m = {safety.altitude_max_m} m",
        )
    for i, vehicle, flies_m in outside:
        own = vehicle.limits(safety)
        if own is not safety:
            yield KeyFault(
                "encirclement.altitude_offset_m",
                f"{above} vehicles[{i}] flies at {flies_m:g} m, not between "
                f"{_limit(i, vehicle, 'altitude_min_m')} = {own.altitude_min_m} m and "
                f"{_limit(i, vehicle, 'altitude_max_m')} = {own.altitude_max_m} m",
            )


def _limit(i: int, vehicle: VehicleSection, key: str) -> str:
    """Return the key that sets a vehicle's limit: its own or the team's."""
    return f"safety.{key}" if getattr(vehicle, key) is None else f"vehicles[{i}].{key}"


def fence_fits(
    safety: SafetySettings,
    vehicles: IndexedVehicles,
    ring: EncirclementSettings | None,
    target: TargetSection | None,
    mission: MissionSection | None,
) -> Iterator[KeyFault]:
    """Check every fence, the team's and the vehicles': the polygon, and that start, target path and ring lie inside."""
    fences = [(f"vehicles[{i}].fence_m", each.fence_m, [(i, each)]) for i, each in vehicles if each.fence_m is not None]
    if safety.fence_m:
        others = [(i, vehicle) for i, vehicle in vehicles if vehicle.fence_m is None]
        fences.insert(0, ("safety.fence_m", safety.fence_m, others))
    for key, corners, inside in fences:
        faults = list(sound(key, corners, "fence"))
        yield from faults
        if faults:
            continue
        fence = Fence(corners)
        for i, vehicle in inside:
            clearance_m = fence.clearance_m(vehicle.start_m)
            if clearance_m < 0.0:
                yield KeyFault(
                    f"vehicles[{i}].start_m", f"{at(vehicle.start_m)} is {-clearance_m:.2f} m outside of {key}"
                )
        if target is not None and mission is not None:
            yield from _around_target(key, fence, 0.0 if ring is None else ring.radius_m, target, mission.duration_s)


def sound(key: str, corners: Sequence[tuple[float, float]], what: str) -> Iterator[KeyFault]:
    """Check that a polygon has corners enough, all different, and edges that do not cross."""
    if len(corners) < 3:
        yield KeyFault(key, f"a {what} needs at least 3 corners (given: {len(corners)})")
        return
    for i, (one, other) in enumerate(zip(corners, (*corners[1:], corners[0]), strict=True)):
        if dist(one, other) < 1e-6:
            yield KeyFault(key, f"corners {i} and {(i + 1) % len(corners)} are the same, {at(one)}")
            return
    crossed = Fence(corners).crossed_edges()
    if crossed is not None:
        yield KeyFault(key, f"the edges from corner {crossed[0]} and from corner {crossed[1]} meet: order the corners")


def _around_target(
    key: str, fence: Fence, radius_m: float, target: TargetSection, duration_s: float
) -> Iterator[KeyFault]:
    """Check target path and ring; the fault states when and where the first of them leaves the fence."""
    for time_s, (x, y) in target.motion.path_m(duration_s, _PATH_POINTS):
        room_m = fence.clearance_m((x, y))
        if room_m < radius_m:
            what = "the target's path" if room_m < 0.0 else f"the ring of {radius_m} m around it"
            yield KeyFault(
                key,
                f"{what} is {radius_m - room_m if room_m >= 0.0 else -room_m:.2f} m outside, "
                f"with the target at {at((x, y))} after {time_s:.0f} s",
            )
            return


def at(place_m: tuple[float, float]) -> str:
    """Return a place as text."""
    return f"({place_m[0]:g}, {place_m[1]:g})"
