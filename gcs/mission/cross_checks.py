"""Checks across the sections of a mission: ids, positions, limits and orders."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import asin, ceil, floor, hypot, log, pi
from typing import Any

from agents.ring.place import chord_m, even_places
from agents.settings.sections import (
    ChoreographySettings,
    DecisionSettings,
    EncirclementSettings,
    FailsafeSettings,
    FormationSettings,
    SafetySettings,
)
from estimation.plant.model import FEEDFORWARD_MAX, Plant, PlantAxis
from estimation.profile.autopilots import DEFAULT
from estimation.profile.profile import Profile
from gcs.errors import KeyFault
from gcs.mission.excitation import limits_rise
from gcs.mission.geometry import (
    IndexedVehicles,
    altitudes_fit,
    fence_fits,
    follows_fit,
    limits_agree,
    ring_in_range,
    slots_fit,
)
from gcs.mission.mission import (
    FrameSection,
    LinkSection,
    MissionVehicle,
    NetworkSection,
    TargetSection,
    VehicleSection,
)
from gcs.mission.rally import rally_fits
from gcs.mission.stability import kept_up
from gcs.mission.zones import zones_fit

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


LAYER_LEAST_M = 1.0


def _reserves(known: Sequence[tuple[int, VehicleSection]], leader: int) -> Iterator[KeyFault]:
    """Check that vehicles begin the mission, among them the leader."""
    reserves = [(i, vehicle) for i, vehicle in known if vehicle.reserve]
    for i, vehicle in reserves:
        if vehicle.id == leader:
            yield KeyFault(f"vehicles[{i}].reserve", f"the leader of the formation cannot be in reserve (id {leader})")
    if len(known) - len(reserves) < 2 and reserves:
        yield KeyFault("vehicles", "with vehicles in reserve, at least two others have to fly")


def cross_checked(sections: Mapping[str, Any], vehicles: list[LoadedVehicle | None], places: int) -> Iterator[KeyFault]:
    """Check across sections, each of its model, or None or missing if it is not valid itself.

    The ring of `[encirclement]` has so many places; with several rings the mission is checked with each of them.
    """
    known = [(i, vehicle[0]) for i, vehicle in enumerate(vehicles) if vehicle is not None]
    yield from _all_distinct(known)
    formation: FormationSettings | None = sections.get("formation")
    ring: EncirclementSettings | None = sections.get("encirclement")
    safety: SafetySettings | None = sections.get("safety")
    network: NetworkSection | None = sections.get("network")
    link: LinkSection | None = sections.get("link")
    if formation is not None and len(known) == len(vehicles) and known:
        ids = [vehicle.id for _, vehicle in known]
        if formation.leader not in ids:
            yield KeyFault(
                "formation.leader", f"no vehicle has the id {formation.leader} (ids: {', '.join(map(str, ids))})"
            )
        yield from _reserves(known, formation.leader)
    if safety is not None:
        yield from _starts_apart(known, safety)
        if ring is not None:
            yield from _places_apart(known, safety, ring, places, complete=len(known) == len(vehicles))
        yield from _inside_limits(sections, known, safety, places)
    if ring is not None and network is not None and network.range_m is not None:
        yield from ring_in_range(ring, network.range_m, places)
    yield from _located(sections.get("frame"), safety, known)
    yield from kept_up(sections.get("mission"), link)
    if link is not None:
        yield from of_another_kind(link, vehicles)
    yield from _way_home(known, sections.get("choreography"))
    yield from _in_order(sections.get("failsafe"))
    yield from limits_rise(sections.get("excitation"))
    yield from _fast_enough(vehicles, formation, ring, sections.get("target"))


def _all_distinct(vehicles: IndexedVehicles) -> Iterator[KeyFault]:
    yield from _distinct(vehicles, "id", lambda v: v.id)
    yield from _distinct(vehicles, "system_id", lambda v: v.system_id or v.id)
    yield from _distinct(vehicles, "url", lambda v: _exclusive_part(v.url), shared=lambda v: v.link)
    yield from _distinct(vehicles, "endpoint", lambda v: v.endpoint)


def _inside_limits(
    sections: Mapping[str, Any], vehicles: IndexedVehicles, safety: SafetySettings, places: int
) -> Iterator[KeyFault]:
    formation, ring, target = (sections.get(name) for name in ("formation", "encirclement", "target"))
    yield from slots_fit(vehicles, safety, formation, sections.get("network"))
    yield from limits_agree(safety, ring, formation)
    yield from altitudes_fit(vehicles, safety, sections.get("choreography"))
    yield from follows_fit(vehicles, safety, ring, target)
    yield from fence_fits(safety, vehicles, ring, target, sections.get("mission"))
    yield from zones_fit(safety, vehicles, ring, target, sections.get("choreography"), places)
    yield from rally_fits(safety, vehicles, sections.get("choreography"))


def _exclusive_part(url: str) -> str:
    """Return the part of a url that only one vehicle can use: the local port, the device, or the remote address."""
    scheme, _, rest = url.partition("://")
    if scheme in ("udpin", "tcpin"):
        return rest.rpartition(":")[2]
    return rest.partition(":")[0] if scheme == "serial" else rest


def _distinct(
    vehicles: IndexedVehicles,
    key: str,
    value: Callable[[VehicleSection], object],
    shared: Callable[[VehicleSection], object] = lambda _: None,
) -> Iterator[KeyFault]:
    """Yield the pairs with the same value, unless they share the link that it comes from (`shared`)."""
    for (i, one), (k, other) in combinations(vehicles, 2):
        if value(one) == value(other) and (shared(one) is None or shared(one) != shared(other)):
            # Equal ids have equal default system ids: one fault, not two.
            if key == "system_id" and one.id == other.id:
                continue
            yield KeyFault(
                f"vehicles[{k}].{key}", f"{value(other)} is vehicles[{i}]'s already: each vehicle needs its own"
            )


def _starts_apart(vehicles: IndexedVehicles, safety: SafetySettings) -> Iterator[KeyFault]:
    least = safety.separation_m
    for (i, one), (k, other) in combinations(vehicles, 2):
        distance = hypot(one.start_m[0] - other.start_m[0], one.start_m[1] - other.start_m[1])
        if distance < least:
            yield KeyFault(
                f"vehicles[{k}].start_m",
                f"{distance:.2f} m from vehicles[{i}], less than safety.separation_m = {least} m",
            )


def _places_apart(
    vehicles: IndexedVehicles, safety: SafetySettings, ring: EncirclementSettings, places: int, *, complete: bool
) -> Iterator[KeyFault]:
    """Check the places of a ring, and the gaps of any vehicles that may be on it, if all are known (`complete`)."""
    least = safety.separation_m
    if places > 1 and chord_m(ring.radius_m, places) < least:
        yield KeyFault(
            "encirclement.radius_m",
            f"{places} vehicles on a ring of {ring.radius_m} m are "
            f"{chord_m(ring.radius_m, places):.2f} m apart, less than safety.separation_m = {least} m; "
            f"it takes {_least_radius_m(least, places)} m",
        )
    elif complete and places > 1 and len(vehicles) > 1:
        yield from _gaps_fit(_least_even(vehicles, places), least, ring.radius_m)


def _least_even(vehicles: IndexedVehicles, places: int) -> IndexedVehicles:
    """Return the vehicles of one ring whose gaps differ most: the narrowest one, and the widest."""
    narrowest = min(vehicles, key=lambda each: each[1].gap)
    others = [each for each in vehicles if each is not narrowest]
    widest = sorted(others, key=lambda each: each[1].gap, reverse=True)[: places - 1]
    return sorted([narrowest, *widest], key=lambda each: each[0])


def _least_radius_m(separation_m: float, places: float) -> float:
    """Return the smallest radius at which so many even places are a separation apart, in whole centimetres."""
    return ceil(100.0 * separation_m / chord_m(1.0, places)) / 100.0


def _gaps_fit(vehicles: IndexedVehicles, separation_m: float, radius_m: float) -> Iterator[KeyFault]:
    """Check that the narrowest gap on a ring with room for even gaps is as wide as the separation.

    The fault is that of the weight farthest from 1, with the nearest that fits, if it alone can be changed to fit.
    """
    weights = [vehicle.gap for _, vehicle in vehicles]
    places, narrowest = even_places(weights), min(vehicles, key=lambda each: each[1].gap)
    if chord_m(radius_m, places) >= separation_m:
        return
    index, odd = max(vehicles, key=lambda each: abs(log(each[1].gap)))
    others = sorted(each.gap for _, each in vehicles if each is not odd)
    room = pi / asin(separation_m / 2.0 / radius_m)
    fits = ""
    if odd.gap > 1.0 and (most := others[0] * room - sum(others)) >= others[0]:
        fits = f"at most {floor(most * 100.0) / 100.0}, or "
    if odd.gap < 1.0 and (least := sum(others) / (room - 1.0)) <= others[0]:
        fits = f"at least {ceil(least * 100.0) / 100.0}, or "
    yield KeyFault(
        f"vehicles[{index}].gap",
        f"with {odd.gap} of {sum(weights):g} in all the gap of vehicles[{narrowest[0]}] on a ring of {radius_m} m is "
        f"{chord_m(radius_m, places):.2f} m, less than safety.separation_m = {separation_m} m; "
        f"{fits}encirclement.radius_m = {_least_radius_m(separation_m, places)}",
    )


def _way_home(
    vehicles: list[tuple[int, VehicleSection]], choreography: ChoreographySettings | None
) -> Iterator[KeyFault]:
    if choreography is None:
        return
    order, ids = choreography.landing_order, [vehicle.id for _, vehicle in vehicles]
    for i, vehicle_id in enumerate(order):
        if vehicle_id not in ids:
            known = ", ".join(map(str, ids))
            yield KeyFault(f"choreography.landing_order[{i}]", f"no vehicle has the id {vehicle_id} (ids: {known})")
        if vehicle_id in order[:i]:
            yield KeyFault(f"choreography.landing_order[{i}]", f"vehicle {vehicle_id} is listed twice")
    if choreography.landing == "return" and choreography.layer_m < LAYER_LEAST_M and len(vehicles) > 1:
        yield KeyFault(
            "choreography.layer_m",
            f"{choreography.layer_m} m is too little: returning vehicles cross each other's "
            f"paths, in layers of at least {LAYER_LEAST_M} m",
        )


def _in_order(failsafe: FailsafeSettings | None) -> Iterator[KeyFault]:
    """Check that the thresholds of more severe conditions come after those of less severe ones."""
    if failsafe is None:
        return
    low, critical = failsafe.battery_low, failsafe.battery_critical
    if critical >= low and critical > 0.0:
        yield KeyFault("failsafe.battery_critical", f"{critical} must be less than battery_low = {low}")
    one_s, all_s = failsafe.peer_silent_s, failsafe.peers_silent_s
    if all_s < one_s:
        yield KeyFault(
            "failsafe.peers_silent_s", f"{all_s} s, for all peers, is less than peer_silent_s = {one_s} s, for one"
        )


def _located(
    frame: FrameSection | None, safety: SafetySettings | None, vehicles: list[tuple[int, VehicleSection]]
) -> Iterator[KeyFault]:
    """Check that the frame has a position on Earth, or that no key depends on one."""
    if frame is None:
        return
    place = {name: getattr(frame, name) for name in ("latitude_deg", "longitude_deg", "altitude_m")}
    for name, value in place.items():
        if frame.local and value is not None:
            yield KeyFault(
                f"frame.{name}", f"a local frame has no position on Earth: leave this key or local out (given: {value})"
            )
        if not frame.local and value is None:
            yield KeyFault(f"frame.{name}", "this key is missing; indoors, without GPS, write local = true instead")
    if frame.local and safety is not None and safety.elevation is not None:
        reason = f"a local frame has no ground in a file: leave this key or local out (given: {safety.elevation})"
        yield KeyFault("safety.elevation", reason)
    if frame.external_positions and not frame.local:
        yield KeyFault(
            "frame.external_positions", "with a [frame] on Earth the autopilots use GPS: set local = true as well"
        )
    for i, vehicle in vehicles:
        if vehicle.origin_m is not None and not frame.local:
            yield KeyFault(
                f"vehicles[{i}].origin_m", "with a [frame] on Earth the vehicle reports its origin: leave this key out"
            )


def _within_reach(ring: EncirclementSettings) -> Iterator[KeyFault]:
    near_m, far_m, ring_m = ring.radius_min_m, ring.far_m, ring.radius_m
    if near_m >= ring_m:
        yield KeyFault(
            "tuning.encirclement.radius_min_m", f"{near_m} m must be less than encirclement.radius_m = {ring_m} m"
        )
    if far_m <= ring_m:
        yield KeyFault(
            "tuning.encirclement.radius_far_m", f"{far_m} m must be more than encirclement.radius_m = {ring_m} m"
        )


def _fast_enough(
    vehicles: list[LoadedVehicle | None],
    formation: FormationSettings | None,
    ring: EncirclementSettings | None,
    target: TargetSection | None,
) -> Iterator[KeyFault]:
    """Check the speeds of ring and line against their own limits and those of every vehicle's profile."""
    if formation is not None and formation.speed_m_s > formation.speed_max_m_s:
        highest = formation.speed_max_m_s
        yield KeyFault("formation.speed_m_s", f"{formation.speed_m_s} m/s is more than speed_max_m_s = {highest} m/s")
    if ring is None:
        return
    yield from _within_reach(ring)
    if target is None:
        return
    along_m_s = abs(ring.angular_rate_rad_s) * ring.radius_m
    needed_m_s = along_m_s + target.speed_max_m_s
    if needed_m_s > ring.speed_max_m_s:
        yield KeyFault(
            "encirclement.angular_rate_rad_s",
            f"{ring.angular_rate_rad_s} rad/s at {ring.radius_m} m about this target "
            f"takes {needed_m_s:.2f} m/s, more than speed_max_m_s = {ring.speed_max_m_s} m/s",
        )
    elif formation is not None:
        yield from beyond_limits(vehicles, max(needed_m_s, formation.speed_m_s), along_m_s**2 / ring.radius_m)
