"""What becomes of each vehicle when a team that is in the air is brought home, and the findings that say why."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from math import hypot

from agents.ports import FlightMode
from estimation.frames import Triple
from gcs.autopilots.registry import autopilot_of
from gcs.mission.excitation import PLACE_TOLERANCE_M
from gcs.mission.geometry import areas
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade, VehicleFacts
from gcs.preflight.vehicle import BATTERY_LOW

FAR_M = 1000.0
"""A vehicle farther from its start than this flies somewhere else, or its positions are wrong."""
_OF_AUTOPILOTS = (FlightMode.HOLD, FlightMode.OFFBOARD, FlightMode.LAND, FlightMode.RETURN, FlightMode.TAKE_OFF)
"""Modes in which no pilot steers: those that cordon or an autopilot's failsafe leaves behind, and take-off's."""


class Treatment(Enum):
    """What is done with a vehicle."""

    TAKE = "bring home"
    ACCOMPANY = "leave to its pilot"
    """The others keep apart from it."""
    LEAVE = "leave alone"


@dataclass(frozen=True, slots=True)
class Standing:
    """What is done with a vehicle, and why; with a refusal nothing is sent to any vehicle."""

    vehicle_id: int
    treatment: Treatment
    finding: Finding


def standings(mission: Mission, team: Sequence[VehicleFacts], from_pilot: Collection[int]) -> tuple[Standing, ...]:
    """Return what is done with each vehicle.

    Those `from_pilot` are to be taken although a pilot may fly them.
    """
    return tuple(_standing(facts, mission, taken=facts.vehicle_id in from_pilot) for facts in team)


def _standing(facts: VehicleFacts, mission: Mission, *, taken: bool) -> Standing:
    if facts.unreachable is not None:
        return _not_received(facts.vehicle_id, *facts.unreachable, silent=facts.silent)
    if not facts.status.armed:
        return _on_ground(facts, mission)
    refusal = next(_refusals(facts, mission), None)
    return _in_the_air(facts, mission, taken=taken) if refusal is None else refusal


def _refused(vehicle_id: int, check: str, found: str, why: str, step: str) -> Standing:
    step = f"{step}, or leave it out by --leave {vehicle_id}"
    return Standing(vehicle_id, Treatment.LEAVE, Finding(Grade.REFUSE, vehicle_id, check, found, why, step))


def _not_received(vehicle_id: int, found: str, step: str, *, silent: bool) -> Standing:
    if not silent:
        return _refused(vehicle_id, "link", found, "commands would reach another vehicle, or none", step)
    why = "it may be in the air: nothing is sent to it, and the others do not know where it is"
    step = "look for it, and take it by remote control; once it is received, run this again"
    finding = Finding(Grade.WARNING, vehicle_id, "link", f"it is not received: {found}", why, step)
    return Standing(vehicle_id, Treatment.LEAVE, finding)


def _on_ground(facts: VehicleFacts, mission: Mission) -> Standing:
    i, place_m = facts.vehicle_id, facts.position_m
    if place_m is not None and not facts.status.in_air and _away_m(mission, i, place_m) <= PLACE_TOLERANCE_M:
        return Standing(i, Treatment.LEAVE, Finding(Grade.PASS, i, "on the ground", "it is disarmed, near its start"))
    where = "at an unknown place" if place_m is None else _where(mission, i, place_m)
    why, step = "away from its start it has landed by itself, or fallen", "recover and inspect it"
    finding = Finding(Grade.WARNING, i, "on the ground", f"it is disarmed, {where}", why, step)
    return Standing(i, Treatment.LEAVE, finding)


def _refusals(facts: VehicleFacts, mission: Mission) -> Iterator[Standing]:
    """Yield why an armed vehicle must not be taken."""
    i, place_m = facts.vehicle_id, facts.position_m
    if not facts.status.in_air:
        why = "its motors may start to turn, and it is not in the air"
        yield _refused(i, "armed", "it is armed on the ground", why, "disarm it")
    expected = autopilot_of(mission.vehicle(i).autopilot)
    if facts.autopilot.name != expected.name or not facts.multicopter:
        kind = facts.autopilot.label + ("" if facts.multicopter else ", and it is no multicopter")
        why = f"its profile is that of a multicopter with {expected.label}: it may be another vehicle"
        yield _refused(i, "autopilot", f"its autopilot is {kind}", why, "check its url and its system id")
    if place_m is None:
        found, _ = facts.lost or ("it sends no position", "")
        why = "without a position it cannot be flown home, nor the others kept apart from it"
        yield _refused(i, "position", found, why, "land it by remote control")
    elif _away_m(mission, i, place_m) > FAR_M:
        why = f"more than {FAR_M:g} m from its start it is another flight's, or its position is wrong"
        yield _refused(i, "position", f"it is {_where(mission, i, place_m)}", why, "check the mission and [frame]")


def _in_the_air(facts: VehicleFacts, mission: Mission, *, taken: bool) -> Standing:
    i, place_m, status = facts.vehicle_id, facts.position_m, facts.status
    assert place_m is not None
    mode = status.mode if facts.mode_received else FlightMode.UNKNOWN
    battery = "unknown" if status.battery is None else f"{status.battery:.0%}"
    found = f"it is in the air in mode {mode.value}, {_where(mission, i, place_m)}; battery {battery}"
    if mode not in _OF_AUTOPILOTS:
        why = "in this mode its pilot or another ground station steers it"
        step = "tell its pilot first" if taken else f"let its pilot land it, or take it by --take-from-pilot {i}"
        found += ": it is taken" if taken else ": it keeps its pilot, and the others keep apart from it"
        finding = Finding(Grade.WARNING, i, "pilot", found, why, step)
        return Standing(i, Treatment.TAKE if taken else Treatment.ACCOMPANY, finding)
    area = areas([mission.vehicle(i).section], mission.safety).get(i)
    if area is not None and (zone := area.entered(place_m[:2], place_m[2])) is not None:
        why = "the guard leads it out of the zone first, straight to the nearest place"
        finding = Finding(Grade.WARNING, i, "no-fly zone", f"{found}; it is in '{zone.name}'", why, "watch its way")
        return Standing(i, Treatment.TAKE, finding)
    if area is not None and area.fence is not None and not area.fence.contains(place_m[:2]):
        why = "outside its fence the guard leads it back inside first, straight to the nearest place"
        finding = Finding(Grade.WARNING, i, "fence", f"{found}; it is outside its fence", why, "watch its way")
        return Standing(i, Treatment.TAKE, finding)
    low = status.battery is None or status.battery < BATTERY_LOW
    why, step = "its way home takes time, and it lands in its turn", "land it where it is by --land, if that is nearer"
    finding = Finding.graded(Grade.WARNING if low else Grade.PASS, i, "in the air", found, why, step)
    return Standing(i, Treatment.TAKE, finding)


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
