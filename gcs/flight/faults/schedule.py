"""The faults that a flight of stub vehicles is to have, as the command line gives them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from gcs.errors import InputError
from gcs.flight.faults.catalogue import Fault, required_fault
from gcs.mission.mission import Mission

_FORM = re.compile(r"(?P<fault>[^@]+)@(?P<time>\d+(\.\d+)?)(:(?P<vehicle>\d+))?")


@dataclass(frozen=True, slots=True)
class ScheduledFault:
    """A fault at a time of the mission [mission s], as it was given; without a vehicle in the last one in line."""

    given: str
    fault: Fault
    at_s: float
    vehicle: int | None


def scheduled_faults(
    given: Sequence[str], mission: Mission, duration_s: float, stubs: Sequence[int]
) -> tuple[ScheduledFault, ...]:
    """Return the faults of texts such as `link-cut@120:2`, by their times; raises InputError with all problems.

    Only the vehicles with the ids `stubs` can have any.
    """
    faults, problems = [], list[str]()
    for text in given:
        try:
            faults.append(_scheduled(text, mission, duration_s, stubs))
        except InputError as error:
            problems += error.faults
    if problems:
        raise InputError(problems)
    return tuple(sorted(faults, key=lambda each: each.at_s))


def _scheduled(text: str, mission: Mission, duration_s: float, stubs: Sequence[int]) -> ScheduledFault:
    form = _FORM.fullmatch(text)
    if form is None:
        raise InputError([f"--fault: {text!r} is not NAME@SECONDS or NAME@SECONDS:VEHICLE, such as link-cut@120:2"])
    fault, at_s = required_fault(form["fault"]), float(form["time"])
    vehicle = None if form["vehicle"] is None else int(form["vehicle"])
    problem = _problem(fault, at_s, vehicle, mission, duration_s) or _no_stub(fault, vehicle, mission, stubs)
    if problem:
        raise InputError([f"--fault: {text!r}: {problem}"])
    return ScheduledFault(text, fault, at_s, vehicle)


def _problem(fault: Fault, at_s: float, vehicle: int | None, mission: Mission, duration_s: float) -> str:
    """Return why a mission cannot have a fault at a time, empty if it can."""
    if at_s >= duration_s:
        return f"the mission is over after {duration_s:g} s"
    if len(mission.ids) < fault.vehicles_min:
        return f"it takes {fault.vehicles_min} vehicles (the mission has {len(mission.ids)})"
    if vehicle is not None and fault.of_team:
        return f"{fault.option} concerns the whole team: leave out :{vehicle}"
    if vehicle is not None and vehicle not in mission.ids:
        return f"the mission has no vehicle {vehicle} (it has {', '.join(map(str, mission.ids))})"
    return ""


def _no_stub(fault: Fault, vehicle: int | None, mission: Mission, stubs: Sequence[int]) -> str:
    """Return why a fault may hit a vehicle that is no stub, empty if it hits stubs only."""
    others = [each for each in mission.ids if each not in stubs]
    if not others or vehicle in stubs:
        return ""
    known = ", ".join(map(str, stubs))
    if fault.of_team:
        return f"{fault.option} concerns the whole team, and only {known} are stubs"
    if vehicle is None:
        return f"name one of the stubs ({known}), such as {fault.option}@10:{stubs[0]}"
    return f"vehicle {vehicle} is no stub (stubs: {known}): no fault is injected into it"
