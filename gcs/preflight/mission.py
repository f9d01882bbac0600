"""Preflight checks of the mission: whether its ring and line are feasible for these vehicles."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import asin, cos, dist, floor, hypot, inf, pi, sin, sqrt

import numpy as np
from msgspec.structs import asdict

from agents.control.excitation import preview
from agents.ring.bent_ring import Bender, RingBend, waiting_places_m
from agents.ring.commanded_ring import RingBounds, ring_bounds
from agents.ring.joining import WAITING
from agents.ring.place import chord_m, even_places
from agents.ring.settling import settling_s
from agents.safety.failsafe import SILENCES_PER_HOUR_MAX
from agents.safety.routes import ZONE_MARGIN_M, flown_zones, routes_between, shapes_of
from agents.settings.sections import NoFlySection
from agents.team.messages import MISSION_RING, CommandedRing, RingValues
from estimation.polar import polar_of
from estimation.vectors import Pair
from gcs.autopilots.registry import advice
from gcs.errors import InputError
from gcs.link.config import link_paces
from gcs.link.rates import (
    FRAMES_MIN,
    LOAD_SHARE,
    SETPOINT_MIN_HZ,
    Load,
    RateController,
    Rates,
    fitting,
    load,
    rate_levels,
)
from gcs.metrics.references import engagement_reference, formation_path, formation_reference
from gcs.metrics.ring import SETTLED_RADIUS_FRACTION, SETTLED_SPACING_RAD
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.rings import of_ring_text
from gcs.preflight.findings import MISSION, Finding, Grade, VehicleFacts, limited

UNASKED_SHARE = 1.5
"""A ratio of received to requested traffic above this indicates streams that were not requested."""


def link_budget(mission: Mission, team: Sequence[VehicleFacts]) -> Iterator[Finding]:
    """Compare requested traffic with the data rate, for each connection whose data rate is known."""
    measured = _measured_bytes_s(mission, team)
    for url, pace in sorted(link_paces(mission).items()):
        if pace.capacity_bytes_s is not None:
            yield _fits(url, pace, pace.capacity_bytes_s)
            if (received_bytes_s := measured.get(url)) is not None:
                yield _received_load(url, pace.load, received_bytes_s)


def _fits(url: str, pace: RateController, capacity_bytes_s: float) -> Finding:
    planned_bytes_s = pace.load.bytes_s
    vehicles = "1 vehicle takes" if pace.vehicles == 1 else f"{pace.vehicles} vehicles take"
    return Finding.graded(
        limited(planned_bytes_s, capacity_bytes_s, LOAD_SHARE),
        MISSION,
        "link budget",
        f"{url}: {vehicles} {planned_bytes_s:.0f} of its {capacity_bytes_s:.0f} bytes/s "
        f"({planned_bytes_s / capacity_bytes_s:.0%}) with {_shown(pace.rates)}",
        f"above {LOAD_SHARE:.0%}, setpoints and commands are delayed",
        _step(pace, capacity_bytes_s),
    )


TIMEOUTS_S = (1.5, 2.0)
"""Longer timeouts that may be proposed: cordon warns of longer ones."""


def losses(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check that losses in bursts seldom silence the link for long enough to end offboard, or to hold the vehicle."""
    known, pace = facts.losses, link_paces(mission)[vehicle.section.url]
    if known.frames < FRAMES_MIN:
        return
    name, _ = facts.autopilot.setpoint_timeout
    pace.offboard_s = facts.autopilot.setpoint_timeout_s(facts.parameters)
    pace.adapt(known)
    found = f"of {known.frames:.0f} messages none was lost"
    why = f"after {pace.telemetry_s:g} s without motion it holds (safety.telemetry_timeout_s)"
    if name:
        why += f", and after {pace.offboard_s:g} s without setpoints it leaves offboard ({name})"
    step = "move the antennas nearer, or use a faster radio, or one for each vehicle"
    if not pace.automatic:
        step += ', or set rates = "auto" in [link]'
    least, likely, most = pace.silences_of(known)
    may_exceed = Grade.WARNING if most > SILENCES_PER_HOUR_MAX else Grade.PASS
    grade = Grade.REFUSE if likely > SILENCES_PER_HOUR_MAX else may_exceed
    if known.lost:
        found = (
            f"{known}: {likely:.2g} silences an hour are likely ({least:.1g} to {most:.1g}) with {_shown(pace.rates)}"
        )
    for timeout_s in TIMEOUTS_S if grade is not Grade.PASS else ():
        pace.telemetry_s, pace.offboard_s = max(timeout_s, pace.telemetry_s), max(timeout_s, pace.offboard_s)
        pace.adapt(known)
        if pace.silences_per_hour <= SILENCES_PER_HOUR_MAX:
            step += f", or set safety.telemetry_timeout_s {f'and {name} ' if name else ''}to {timeout_s:g} s"
            break
    yield Finding.graded(grade, facts.vehicle_id, "losses", found, why, step, temporary=True)


