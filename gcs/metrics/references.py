"""The references of a mission, from which its flights may deviate by the tolerances of the verdicts."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, radians, tan, tau
from typing import NamedTuple

import msgspec
import numpy as np
from pydantic import Field

from agents.ring.bent_ring import RingBend, bend_of
from agents.ring.commanded_ring import change_s
from agents.ring.place import Gaps
from agents.safety.routes import flown_zones
from agents.settings.sections import EncirclementSettings, NoFlySection
from agents.tactics import NO_TACTIC, Tactic
from estimation.state import Vector
from gcs.metrics.ending import named
from gcs.metrics.record import FlightEvent, FlightRecord, Mask, VehicleTrack
from gcs.mission.mission import Mission, VerdictSection

HEIGHT_SHARE = 0.8
"""The share of `safety.vertical_separation_m` that the heights of two vehicles differ by while each is on its own."""
GRACE_S = 30.0
"""A vehicle that did not engage counts as missing if it had at least this time to decide."""
_MAY_ENGAGE = [each.value for each in (Tactic.FORMATION, Tactic.ASIDE, Tactic.HOLD)]


@dataclass(frozen=True, slots=True)
class EngagementReference:
    """The vehicles for which the mission's target is important enough and not too dangerous, by id.

    `distance_max_m` is the distance from the target within which each decides to engage. `planned` are those that the
    whole mission brings near enough.
    """

    distance_max_m: Mapping[int, float] = field(default_factory=dict)
    planned: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class EngagementResult:
    """The vehicles that were to engage, those that did, and those whose flight ended too early to tell."""

    to_engage: tuple[int, ...] = ()
    engaged: tuple[int, ...] = ()
    pending: tuple[int, ...] = ()

    @property
    def missing(self) -> tuple[int, ...]:
        """The vehicles that were to engage and did not."""
        return tuple(each for each in self.to_engage if each not in self.engaged)

    @property
    def holds(self) -> bool | None:
        """Whether all that were to engage did, None if none was to engage, or if that is open."""
        return False if self.missing else None if self.pending or not self.to_engage else True


def engagement(
    record: FlightRecord, reference: EngagementReference, engaged_s: Sequence[float | None]
) -> EngagementResult:
    """Return who was to engage and who did; `engaged_s` are the times of engagement in the record's order.

    If the team never came near the target, none was to engage. Otherwise each vehicle of the reference that had enough
    time was to engage, also one that passed too far away, unless its own distance is smaller than the team's, and one
    that joined and fell silent in the air. Those that were to by the plan are pending if they still could at the end,
    or are not known.
    """
    rows = list(zip(record.vehicles, engaged_s, strict=True))
    engaged = tuple(track.vehicle_id for track, time_s in rows if time_s is not None)
    allowed_m = reference.distance_max_m
    if not allowed_m:
        return EngagementResult((), engaged)
    passes = {track.vehicle_id: _passed(record, track, allowed_m.get(track.vehicle_id, 0.0)) for track, _ in rows}
    near = {vehicle_id: within or vehicle_id in engaged for vehicle_id, (within, _) in passes.items()}
    silent = {each.vehicle for each in record.endings if each.fell_silent}
    missing = {vehicle_id for vehicle_id in _chosen(allowed_m, near) if passes[vehicle_id][1] or vehicle_id in silent}
    to_engage = tuple(track.vehicle_id for track, _ in rows if track.vehicle_id in {*engaged, *missing})
    gone = {track.vehicle_id for track, _ in rows if not _may_engage_yet(track)}
    pending = (vehicle_id for vehicle_id in reference.planned if vehicle_id not in {*to_engage, *gone})
    return EngagementResult(to_engage, engaged, tuple(pending))


def _chosen(allowed_m: Mapping[int, float], near: Mapping[int, bool]) -> tuple[int, ...]:
    """Return who engages a target: once a vehicle is near it, those that are, and those with the team's distance."""
    if not any(near.values()):
        return ()
    widest_m = max(allowed_m.values())
    return tuple(each for each, within in near.items() if each in allowed_m and (within or allowed_m[each] == widest_m))


