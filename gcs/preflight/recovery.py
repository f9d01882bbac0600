"""What becomes of each vehicle when a team that is in the air is brought home, and the findings that say why."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot

from agents.ports import FlightMode
from estimation.frames import Triple
from gcs.autopilots.registry import autopilot_of
from gcs.mission.geometry import fences
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade, VehicleFacts
from gcs.preflight.vehicle import BATTERY_LOW, PLACE_LIMIT_M

FAR_M = 1000.0
"""A vehicle farther from its start than this flies somewhere else, or its positions are wrong."""
_OF_AUTOPILOTS = (FlightMode.HOLD, FlightMode.OFFBOARD, FlightMode.LAND, FlightMode.RETURN, FlightMode.TAKE_OFF)
"""Modes in which no pilot steers: those that cordon or an autopilot's failsafe leaves behind, and take-off's."""
_LEAVE_IT = "or leave it out by --leave {}"


class Part(Enum):
    """What is done with a vehicle."""

    TAKE = "bring home"
    ACCOMPANY = "leave to its pilot"
    """The others keep apart from it."""
    LEAVE = "leave alone"


@dataclass(frozen=True, slots=True)
class Standing:
    """What is done with a vehicle, and why; with a refusal nothing is sent to any vehicle."""

    vehicle_id: int
    part: Part
    finding: Finding


def standings(
    mission: Mission, team: Sequence[VehicleFacts], missing: Collection[int], from_pilot: Collection[int]
) -> tuple[Standing, ...]:
    """Return what is done with each vehicle.

    `missing` are those of which nothing is received, `from_pilot` those to be taken although a pilot may fly them.
    """
    return tuple(
        _standing(facts, mission, missing=facts.vehicle_id in missing, taken=facts.vehicle_id in from_pilot)
        for facts in team
    )


def _standing(facts: VehicleFacts, mission: Mission, *, missing: bool, taken: bool) -> Standing:
    vehicle_id = facts.vehicle_id

    def standing(
        part: Part, grade: Grade, check: str, found: str, why: str = "", step: str = "", *, temporary: bool = False
    ) -> Standing:
        finding = Finding.graded(grade, vehicle_id, check, found, why, step, temporary=temporary)
        return Standing(vehicle_id, part, finding)

    def refused(check: str, found: str, why: str, step: str) -> Standing:
        step = f"{step}, {_LEAVE_IT.format(vehicle_id)}"
        return standing(Part.LEAVE, Grade.REFUSE, check, found, why, step)

    if facts.unreachable is not None:
        found, step = facts.unreachable
        if missing:
            why = "it may be in the air: nothing is sent to it, and the others do not know where it is"
            step = "look for it, and take it by remote control; once it is received, run this again"
            return standing(Part.LEAVE, Grade.WARNING, "link", f"it is not received: {found}", why, step)
        return refused("link", found, "commands would reach another vehicle, or none", step)
    status, place_m = facts.status, facts.position_m
    if not status.armed:
        return _on_ground(standing, facts, mission)
    if not status.in_air:
        why = "its motors may start to turn, and it is not in the air"
        return refused("armed", "it is armed on the ground", why, "disarm it")
    expected = autopilot_of(mission.vehicle(vehicle_id).autopilot)
    if facts.autopilot.name != expected.name or not facts.multicopter:
        kind = facts.autopilot.label if facts.multicopter else f"{facts.autopilot.label}, and it is no multicopter"
        why = f"its profile is one of a multicopter with {expected.label}: it may be another vehicle"
        return refused("autopilot", f"its autopilot is {kind}", why, "check its url and its system id")
    if place_m is None:
        found, _ = facts.lost or ("it sends no position", "")
        why = "without a position it cannot be flown home, nor the others kept apart from it"
        return refused("position", found, why, "land it by remote control")
    where, away_m = _where(mission, vehicle_id, place_m), _away_m(mission, vehicle_id, place_m)
    if away_m > FAR_M:
        why = f"more than {FAR_M:g} m from its start it is another flight's, or its position is wrong"
        return refused("position", f"it is {where}", why, "check the mission and [frame]")
    mode = status.mode if facts.mode_received else FlightMode.UNKNOWN
    if mode not in _OF_AUTOPILOTS:
        found = f"its flight mode is {mode.value}, {where}"
        why = "in this mode its pilot or another ground station steers it"
        if not taken:
            step = f"let its pilot land it, or take it by --take-from-pilot {vehicle_id}"
            return standing(Part.ACCOMPANY, Grade.WARNING, "pilot", found, why, step)
        return standing(Part.TAKE, Grade.WARNING, "pilot", f"{found}: it is taken", why, "tell its pilot first")
    battery = "unknown" if status.battery is None else f"{status.battery:.0%}"
    found = f"it is in {mode.value}, {where}; battery {battery}"
    fence = fences([mission.vehicle(vehicle_id).section], mission.safety).get(vehicle_id)
    if fence is not None and not fence.contains(place_m[:2]):
        why = "outside its fence the guard first leads it back inside, straight to the nearest place"
        return standing(Part.TAKE, Grade.WARNING, "fence", f"{found}, outside its fence", why, "watch its way")
    low = status.battery is None or status.battery < BATTERY_LOW
    why = "its way home takes time, and it lands in its turn"
    step = "add --land to land each where it is, if that is nearer"
    return standing(Part.TAKE, Grade.WARNING if low else Grade.PASS, "in the air", found, why, step)


def _on_ground(standing: Callable[..., Standing], facts: VehicleFacts, mission: Mission) -> Standing:
    vehicle_id, place_m = facts.vehicle_id, facts.position_m
    if place_m is not None and not facts.status.in_air and _away_m(mission, vehicle_id, place_m) <= PLACE_LIMIT_M:
        return standing(Part.LEAVE, Grade.PASS, "on the ground", "it is disarmed, near its start")
    where = "at an unknown place" if place_m is None else _where(mission, vehicle_id, place_m)
    why = "away from its start it has landed by itself, or fallen"
    return standing(Part.LEAVE, Grade.WARNING, "on the ground", f"it is disarmed, {where}", why, "recover and inspect it")


def _away_m(mission: Mission, vehicle_id: int, place_m: Triple) -> float:
    x, y = mission.vehicle(vehicle_id).section.start_m
    return hypot(place_m[0] - x, place_m[1] - y)


def _where(mission: Mission, vehicle_id: int, place_m: Triple) -> str:
    away_m, frame = _away_m(mission, vehicle_id, place_m), mission.mission_frame()
    x, y, z = place_m
    at = f"x {x:.1f} m, y {y:.1f} m"
    if not frame.is_local:
        place = frame.geodetic_from_mission(place_m)
        at = f"{place.latitude_deg:.6f}, {place.longitude_deg:.6f}"
    return f"{away_m:.1f} m from its start, at {at}, height {z:.1f} m"