def _step(pace: RateController, capacity_bytes_s: float) -> str:
    levels = rate_levels(pace.rates)
    rates = levels[fitting(levels, pace.vehicles, capacity_bytes_s, signed=pace.signed)]
    least = load(rates, pace.vehicles, signed=pace.signed)
    if least.bytes_s > LOAD_SHARE * capacity_bytes_s:
        return (
            f"the lowest rates take {least.bytes_s:.0f} bytes/s (setpoints at {SETPOINT_MIN_HZ:g} Hz): use a faster "
            "radio, or fewer vehicles on it"
        )
    return f'set [link] to {_shown(rates)}, or rates = "auto"'


def _shown(rates: Rates) -> str:
    return (
        f"telemetry_rate_hz = {rates.telemetry_hz:.3g}, status_rate_hz = {rates.status_hz:.3g}, "
        f"setpoint_rate_hz = {rates.setpoint_hz:.3g}"
    )


def _received_load(url: str, asked: Load, received_bytes_s: float) -> Finding:
    share = received_bytes_s / asked.down_bytes_s
    return Finding.graded(
        Grade.WARNING if share > UNASKED_SHARE else Grade.PASS,
        MISSION,
        "link traffic",
        f"{url}: {received_bytes_s:.0f} bytes/s received from the vehicles, {asked.down_bytes_s:.0f} bytes/s requested",
        "streams that were not requested delay setpoints and commands",
        f"stop other streams on that port ({advice('streams', between='; ')})",
    )


def _measured_bytes_s(mission: Mission, team: Sequence[VehicleFacts]) -> Mapping[str, float]:
    """Return the traffic received on each connection; each of its vehicles' facts hold the sum."""
    urls = {vehicle.id: vehicle.section.url for vehicle in mission.vehicles}
    return {urls[facts.vehicle_id]: facts.link_bytes_s for facts in team if facts.link_bytes_s is not None}


SIGMAS = 2.0
RESERVE = 0.8
"""Usable fraction of a limit: vehicles need a margin for catching up and for wind."""
GAP_RESERVE = 1.2


def feasibility(mission: Mission, *, stubs: bool = False) -> Iterator[Finding]:
    """Check the mission against its own limits; excitation flights are planned within them, and stubs need no fence."""
    if mission.excites:
        return
    yield from _on_each_ring(mission, _ring_gap)
    if len(mission.vehicles) > 1:
        yield _line_gap(mission)
        yield from _far_starts(mission)
    yield from _on_each_ring(mission, _settling)
    if not stubs:
        yield _mission_fence(mission)
    yield from _zones_on_the_way_home(mission)
    yield from _on_each_ring(mission, _zones_on_the_targets_path)
    yield from encounter(mission)
    yield from _on_each_ring(mission, _target_speed)
    yield from _on_each_ring(mission, _ring_acceleration)
    yield _formation_speed(mission)
    for vehicle in mission.vehicles:
        yield _lead(mission, vehicle)


def full_ring(mission: Mission, number: int) -> Mission:
    """Return the mission of one ring with as many vehicles as it has places: the leader, and those least sure of their
    positions.
    """
    if not mission.rings:
        return mission
    least_sure = sorted(
        mission.vehicles, key=lambda each: (each.id != mission.formation.leader, -_position_error_m(each))
    )
    kept = [each.id for each in least_sure[: mission.rings[number].places]]
    return replace(mission.of_ring(number), vehicles=tuple(each for each in mission.vehicles if each.id in kept))