def _may_engage_yet(track: VehicleTrack) -> bool:
    """Whether a vehicle could still engage when it was known last."""
    return track.last_tactic in (NO_TACTIC, Tactic.STANDBY.value, *_MAY_ENGAGE)


def engaged_line(result: EngagementResult) -> str:
    """Return how many vehicles engaged of those that were to, and which did not; empty if none was to engage."""
    count = len(result.to_engage) + len(result.pending)
    if not count:
        return ""
    missing = f"; {named(result.missing)} did not" if result.missing else ""
    pending = f"; the flight ended before {named(result.pending)} could" if result.pending else ""
    return f"{len(result.to_engage) - len(result.missing)} of {count} vehicles engaged{missing}{pending}"


def _passed(record: FlightRecord, track: VehicleTrack, allowed_m: float) -> tuple[bool, bool]:
    """Return whether a vehicle came within a distance of the target while it could engage, and had time for it.

    It had time if it was within that distance, or else nearest, at least `GRACE_S` before it could last engage.
    """
    distance_m = np.hypot(*(track.position_m - record.target_path_m).T)
    free = np.flatnonzero(np.isin(track.tactic, _MAY_ENGAGE) & np.isfinite(distance_m))
    if not free.size:
        return False, False
    near = free[distance_m[free] < allowed_m]
    due = near[0] if near.size else free[np.argmin(distance_m[free])]
    return bool(near.size), bool(record.time_s[free[-1]] - record.time_s[due] >= GRACE_S)


class EarlierRing(NamedTuple):
    """A ring that was desired until operators commanded the next one, and how long the change to that takes."""

    until_s: float
    radius_m: float
    angular_rate_rad_s: float
    change_s: float = 0.0


@dataclass(frozen=True, slots=True)
class DesiredRing:
    """The desired ring about the target; a positive angular rate is counter-clockwise seen from above.

    It is the last one that was commanded; `earlier` are those before it, in order. The angles between vehicles are in
    proportion to the weights `gaps`. A ring with heights of its own has the vehicles' `heights_m` at its centre, by id,
    and rises by `rise_m` to its highest point at the bearing `highest_rad`. Heights that differ by `above_m` separate
    two vehicles if one is on its way out or home; any two where rings that have heights `are_stacked`. About a target
    at rest it may `bend` around the no-fly `zones`: radii then count as if it did not.
    """

    radius_m: float
    angular_rate_rad_s: float
    gaps: Gaps = field(default_factory=dict)
    earlier: tuple[EarlierRing, ...] = ()
    heights_m: Mapping[int, float] = field(default_factory=dict)
    rise_m: float = 0.0
    highest_rad: float = 0.0
    above_m: float = inf
    are_stacked: bool = False
    bend: RingBend | None = None
    zones: tuple[NoFlySection, ...] = ()

    def height_m(self, vehicle_id: int, bearing_rad: Vector) -> Vector:
        """Return the desired height (T,) of a vehicle at its bearings, NaN on a ring without heights of its own."""
        return self.heights_m.get(vehicle_id, np.nan) + self.rise_m * np.cos(bearing_rad - self.highest_rad)

    def outline_m(self, count: int) -> Vector:
        """Return places (count, 2) on the ring relative to its target, counter-clockwise."""
        bearings_rad: Vector = np.arange(count, dtype=np.float64) * (tau / count)
        radii_m = self.radius_m + (np.zeros(count) if self.bend is None else self.bend.at(bearings_rad)[0])
        outline_m: Vector = np.stack((radii_m * np.cos(bearings_rad), radii_m * np.sin(bearings_rad)), axis=1)
        return outline_m

    @property
    def changed_s(self) -> list[float]:
        """When another ring was commanded."""
        return [each.until_s for each in self.earlier]

    def changes(self, time_s: Vector) -> Mask:
        """Return when (T,) the ring was on its way from one to the next."""
        mask = np.zeros(time_s.shape, dtype=np.bool_)
        for each in self.earlier:
            mask |= (time_s >= each.until_s) & (time_s < each.until_s + each.change_s)
        return mask

    def began_s(self, engaged_s: Iterable[float | None]) -> list[float]:
        """Return when the ring began to settle: at every engagement, and when another ring was commanded after one."""
        known_s = [each for each in engaged_s if each is not None]
        return known_s + [each for each in self.changed_s if known_s and each >= min(known_s)]

    def before(self, time_s: float) -> "DesiredRing":
        """Return the ring as if none had been commanded from a time on; its heights are not known then."""
        later = [each for each in self.earlier if each.until_s >= time_s]
        if not later:
            return self
        kept = self.earlier[: len(self.earlier) - len(later)]
        radius_m, rate_rad_s = later[0].radius_m, later[0].angular_rate_rad_s
        return replace(self, radius_m=radius_m, angular_rate_rad_s=rate_rad_s, earlier=kept, heights_m={})

    def over_m(self, time_s: Vector) -> Vector:
        """Return the desired radius (T,) over time."""
        return self._over(time_s, [*(each.radius_m for each in self.earlier), self.radius_m])

    def over_rad_s(self, time_s: Vector) -> Vector:
        """Return the desired angular rate (T,) over time."""
        return self._over(time_s, [*(each.angular_rate_rad_s for each in self.earlier), self.angular_rate_rad_s])

    def _over(self, time_s: Vector, values: Sequence[float]) -> Vector:
        return np.array(values)[np.searchsorted(self.changed_s, time_s, side="right")]


