"""The faults of a flight of stub vehicles, from the command line."""

from collections.abc import Sequence
from dataclasses import dataclass

from gcs.errors import InputError
from gcs.flight.faults.catalogue import Fault, required_fault
from gcs.metrics.record import InjectedFault
from gcs.mission.mission import Mission


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault to inject, and when and into which vehicle; without one it hits the last one in line."""

    fault: Fault
    injected: InjectedFault


def scheduled_faults(
    given: Sequence[str], mission: Mission, duration_s: float, stubs: Sequence[int]
) -> tuple[ScheduledFault, ...]:
    """Return the faults of texts such as `link-cut@120:2` in order of time; raises InputError with all problems.

    Faults are injected only into the vehicles with the ids `stubs`.
    """
    faults, problems = [], list[str]()
    for text in given:
        try:
            faults.append(_scheduled(text, mission, duration_s, stubs))
        except InputError as error:
            problems += error.faults
    if problems:
        raise InputError(problems)
    return tuple(sorted(faults, key=lambda each: each.injected.at_s))


def _scheduled(text: str, mission: Mission, duration_s: float, stubs: Sequence[int]) -> ScheduledFault:
    injected = InjectedFault.of(text)
    if injected is None:
        raise InputError([f"--fault: {text!r} is not NAME@SECONDS or NAME@SECONDS:VEHICLE, for example link-cut@120:2"])
    fault, vehicle = required_fault(injected.name), injected.vehicle
    problem = _problem(fault, injected.at_s, vehicle, mission, duration_s) or _no_stub(fault, vehicle, mission, stubs)
    if problem:
        raise InputError([f"--fault: {text!r}: {problem}"])
    return ScheduledFault(fault, injected)


def _problem(fault: Fault, at_s: float, vehicle: int | None, mission: Mission, duration_s: float) -> str:
    """Return why a mission cannot have a fault at a time, empty if it can."""
    if at_s >= duration_s:
        return f"the mission is over after {duration_s:g} s"
    if len(mission.ids) < fault.vehicles_min:
        return f"it needs {fault.vehicles_min} vehicles (the mission has {len(mission.ids)})"
    if vehicle is not None and fault.of_team:
        return f"{fault.option} affects the whole team: omit :{vehicle}"
    if vehicle is not None and vehicle not in mission.ids:
        return f"the mission has no vehicle {vehicle} (it has {', '.join(map(str, mission.ids))})"
    return ""


def _no_stub(fault: Fault, vehicle: int | None, mission: Mission, stubs: Sequence[int]) -> str:
    """Return why a fault would affect a vehicle that is not a stub, empty if it affects stubs only."""
    others = [each for each in mission.ids if each not in stubs]
    if not others or vehicle in stubs:
        return ""
    known = ", ".join(map(str, stubs))
    if fault.of_team:
        return f"{fault.option} affects the whole team, and only vehicles {known} are stubs"
    if vehicle is None:
        return f"name one of the stubs ({known}), for example {fault.option}@10:{stubs[0]}"
    return f"vehicle {vehicle} is not a stub (stubs: {known}): faults are injected into stubs only"