def _on_each_ring(mission: Mission, check: Callable[[Mission], Finding | None]) -> Iterator[Finding]:
    """Yield the findings of a check for each ring, full of vehicles."""
    for number in range(max(len(mission.rings), 1)):
        if (finding := check(full_ring(mission, number))) is not None:
            yield _of_ring(finding, mission, number)


def _of_ring(finding: Finding, mission: Mission, number: int) -> Finding:
    """Return a finding about the mission of one ring with the name and the keys of that ring, if there are several."""
    if not mission.rings:
        return finding
    ring = mission.rings[number]
    target = ring.target if mission.targets else None
    texts = (f"ring {ring.name}: {finding.found}", finding.why, finding.next_step)
    found, why, next_step = (of_ring_text(text, number, target) for text in texts)
    return replace(finding, found=found, why=why, next_step=next_step)


def commanded_ring_bounds(mission: Mission, ring: int = 0) -> RingBounds:
    """Return the bounds of what the whole team can be commanded to fly about the target of a ring, full of vehicles."""
    every = [ring_bounds(mission.agent_config(vehicle).on_ring(ring)) for vehicle in mission.vehicles]
    target = mission.of_ring(ring).target
    is_seen = target.source == "simulated"
    ranges_m = [mission.sensor(vehicle_id, target).range_m for vehicle_id in mission.ids] if is_seen else []
    return RingBounds(
        max(each.radius_min_m for each in every),
        min([each.radius_max_m for each in every] + ranges_m),
        RESERVE * min(each.speed_max_m_s for each in every) - target.speed_max_m_s,
        RESERVE * min(each.acceleration_max_m_s2 for each in every),
        every[0].altitude_min_m,
        every[0].altitude_max_m,
        every[0].climb_max_m_s,
    )


def ring_change_faults(
    mission: Mission, values: RingValues, flown: Sequence[CommandedRing] = (), ring: int = 0
) -> list[str]:
    """Return why a team must not be commanded to other values of a ring: the checks that only the mission passes.

    `flown` are the values of the mission's rings that were commanded before, in order, empty if none were: the ring has
    those of its own that the command leaves out, and must not cut the others.
    """
    sections = [f"rings[{number}]" for number in range(len(mission.rings))] or ["encirclement"]
    before = flown or [MISSION_RING] * len(sections)
    values = _received(values)
    wanted = {
        section: _given(commanded, values if number == ring else RingValues())
        for number, (section, commanded) in enumerate(zip(sections, before, strict=True))
    }
    try:
        # The range of the radios stays: a default that follows the ring would not.
        changed = mission.replace(network={"range_m": mission.range_m}, **wanted)
    except InputError as error:
        return list(error.faults)
    grades = {found.check: found.grade for found in feasibility(full_ring(mission, ring))}
    after = (_of_ring(found, changed, ring) for found in feasibility(full_ring(changed, ring)))
    worse = (found for found in after if grades.get(found.check) is Grade.PASS is not found.grade)
    return [f"{found.check}: {found.found}; {found.why}; next: {found.next_step}" for found in worse]


def _received(values: RingValues) -> RingValues:
    """Return the values of a command as vehicles fly them, in the units of their messages."""
    return RingValues(*(value for value, _ in MISSION_RING.commanded(values, 0.0).dated))


def _given(flown: CommandedRing, values: RingValues) -> dict[str, float]:
    """Return the values of a commanded ring that are not the mission's, with those of a further command."""
    wanted = {key: getattr(flown, key) if value is None else value for key, value in asdict(values).items()}
    return {key: value for key, value in wanted.items() if value is not None}


def autopilot_limits(mission: Mission, facts: VehicleFacts) -> Iterator[Finding]:
    """Check the speed and acceleration that the mission needs against the autopilot's limits."""
    speed_m_s = max(ring_speed_m_s(mission), mission.formation.speed_m_s)
    acceleration_m_s2 = ring_acceleration_m_s2(mission)
    if mission.excites:
        planned = preview(mission.agent_config(mission.vehicles[0]))
        speed_m_s, acceleration_m_s2 = planned.speed_m_s, planned.acceleration_m_s2
    yield _within(facts, "speed", speed_m_s, "m/s", facts.autopilot.speed_limits)
    yield _within(facts, "acceleration", acceleration_m_s2, "m/s²", facts.autopilot.acceleration_limits)