@dataclass(frozen=True, slots=True)
class FormationReference:
    """The desired formation, travelling along +x of the mission frame.

    `slots_m` maps vehicle ids to their slots (x, y) in line order: each spacing is measured to the previous vehicle.
    """

    speed_m_s: float
    slots_m: Mapping[int, tuple[float, float]]


class VerdictTolerances(VerdictSection):
    """The tolerances of the verdicts: the mission's, and the required separation. A metric equal to its own holds."""

    separation_m: float = Field(gt=0.0)


def ring_reference(mission: Mission, events: Iterable[FlightEvent] = ()) -> DesiredRing:
    """Return the ring of the mission, changed by the commands among the events of a flight."""
    ring, earlier = mission.encirclement, []
    flying_m = min(vehicle.section.altitude_m for vehicle in mission.vehicles)
    noted, at = [ring], dict[int, int]()  # the rings in order, and the last one that each vehicle has noted
    for event in events:
        if event.ring is None:
            continue
        values = msgspec.structs.asdict(event.ring)
        del values["ring"], values["name"]
        commanded = ring.model_copy(update=values)
        later = range(at.get(event.vehicle, 0) + 1, len(noted))
        # Every vehicle notes the ring, the last one perhaps after the first has noted the next.
        if (known := next((k for k in later if noted[k] == commanded), None)) is not None:
            at[event.vehicle] = known
        elif commanded != ring:
            changes_s = change_s(ring, commanded, flying_m)
            earlier.append(EarlierRing(event.time_s, ring.radius_m, ring.angular_rate_rad_s, changes_s))
            noted.append(commanded)
            ring, at[event.vehicle] = commanded, len(noted) - 1
    rise_m = ring.radius_m * tan(radians(ring.tilt_deg))
    heights = _heights_m(mission, ring), rise_m, radians(ring.tilt_bearing_deg)
    is_stacked = any(each.encirclement.has_heights for each in mission.rings)
    above_m = HEIGHT_SHARE * mission.safety.vertical_separation_m
    ways = *heights, above_m, is_stacked, ring_bend(mission, ring), mission.safety.no_fly
    return DesiredRing(ring.radius_m, ring.angular_rate_rad_s, mission.gaps, tuple(earlier), *ways)


