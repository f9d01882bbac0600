"""Preflight checks of the autopilot's parameters: failsafes, geofence, limits. Parameters are read, never written."""

from collections.abc import Iterator

from gcs.autopilots.autopilot import CORDON_ID, MOTORS_STOP, FenceLimits
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import Finding, Grade, VehicleFacts
from gcs.preflight.mission import extent_m, highest_m

WITHOUT_SETPOINTS = "it determines the reaction to a loss of cordon or of the link"


def failsafes(facts: VehicleFacts) -> Iterator[Finding]:
    """Check the autopilot's reaction to lost setpoints and links."""
    for name, judge in facts.autopilot.judges.items():
        value = facts.parameter(name)
        if value is None:
            yield _unread(facts, name, WITHOUT_SETPOINTS)
        else:
            grade, meaning, why, step = judge(value)
            yield Finding(Grade(grade), facts.vehicle_id, name, f"{name} = {value:g}: {meaning}", why, step)


def station(facts: VehicleFacts) -> Iterator[Finding]:
    """Check that a ground station failsafe that monitors one system id monitors cordon's."""
    ids = facts.autopilot.station_ids
    if not ids or facts.parameter(facts.autopilot.station_failsafe) == 0.0:
        return
    value = facts.parameter(*ids)
    if value is None:
        yield _unread(facts, " or ".join(ids), WITHOUT_SETPOINTS)
        return
    name = next(name for name in ids if facts.parameter(name) is not None)
    yield Finding.graded(
        Grade.PASS if int(value) == CORDON_ID else Grade.WARNING,
        facts.vehicle_id,
        "ground station id",
        f"{name} = {value:g}: the ground station failsafe monitors system {value:g}; cordon is system {CORDON_ID}",
        "a failsafe that monitors another ground station does not act on a loss of cordon or its link",
        f"set {name} = {CORDON_ID}",
    )


def fence(facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle) -> Iterator[Finding]:
    """Check that the autopilot's geofence contains the mission and does not terminate the flight."""
    names = facts.autopilot.fence_parameters
    missing = [name for name in names if facts.parameter(name) is None]
    yield from (
        _unread(facts, name, "a fence that is smaller than the mission ends the mission in flight") for name in missing
    )
    if missing:
        return
    across, up, _, terminates = fence_limits(facts)
    if across is None and up is None:
        yield Finding(Grade.PASS, facts.vehicle_id, "fence", "the autopilot's fence is off or takes no action")
        return
    if terminates:
        found, step = terminates
        yield Finding(Grade.REFUSE, facts.vehicle_id, "fence", found, MOTORS_STOP, step)
    reaches = ((across, extent_m(mission, vehicle), "from home"), (up, highest_m(mission, vehicle), "above home"))
    for limit, needed_m, where in reaches:
        if limit is not None:
            yield _room(facts, *limit, needed_m, where)


def fence_limits(facts: VehicleFacts) -> FenceLimits:
    """Return the autopilot's fence in force; a parameter that could not be read counts as 0."""
    return facts.autopilot.fence({name: facts.parameter(name) or 0.0 for name in facts.autopilot.fence_parameters})


def _room(facts: VehicleFacts, name: str, limit_m: float, needed_m: float, where: str) -> Finding:
    return Finding.graded(
        Grade.WARNING if needed_m > limit_m else Grade.PASS,
        facts.vehicle_id,
        "fence",
        f"the mission reaches {needed_m:.0f} m {where}; the fence {name} is at {limit_m:g} m",
        "the autopilot ends the mission at its fence, regardless of the other vehicles",
        f"raise {name} above {needed_m:.0f} m, or shorten the mission",
    )


def _unread(facts: VehicleFacts, name: str, why: str) -> Finding:
    step = f"check {name} with a ground station, and check the link"
    return Finding(Grade.WARNING, facts.vehicle_id, name, f"{name} could not be read", why, step)