def ring_speed_m_s(mission: Mission) -> float:
    """Return the highest ground speed on a ring: along it, and along with the target."""
    return max(_along_ring_m_s(alone) + alone.target.speed_max_m_s for alone in mission.alone)


def ring_acceleration_m_s2(mission: Mission) -> float:
    """Return the highest centripetal acceleration on a ring, v²/R."""
    return max(_along_ring_m_s(alone) ** 2 / alone.encirclement.radius_m for alone in mission.alone)


def extent_m(mission: Mission, vehicle: MissionVehicle) -> float:
    """Return a vehicle's largest distance from its start: on its line, a ring, at a rally point, or in its box."""
    x, y = vehicle.section.start_m
    if mission.excites:
        return max(hypot(corner_x - x, corner_y - y) for corner_x, corner_y in mission.safety.fence_m)
    duration_s = mission.mission.duration_s
    around_m = [
        hypot(end_x - x, end_y - y) + alone.encirclement.radius_m
        for alone in mission.alone
        for _, (end_x, end_y) in alone.target.motion.path_m(duration_s, 2)
    ]
    rally_m = [hypot(spot_x - x, spot_y - y) for spot_x, spot_y in mission.rally_m(vehicle)]
    return max(*around_m, *rally_m, mission.formation.speed_m_s * duration_s)


def highest_m(mission: Mission, vehicle: MissionVehicle) -> float:
    """Return a vehicle's greatest height: that of its mission, or of a layer at take-off or landing."""
    config = mission.agent_config(vehicle)
    home_m = config.return_altitude_m if mission.choreography.landing == "return" else 0.0
    rings = [alone.encirclement for alone in mission.alone]
    above_target_m = config.safety.altitude_max_m if any(ring.altitude == "target" for ring in rings) else None
    lowest_m = max(ring.lowest_m(config.lowest_m) + ring.rise_m for ring in rings)
    on_ring_m = config.altitude_m - config.lowest_m + lowest_m
    return max(config.altitude_m, config.take_off_altitude_m, home_m, on_ring_m, above_target_m or 0.0)


def _along_ring_m_s(mission: Mission) -> float:
    return abs(mission.encirclement.angular_rate_rad_s) * mission.encirclement.radius_m


def _ring_gap(mission: Mission) -> Finding | None:
    ring, count = mission.encirclement, len(mission.vehicles)
    if count == 1:
        return None
    wanted_m = GAP_RESERVE * mission.safety.separation_m + _distance_error_m(mission)
    room = max(1, floor(pi / asin(min(wanted_m / (2.0 * ring.radius_m), 1.0))))
    what = f"{count} vehicles on a ring of {ring.radius_m:g} m, which has room for {room}"
    places = even_places(list(mission.gaps.values()))
    if places > count:
        what += f" with even gaps; the narrowest gap is {360.0 / places:.1f} degrees"
    enough_m = wanted_m / chord_m(1.0, places)
    step = f"increase encirclement.radius_m to {enough_m:.1f} m, fly fewer vehicles, or lower safety.separation_m"
    return _gap(mission, "ring spacing", what, chord_m(ring.radius_m, places), step)


def _settling(mission: Mission) -> Finding | None:
    """Predict how long the ring takes to settle if all vehicles engage together, a target being ahead of the line."""
    if len(mission.vehicles) == 1:
        return None
    slots_m = formation_reference(mission).slots_m
    middle_m = sum(y_m for _, y_m in slots_m.values()) / len(slots_m)
    engaged = {}
    for vehicle_id in sorted(mission.ids):
        away_m = mission.vehicle(vehicle_id).decision.distance_max_m
        aside_m = max(-away_m, min(slots_m[vehicle_id][1] - middle_m, away_m))
        engaged[vehicle_id] = polar_of(-sqrt(away_m**2 - aside_m**2), aside_m, mission.formation.speed_m_s, 0.0)
    config = mission.agent_config(mission.vehicles[0])
    took_s = settling_s(config, engaged, SETTLED_RADIUS_FRACTION, SETTLED_SPACING_RAD)
    settles = took_s < inf
    return Finding.graded(
        Grade.PASS if settles else Grade.WARNING,
        MISSION,
        "settling",
        f"{len(engaged)} vehicles that engage together settle "
        + (f"after about {took_s:.0f} s" if settles else "after more than five minutes, or never"),
        "spacings stay uneven",
        "raise tuning.encirclement.spacing_gain_per_s or encirclement.spacing_speed_max_m_s",
    )


