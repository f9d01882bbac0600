"""The preflight: from a mission and what its vehicles report to graded findings."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import date

from agents.shell.computer import ComputerClock
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.computer import ComputerFacts, judge_computer
from gcs.preflight.estimator import estimator
from gcs.preflight.fence import fence_areas
from gcs.preflight.findings import Finding, Grade, VehicleFacts
from gcs.preflight.kinds import kinds
from gcs.preflight.link_budget import link_budget
from gcs.preflight.mission import autopilot_limits, feasibility
from gcs.preflight.parameters import failsafes, fence, station
from gcs.preflight.profile import profile
from gcs.preflight.senders import senders
from gcs.preflight.vehicle import (
    at_rest,
    battery,
    clock_rate,
    clock_setting,
    gps,
    health,
    identity,
    latency,
    place,
    telemetry,
    together,
)

Check = Callable[[VehicleFacts, Mission, MissionVehicle], Iterable[Finding]]

VEHICLE_CHECKS: tuple[Check, ...] = (
    lambda facts, _mission, _vehicle: identity(facts),
    lambda facts, _mission, _vehicle: senders(facts),
    lambda facts, _mission, _vehicle: at_rest(facts),
    lambda facts, _mission, _vehicle: gps(facts),
    lambda facts, _mission, _vehicle: health(facts),
    place,
    lambda facts, _mission, _vehicle: battery(facts),
    lambda facts, _mission, _vehicle: telemetry(facts),
    lambda facts, _mission, vehicle: latency(facts, vehicle),
    lambda facts, _mission, _vehicle: clock_rate(facts),
)
"""The checks of every vehicle that is received."""
AUTOPILOT_CHECKS: tuple[Check, ...] = (
    lambda facts, mission, _vehicle: estimator(facts, mission),
    lambda facts, _mission, _vehicle: failsafes(facts),
    lambda facts, _mission, _vehicle: station(facts),
    fence,
    fence_areas,
    lambda facts, mission, _vehicle: autopilot_limits(mission, facts),
)
"""The checks of every autopilot whose parameters and reports cordon supports."""
_ORDER = list(Grade)


def preflight(
    mission: Mission,
    team: Sequence[VehicleFacts],
    today: date | None = None,
    *,
    stubs: bool = False,
    bench: bool = False,
    clock: ComputerClock | None = None,
    computer: ComputerFacts | None = None,
) -> tuple[Finding, ...]:
    """Return all findings, the most severe first; raises KeyError for facts about a vehicle outside the mission.

    Without `today` no profile is too old. With `stubs` all vehicles are stubs; with `bench` they are boards in
    hardware-in-the-loop simulation, propellers off. `clock` is this computer's clock if the team is on several,
    `computer` what was measured of it for a flight on the wall's clock.
    """
    findings = [
        *feasibility(mission, stubs=stubs),
        *link_budget(mission, team),
        *kinds(team, bench=bench),
        *together(mission, team),
        *(() if clock is None else (clock_setting(clock),)),
        *(() if computer is None else judge_computer(computer)),
    ]
    for facts in team:
        findings += _of_vehicle(facts, mission, mission.vehicle(facts.vehicle_id), today)
    return tuple(sorted(findings, key=lambda finding: _ORDER.index(finding.grade)))


def worst(findings: Iterable[Finding]) -> Grade:
    """Return the most severe grade among findings."""
    return min((finding.grade for finding in findings), key=_ORDER.index, default=Grade.PASS)


def _of_vehicle(
    facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle, today: date | None
) -> Iterator[Finding]:
    if facts.unreachable is not None:
        found, step = facts.unreachable
        why = "commands would not arrive, or would reach another vehicle"
        yield Finding(Grade.REFUSE, facts.vehicle_id, "link", found, why, step)
        return
    yield Finding(
        Grade.PASS, facts.vehicle_id, "link", f"received on {vehicle.section.url} as system {vehicle.system_id}"
    )
    for check in VEHICLE_CHECKS + (AUTOPILOT_CHECKS if facts.autopilot.is_known else ()):
        yield from check(facts, mission, vehicle)
    yield from profile(facts, mission, vehicle, today)
