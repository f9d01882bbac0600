"""Whether a team can fly the values that operators command of a ring, before they are sent."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf

import msgspec

from agents.ring.commanded_ring import RingBounds, ring_bounds, ring_refusal
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings
from agents.team.messages import MISSION_RING, CommandedRing, RingValues
from gcs.errors import KeyFault
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.validation import validated
from gcs.preflight.findings import Grade
from gcs.preflight.mission import commanded_ring_bounds, feasibility, ring_change_faults


def bounds_of_ring(mission: Mission, number: int) -> RingBounds:
    """Return the bounds of what can be commanded of a ring, with room for the vehicles that it has places for."""
    bounds = commanded_ring_bounds(mission.of_ring(number))
    if not mission.rings:
        return bounds
    of_places = (ring_bounds(_on_ring(mission, each, number)) for each in mission.vehicles)
    return msgspec.structs.replace(bounds, radius_min_m=max(each.radius_min_m for each in of_places))


def ring_faults(
    mission: Mission, number: int, values: RingValues, commanded: CommandedRing = MISSION_RING
) -> list[str]:
    """Return why a team must not be commanded to other values of a ring.

    A value that the command leaves out is the one `commanded` before, or else the mission's.
    """
    if not mission.rings:
        return ring_change_faults(mission, values, commanded)
    faults = list[KeyFault]()
    wanted = {key: value for key, (value, _) in zip(RingValues.__struct_fields__, commanded.dated, strict=True)}
    wanted |= {key: value for key, value in msgspec.structs.asdict(values).items() if value is not None}
    changes = {key: value for key, value in wanted.items() if value is not None}
    planned = mission.rings[number]
    content = planned.encirclement.model_dump(exclude_unset=True) | changes
    settings = validated(EncirclementSettings, content, f"ring '{planned.name}'", faults)
    if settings is None:
        return list(map(str, faults))
    return list(_faults(mission, number, settings))


def _faults(mission: Mission, number: int, settings: EncirclementSettings) -> Iterator[str]:
    ring, bounds = mission.rings[number], bounds_of_ring(mission, number)
    radius_m, rate_rad_s = settings.radius_m, abs(settings.angular_rate_rad_s)
    if not bounds.radius_min_m < radius_m <= bounds.radius_max_m:
        between = f"more than {bounds.radius_min_m:.1f} m, at most {bounds.radius_max_m:g} m"
        yield f"ring '{ring.name}': a radius of {radius_m:g} m: {between}"
    elif rate_rad_s > (most_rad_s := bounds.rate_max_rad_s(radius_m)):
        yield f"ring '{ring.name}': {rate_rad_s:g} rad/s at {radius_m:g} m: at most {most_rad_s:.3f} rad/s"
    else:
        configs = (_on_ring(mission, each, number) for each in mission.vehicles)
        refusals = (ring_refusal(replace(each, encirclement=settings), inf) for each in configs)
        yield from dict.fromkeys(f"ring '{ring.name}': {refusal}" for refusal in refusals if refusal)
    before = _full(mission, number)
    grades = {found.check: found.grade for found in feasibility(before)}
    for found in feasibility(replace(before, encirclement=settings)):
        if grades.get(found.check) is Grade.PASS is not found.grade:
            yield f"{found.check}: {found.found}; {found.why}; next: {found.next_step}"


def _full(mission: Mission, number: int) -> Mission:
    """Return the mission of one ring, with as many vehicles as it has places, among them the formation's leader."""
    leads = sorted(mission.vehicles, key=lambda each: each.id != mission.formation.leader)
    kept = [each.id for each in leads[: mission.rings[number].places]]
    return replace(mission.of_ring(number), vehicles=tuple(each for each in mission.vehicles if each.id in kept))


def _on_ring(mission: Mission, vehicle: MissionVehicle, number: int) -> AgentConfig:
    """Return a vehicle's configuration on a full ring."""
    config = mission.agent_config(vehicle).on_ring(number)
    others = [each for each in config.slots if each != vehicle.id]
    return replace(config, slots=(vehicle.id, *others[: config.places - 1]))