def _line_gap(mission: Mission) -> Finding:
    step = "increase formation.spacing_m, or lower safety.separation_m"
    return _gap(mission, "line spacing", "neighbours in the line", mission.formation.spacing_m, step)


def _far_starts(mission: Mission) -> Iterator[Finding]:
    """Warn of each vehicle that starts out of the radio range of all others."""
    starts_m = {each.id: each.section.start_m for each in mission.vehicles}
    for vehicle_id, start_m in starts_m.items():
        away_m = min(dist(start_m, other_m) for other, other_m in starts_m.items() if other != vehicle_id)
        if away_m > mission.range_m:
            yield Finding.graded(
                Grade.WARNING,
                vehicle_id,
                "start",
                f"it starts {away_m:.0f} m from the nearest other vehicle, out of the radio range of "
                f"{mission.range_m:g} m (network.range_m)",
                "vehicles that do not receive each other do not keep apart, and its way to the others is long",
                "correct its start_m (--start), or network.range_m",
            )


def _gap(mission: Mission, check: str, what: str, gap_m: float, step: str) -> Finding:
    separation_m = mission.safety.separation_m
    error_m = _distance_error_m(mission)
    grade = Grade.PASS if gap_m >= GAP_RESERVE * separation_m + error_m else Grade.WARNING
    return Finding.graded(
        Grade.REFUSE if gap_m < separation_m + error_m else grade,
        MISSION,
        check,
        f"{what}: {gap_m:.2f} m apart, needed: {separation_m:g} m separation and {error_m:.2f} m position error",
        "the guard would move setpoints permanently, or vehicles would come too close",
        step,
    )


_PATH_PLACES = 20
"""At so many places of the target's planned path the ring is bent."""
_HOMEWARD_STEP_DEG = 10
"""At so many degrees each around the ring the straight way home is checked."""


def _zones_on_the_way_home(mission: Mission) -> Iterator[Finding]:
    """Warn of no-fly zones that the autopilots cross when they return by themselves, straight from the ring."""
    if not mission.safety.no_fly:
        return
    import shapely  # noqa: PLC0415 - slow to import, and only missions with zones need it

    shapes = {each.name: shape for each in mission.safety.no_fly for shape in shapes_of((each,), 0.0)}
    for vehicle in mission.vehicles:
        above = [each.name for each in mission.safety.no_fly if (each.ceiling_m or inf) > vehicle.section.altitude_m]
        ways = shapely.MultiLineString([(place, vehicle.section.start_m) for place in _flown_places_m(mission)])
        crossed = [name for name in above if shapely.Polygon(shapes[name]).intersects(ways)]
        yield Finding.graded(
            Grade.WARNING if crossed else Grade.PASS,
            vehicle.id,
            "return by itself",
            f"straight ways from the ring to its start cross the no-fly zones {', '.join(crossed)}"
            if crossed
            else "straight ways from the ring to its start cross no no-fly zone",
            "after a lost link an autopilot that returns flies straight, at its own height, through zones",
            "let it land instead (docs/hardware.md), or set its height of return above the zones",
        )


def _zones_on_the_targets_path(mission: Mission) -> Finding | None:
    """Return a warning of a planned path on which no ring can be flown: the guard then stops the vehicles at a zone."""
    zones, target = flown_zones(mission.agent_config(mission.vehicles[0])), mission.target
    if not zones or not target.has_planned_path or target.speed_max_m_s == 0.0:
        return None
    places = even_places([each.section.gap for each in mission.vehicles])
    bender = Bender(zones, mission.encirclement, mission.safety, places)
    path = target.motion.path_m(mission.mission.duration_s, _PATH_PLACES)
    blocked_s = [
        time_s
        for time_s, centre_m in path
        if (bend := bender.bend(centre_m)) is None or not _is_reached(mission, zones, centre_m, bend)
    ]
    return Finding.graded(
        Grade.WARNING if blocked_s else Grade.PASS,
        MISSION,
        "target's path",
        f"at {len(blocked_s)} of {len(path)} places of its path, the first at {blocked_s[0]:.0f} s, no ring keeps out "
        "of the no-fly zones and inside the fence, or no way leads to it"
        if blocked_s
        else "a ring that keeps out of the no-fly zones can be flown on the whole planned path",
        "where the ring cannot bend, or no way leads to it, the vehicles stop at a zone until they can go on",
        "change the target's path, the ring, the zones or the fence",
    )


