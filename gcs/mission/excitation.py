"""From a mission to the excitation flight that identifies one of its vehicles, with a box as its fence."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import dist

from agents.control.excitation import APPROACH_SHARE, programme
from agents.safety.fence import Fence
from agents.settings.sections import ExcitationSettings
from gcs.errors import KeyFault
from gcs.mission.mission import Mission, MissionVehicle

ACCELERATION_NOISE_M_S2 = 1.0
"""Replaces the profile's value: the flight must not depend on a plant, so the filter follows the measurements."""
PLACE_TOLERANCE_M = 2.0
"""Tolerated distance of a vehicle from its start in the mission file."""
UNSEEN_M = 1e-3
"""Sensor range of the target, which this flight does not use."""
SAMPLES_PER_PERIOD = 5.0
_EDGE_STEP_M = 0.25

Place = tuple[float, float]


def box_m(settings: ExcitationSettings, start_m: Place) -> tuple[Place, ...]:
    """Return the corners of the box in which a vehicle is excited."""
    x, y = start_m[0] + settings.offset_m[0], start_m[1] + settings.offset_m[1]
    half = settings.half_width_m
    return (x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)


def limits_rise(excitation: ExcitationSettings | None) -> Iterator[KeyFault]:
    """Return the settings that contradict each other."""
    if excitation is None:
        return
    for low, high in (("level_shortest_s", "level_longest_s"), ("sweep_from_hz", "sweep_to_hz")):
        least, most = getattr(excitation, low), getattr(excitation, high)
        if most <= least:
            yield KeyFault(f"excitation.{high}", f"{most:g} must be more than {low} = {least:g}")


def excitation_faults(mission: Mission, vehicle: MissionVehicle) -> Iterator[KeyFault]:
    """Return why a vehicle cannot be excited in the mission's box at the mission's speed."""
    settings, safety = mission.excitation, vehicle.section.limits(mission.safety)
    if settings.speed_max_m_s > safety.speed_max_m_s:
        yield KeyFault(
            "excitation.speed_max_m_s",
            f"{settings.speed_max_m_s:g} m/s is more than safety.speed_max_m_s = {safety.speed_max_m_s:g} m/s",
        )
    if settings.sweep_to_hz * SAMPLES_PER_PERIOD > mission.mission.rate_hz:
        yield KeyFault(
            "excitation.sweep_to_hz",
            f"{settings.sweep_to_hz:g} Hz is too fast for mission.rate_hz = "
            f"{mission.mission.rate_hz:g} Hz: a period takes {SAMPLES_PER_PERIOD:g} setpoints or more",
        )
    start_m = vehicle.section.start_m
    space = hull((start_m, *box_m(settings, start_m)))
    if safety.fence_m:
        fence = Fence(safety.fence_m)
        whose = "safety" if vehicle.section.fence_m is None else f"vehicles[{mission.vehicles.index(vehicle)}]"
        room_m, (x, y) = min((fence.clearance_m(place), place) for place in _along(space))
        if room_m < 0.0:
            yield KeyFault(
                "excitation.half_width_m",
                f"the box and the way there are {-room_m:.2f} m outside of {whose}.fence_m at "
                + (f"({x:.1f}, {y:.1f}): move it by excitation.offset_m, or make it smaller"),
            )
    for other in mission.vehicles:
        away_m = -Fence(space).clearance_m(other.section.start_m)
        if other is not vehicle and away_m < safety.separation_m:
            where = f"{away_m:.2f} m from" if away_m > 0.0 else "in"
            yield KeyFault(
                "excitation.offset_m",
                f"vehicle {other.id} starts {where} the box of vehicle {vehicle.id} or the way "
                f"there, less than safety.separation_m = {safety.separation_m:g} m away: move the box by "
                "excitation.offset_m, or make it smaller by half_width_m",
            )


def excited(mission: Mission, vehicle: MissionVehicle) -> Mission:
    """Return the excitation flight of one vehicle, alone; its fence is the box and the way to it."""
    settings, start_m = mission.excitation, vehicle.section.start_m
    safety = vehicle.section.limits(mission.safety)
    room_m = Fence(safety.fence_m).clearance_m(start_m) if safety.fence_m else PLACE_TOLERANCE_M
    beside = min(PLACE_TOLERANCE_M, room_m)
    about_start = [(start_m[0] + x, start_m[1] + y) for x in (-beside, beside) for y in (-beside, beside)]
    formation = mission.formation
    slowly = {"speed_max_m_s": min(formation.speed_max_m_s, APPROACH_SHARE * settings.speed_max_m_s)}
    noise = {"acceleration_noise_m_s2": max(vehicle.own_filter.acceleration_noise_m_s2, ACCELERATION_NOISE_M_S2)}
    section = vehicle.section.model_copy(update={"fence_m": None})
    vehicle = replace(vehicle, section=section, own_filter=vehicle.own_filter.model_copy(update=noise))
    limits = {
        "fence_m": hull((*about_start, *box_m(settings, start_m))),
        "speed_max_m_s": settings.speed_max_m_s,
        "guard": True,
        "keep_out_m": 0.0,
    }
    unseen = mission.target.sensor.model_copy(update={"range_m": UNSEEN_M})
    alone = replace(
        mission,
        target=mission.target.model_copy(update={"sensor": unseen}),
        formation=formation.model_copy(update={**slowly, "leader": vehicle.id, "start_m": None}),
        safety=mission.safety.model_copy(update=limits),
        choreography=mission.choreography.model_copy(update={"layer_m": 0.0, "landing_order": ()}),
        vehicles=(vehicle,),
        excites=True,
        targets=(),
        rings=(),
    )
    duration_s = programme(alone.agent_config(vehicle)).duration_s
    return replace(alone, mission=alone.mission.model_copy(update={"duration_s": duration_s}))


def hull(places: Sequence[Place]) -> tuple[Place, ...]:
    """Return the corners of the smallest convex polygon around places, counter-clockwise."""
    ordered = sorted(set(places))
    return (*_chain(ordered)[:-1], *_chain(ordered[::-1])[:-1])


def _chain(places: Sequence[Place]) -> list[Place]:
    """Return the right half of a hull, from the first place to the last."""
    chain: list[Place] = []
    for x, y in places:
        while len(chain) > 1:
            (x1, y1), (x2, y2) = chain[-2:]
            if (x2 - x1) * (y - y1) - (y2 - y1) * (x - x1) > 0.0:
                break
            chain.pop()
        chain.append((x, y))
    return chain


def _along(corners: Sequence[Place]) -> Iterator[Place]:
    """Return places all around a polygon."""
    for (x1, y1), (x2, y2) in zip(corners, (*corners[1:], corners[0]), strict=True):
        count = int(dist((x1, y1), (x2, y2)) / _EDGE_STEP_M) + 1
        yield from ((x1 + (x2 - x1) * k / count, y1 + (y2 - y1) * k / count) for k in range(count))