def ring_bend(mission: Mission, ring: EncirclementSettings) -> RingBend | None:
    """Return how a ring about the mission's target bends around no-fly zones at its heights.

    None without zones, or about a target that moves.
    """
    config = replace(mission.agent_config(mission.vehicles[0]), encirclement=ring)
    if not flown_zones(config) or not mission.target.has_planned_path or mission.target.speed_max_m_s:
        return None
    return bend_of(config, mission.target.start_m)


def ring_references(mission: Mission, record: FlightRecord) -> tuple[DesiredRing, ...]:
    """Return the rings of the mission in order, also if there is one, changed by the commands in a flight's record."""
    return tuple(
        ring_reference(mission.of_ring(number), record.of_ring(number).events)
        for number in range(max(len(mission.rings), 1))
    )


def _heights_m(mission: Mission, ring: EncirclementSettings) -> dict[int, float]:
    """Return the vehicles' heights at the centre of a ring, none on one without heights of its own."""
    if not ring.has_heights or ring.altitude == "target":
        return {}
    flying_m = {vehicle.id: vehicle.section.altitude_m for vehicle in mission.vehicles}
    above_m = ring.lowest_m(min(flying_m.values())) - min(flying_m.values())
    return {vehicle_id: height_m + above_m for vehicle_id, height_m in flying_m.items()}


def formation_reference(mission: Mission) -> FormationReference:
    """Return the formation of the mission, vehicles in line order."""
    formation = mission.formation
    offsets = mission.agent_config(mission.vehicles[0]).slot_offset_m
    slots = {vehicle_id: offsets(vehicle_id, formation.leader) for vehicle_id in mission.ids}
    return FormationReference(formation.speed_m_s, slots)


def engagement_reference(mission: Mission) -> EngagementReference:
    """Return which vehicles engage the mission's target by their thresholds; a flight for identification has none."""
    target = mission.target
    if mission.excites:
        return EngagementReference()
    allowed_m = {
        vehicle.id: vehicle.decision.distance_max_m
        for vehicle in mission.vehicles
        if target.importance > vehicle.decision.importance_min and target.threat < vehicle.decision.threat_max
    }
    near = dict.fromkeys(allowed_m, True)
    # Where an external target or one that evades will be is not known: the mission is about it.
    if target.has_planned_path:
        _, away_m = formation_path(mission)
        near = {each: bool(away_m[each].min() < allowed_m[each]) for each in allowed_m}
    # A vehicle in reserve engages only if it is called.
    return EngagementReference(
        allowed_m, tuple(each for each in _chosen(allowed_m, near) if each not in mission.reserves)
    )


_PLAN_POINTS = 2000


def formation_path(mission: Mission) -> tuple[Vector, Mapping[int, Vector]]:
    """Return the times of a mission, and how far each vehicle is from the simulated target at each, by id.

    That is at its start, and then in formation until the end.
    """
    target, speed_m_s = mission.target.motion, mission.formation.speed_m_s
    time_s = np.linspace(0.0, mission.mission.duration_s, _PLAN_POINTS)
    target_m = np.array([target.position_m(at_s) for at_s in time_s.tolist()])
    away_m = {}
    for vehicle in mission.vehicles:
        config = mission.agent_config(vehicle)
        slot_m = np.add(config.line_start_m, config.slot_offset_m(vehicle.id, mission.formation.leader))
        place_m = slot_m + np.outer(time_s, (speed_m_s, 0.0))
        place_m[0] = vehicle.section.start_m
        away_m[vehicle.id] = np.hypot(*(place_m - target_m).T)
    return time_s, away_m


def verdict_tolerances(mission: Mission) -> VerdictTolerances:
    """Return the tolerances of the mission's verdicts."""
    return VerdictTolerances(**mission.verdicts.model_dump(), separation_m=mission.safety.separation_m)