def _is_reached(mission: Mission, zones: tuple[NoFlySection, ...], centre_m: Pair, bend: RingBend) -> bool:
    """Return whether a way leads from every start to a ring about a centre."""
    on_ring = waiting_places_m(centre_m, mission.encirclement.radius_m, 0.0, bend)
    return all(
        routes_between(zones, each.section.limits(mission.safety).fence_m, ZONE_MARGIN_M).way_m(
            each.section.start_m, on_ring
        )
        for each in mission.vehicles
    )


def _flown_places_m(mission: Mission) -> list[tuple[float, float]]:
    """Return places on the rings, also where the planned motion leads their targets."""
    angles = np.radians(np.arange(0.0, 360.0, _HOMEWARD_STEP_DEG)).tolist()
    return [
        (x + alone.encirclement.radius_m * cos(angle), y + alone.encirclement.radius_m * sin(angle))
        for alone in mission.alone
        for _, (x, y) in alone.target.motion.path_m(mission.mission.duration_s, 10)
        for angle in angles
    ]


def _mission_fence(mission: Mission) -> Finding:
    bare = [str(each.id) for each in mission.vehicles if not each.section.limits(mission.safety).fence_m]
    corners = len(mission.safety.fence_m)
    own = f"safety.fence_m is empty; vehicles without one of their own: {', '.join(bare)}"
    return Finding.graded(
        Grade.WARNING if bare else Grade.PASS,
        MISSION,
        "mission fence",
        own if bare else f"safety.fence_m has {corners} corners" if corners else "every vehicle has a fence of its own",
        "vehicles follow the target wherever it is reported, also by sensors outside the team (docs/target.md)",
        "set safety.fence_m to the area of the flight",
    )


def _distance_error_m(mission: Mission) -> float:
    """Return the error of the distance between the two vehicles with the noisiest positions."""
    errors_m = sorted(map(_position_error_m, mission.vehicles))
    return SIGMAS * hypot(*errors_m[-2:])


def _position_error_m(vehicle: MissionVehicle) -> float:
    return hypot(vehicle.own_filter.position_noise_m, vehicle.own_filter.wander_m)


def encounter(mission: Mission) -> Iterator[Finding]:
    """Check that vehicles come near enough to a simulated target to engage it, and see it from the ring.

    With one ring these are all vehicles, with several as many for each as have to fly on it. A flight for
    identification has no ring.
    """
    spare = sum(ring.places for ring in mission.rings) - len(mission.vehicles)
    for number, alone in enumerate(mission.alone):
        if mission.excites or alone.target.source != "simulated":
            continue
        yield _of_ring(_sensor_range(alone), mission, number)
        if not alone.target.has_planned_path:
            continue
        if mission.rings:
            needed = max(mission.rings[number].places - spare, 1)
            yield _of_ring(_enough_reach(list(_reach(alone)), needed), mission, number)
        else:
            yield from _reach(alone)


def _enough_reach(reach: Sequence[Finding], needed: int) -> Finding:
    """Return whether so many vehicles come near enough to the target of one of several rings."""
    near = [str(each.about) for each in reach if each.grade is Grade.PASS]
    return Finding.graded(
        Grade.PASS if len(near) >= needed else Grade.WARNING,
        MISSION,
        "reach",
        f"vehicles {', '.join(near) or 'none'} come near enough to its target in formation; {needed} have to, for its "
        "places",
        "from their places in formation the others will not engage",
        f"raise decision.distance_max_m or target.sensor.range_m, or {_NEARER}",
    )


def _sensor_range(mission: Mission) -> Finding:
    ranges_m = {vehicle_id: mission.sensor(vehicle_id).range_m for vehicle_id in mission.ids}
    radius_m = mission.encirclement.radius_m
    blind = [str(vehicle_id) for vehicle_id, range_m in ranges_m.items() if range_m < radius_m]
    who = f"vehicles with a shorter range: {', '.join(blind)}" if blind else "every vehicle's range is sufficient"
    return Finding.graded(
        Grade.WARNING if blind else Grade.PASS,
        MISSION,
        "sensor range",
        f"the shortest sensor range is {min(ranges_m.values()):g} m, the ring's radius is {radius_m:g} m; {who}",
        "on the ring such a vehicle does not see the target: it depends on others' sightings, or holds",
        f"increase target.sensor.range_m to {GAP_RESERVE * radius_m:g} m, or lower encirclement.radius_m",
    )


def _reach(mission: Mission) -> Iterator[Finding]:
    """Compare each vehicle's least distance to the target, once one of the team has seen it, with its own limit."""
    limits_m = engagement_reference(mission).distance_max_m
    time_s, away_m = formation_path(mission)
    seen = np.any([away_m[each] <= mission.sensor(each).range_m for each in mission.ids], axis=0)
    if limits_m and not seen.any():
        yield Finding(
            Grade.WARNING,
            MISSION,
            "reach",
            f"no sensor sees the target: no vehicle comes nearer than {min(map(np.min, away_m.values())):.2f} m; the "
            f"longest target.sensor.range_m is {max(mission.sensor(each).range_m for each in mission.ids):g} m",
            "from its place in formation no vehicle will engage",
            f"increase target.sensor.range_m, or {_NEARER}",
        )
        return
    first = int(np.argmax(seen))
    for vehicle_id, limit_m in limits_m.items():
        nearest = first + int(np.argmin(away_m[vehicle_id][first:]))
        least_m = float(away_m[vehicle_id][nearest])
        since = f", the target being seen from {time_s[first]:.0f} s on" if first else ""
        yield Finding.graded(
            Grade.PASS if least_m < limit_m else Grade.WARNING,
            vehicle_id,
            "reach",
            f"its least distance from the target in formation is {least_m:.2f} m, at {time_s[nearest]:.0f} s{since}; "
            f"its decision.distance_max_m is {limit_m:g} m",
            "from its place in formation it will not engage",
            f"raise its decision.distance_max_m above {least_m + 0.05:.1f} m, or {_NEARER}",
        )


_NEARER = (
    "bring the formation nearer: formation.start_m, the vehicles' start_m, formation.speed_m_s, mission.duration_s"
)


def _target_speed(mission: Mission) -> Finding:
    ring, target_m_s = mission.encirclement, mission.target.speed_max_m_s
    max_m_s = ring.speed_max_m_s - _along_ring_m_s(mission)
    step_rad_s = max(RESERVE * ring.speed_max_m_s - target_m_s, 0.0) / ring.radius_m
    return Finding.graded(
        limited(ring_speed_m_s(mission), ring.speed_max_m_s, RESERVE),
        MISSION,
        "target speed",
        f"target speed {target_m_s:.2f} m/s, limit {max(max_m_s, 0.0):.2f} m/s (encirclement.speed_max_m_s = "
        f"{ring.speed_max_m_s:g} m/s, less {_along_ring_m_s(mission):.2f} m/s along the ring)",
        "a vehicle on the ring needs the sum of both speeds, and a margin",
        f"lower encirclement.angular_rate_rad_s to {step_rad_s:.2f}, or raise speed_max_m_s if the vehicles can fly it",
    )


def waiting_speeds(mission: Mission) -> Iterator[Finding]:
    """Check that a vehicle which waits for its place outside a ring can turn with it there.

    A command of the ring is not checked for this: vehicles on it have their places.
    """
    if not mission.excites:
        yield from _on_each_ring(mission, _waiting_speed)


def _waiting_speed(mission: Mission) -> Finding | None:
    ring, target_m_s = mission.encirclement, mission.target.speed_max_m_s
    if len(mission.vehicles) == 1:
        return None
    waiting_m = ring.radius_m + WAITING * mission.safety.separation_m
    needed_m_s = abs(ring.angular_rate_rad_s) * waiting_m + target_m_s
    step_rad_s = max(ring.speed_max_m_s - target_m_s, 0.0) / waiting_m
    return Finding.graded(
        Grade.WARNING if needed_m_s > ring.speed_max_m_s else Grade.PASS,
        MISSION,
        "waiting speed",
        f"vehicles that wait for their places {waiting_m:g} m from the target need {needed_m_s:.2f} m/s to turn with "
        f"the ring; encirclement.speed_max_m_s is {ring.speed_max_m_s:g} m/s",
        "one that falls behind its place there may never come in",
        f"lower encirclement.angular_rate_rad_s to {step_rad_s:.3g}, or raise speed_max_m_s if the vehicles can fly it",
    )


def _ring_acceleration(mission: Mission) -> Finding:
    needed, limit = ring_acceleration_m_s2(mission), mission.encirclement.acceleration_max_m_s2
    return Finding.graded(
        limited(needed, limit, RESERVE),
        MISSION,
        "ring acceleration",
        f"the ring needs v²/R = {needed:.2f} m/s²; encirclement.acceleration_max_m_s2 is {limit:g} m/s²",
        "with less acceleration a vehicle drifts outwards from the ring",
        f"lower encirclement.angular_rate_rad_s to {sqrt(RESERVE * limit / mission.encirclement.radius_m):.2f}, "
        "or raise acceleration_max_m_s2 if the vehicles can fly it",
    )


def _formation_speed(mission: Mission) -> Finding:
    formation = mission.formation
    return Finding.graded(
        limited(formation.speed_m_s, formation.speed_max_m_s, RESERVE),
        MISSION,
        "formation speed",
        f"the line flies at {formation.speed_m_s:.2f} m/s; formation.speed_max_m_s is {formation.speed_max_m_s:g} m/s",
        "a vehicle that is behind its slot needs a higher speed to catch up",
        "lower formation.speed_m_s, or raise speed_max_m_s if the vehicles can fly it",
    )


def _lead(mission: Mission, vehicle: MissionVehicle) -> Finding:
    """Check the setpoint lead that the plant needs: a1/a0 v along, v²/R/a0 inwards."""
    axes = (vehicle.plant.x, vehicle.plant.y)
    lead_m, speed_m_s = max(
        (hypot(axis.a1_per_s * speed_m_s, ring_acceleration_m_s2(alone)) / axis.a0_per_s2, speed_m_s)
        for alone in mission.alone
        for speed_m_s in (max(ring_speed_m_s(alone), mission.formation.speed_m_s),)
        for axis in axes
    )
    limit_m = mission.safety.setpoint_lead_max_m
    return Finding.graded(
        limited(lead_m, limit_m, RESERVE),
        vehicle.id,
        "setpoint lead",
        f"the plant needs a setpoint lead of {lead_m:.2f} m at {speed_m_s:.2f} m/s; "
        f"tuning.safety.setpoint_lead_max_m is {limit_m:g} m",
        "with a smaller setpoint lead the vehicle does not reach the speed",
        "lower the speed of ring or line, or raise tuning.safety.setpoint_lead_max_m",
    )


def _within(facts: VehicleFacts, check: str, needed: float, unit: str, names: tuple[tuple[str, float], ...]) -> Finding:
    for name, scale in names:
        value = facts.parameter(name)
        if value is not None:
            limit = value * scale
            return Finding.graded(
                limited(needed, limit, RESERVE),
                facts.vehicle_id,
                f"{check} limit",
                f"the mission needs {needed:.2f} {unit}; {name} limits the autopilot to {limit:.2f} {unit}",
                "beyond its limit the autopilot does not follow its setpoints, whatever the profile",
                f"lower the mission's {check}, or raise {name} to {needed / RESERVE / scale:.3g} or more if feasible",
            )
    either = " or ".join(name for name, _ in names)
    return Finding(
        Grade.WARNING,
        facts.vehicle_id,
        f"{check} limit",
        f"{either} could not be read: the mission needs {needed:.2f} {unit}, the limit is unknown",
        "beyond its limit the autopilot does not follow its setpoints, whatever the profile",
        f"check {either} with a ground station, and check the link",
    )
