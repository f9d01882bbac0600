"""The preflight: from a mission and what its vehicles report to graded findings, as a table and as JSON."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import date

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from agents.shell.computer import ComputerClock
from gcs.errors import Exit
from gcs.metrics.json_output import json_output
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.areas import areas_compared, rally_compared
from gcs.preflight.computer import ComputerFacts, judge_computer
from gcs.preflight.findings import MISSION, Finding, Grade, Subject, VehicleFacts, subjects_text
from gcs.preflight.keys import KeyFacts, keys
from gcs.preflight.mission import autopilot_limits, feasibility, link_budget, losses, waiting_speeds
from gcs.preflight.parameters import estimator, failsafes, fence, fence_areas, kinds, profile, station
from gcs.preflight.senders import senders
from gcs.preflight.terrain import terrain
from gcs.preflight.vehicle import (
    at_rest,
    battery,
    camera,
    clock_rate,
    clock_setting,
    elsewhere,
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
    losses,
    lambda facts, _mission, _vehicle: clock_rate(facts),
    lambda facts, _mission, vehicle: camera(facts, vehicle),
)
"""The checks of every vehicle that is received."""
AUTOPILOT_CHECKS: tuple[Check, ...] = (
    lambda facts, mission, _vehicle: estimator(facts, mission),
    lambda facts, _mission, _vehicle: failsafes(facts),
    lambda facts, _mission, _vehicle: station(facts),
    fence,
    fence_areas,
    areas_compared,
    rally_compared,
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
    key_facts: KeyFacts | None = None,
    feasible: Iterable[Finding] | None = None,
) -> tuple[Finding, ...]:
    """Return all findings, the most severe first; raises KeyError for facts about a vehicle outside the mission.

    Without `today` no profile is too old. With `stubs` all vehicles are stubs; with `bench` they are boards in
    hardware-in-the-loop simulation, propellers off. `clock` is this computer's clock if the team is on several,
    `computer` what was measured of it for a flight on the wall's clock. `key_facts` are those of a bus with keys.
    `feasible` are the findings of `feasibility` if it was called before.
    """
    away, team = elsewhere(mission, team)
    findings = [
        *away,
        *(feasibility(mission, stubs=stubs) if feasible is None else feasible),
        *waiting_speeds(mission),
        *link_budget(mission, team),
        *terrain(mission),
        *kinds(team, bench=bench),
        *together(mission, team),
        *(() if clock is None else (clock_setting(clock),)),
        *(() if computer is None else judge_computer(computer)),
        *(() if key_facts is None else keys(mission, key_facts)),
    ]
    for facts in team:
        findings += _of_vehicle(facts, mission, mission.vehicle(facts.vehicle_id), today)
    return _ordered(findings)


def vehicle_findings(mission: Mission, facts: VehicleFacts, today: date | None = None) -> tuple[Finding, ...]:
    """Return the findings about one vehicle whose team is in the air; ordered, and raises, as `preflight`."""
    return _ordered(_of_vehicle(facts, mission, mission.vehicle(facts.vehicle_id), today))


def _ordered(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    return tuple(sorted(findings, key=lambda finding: _ORDER.index(finding.grade)))


def worst(findings: Iterable[Finding]) -> Grade:
    """Return the most severe grade among findings."""
    return min((finding.grade for finding in findings), key=_ORDER.index, default=Grade.PASS)


def _of_vehicle(
    facts: VehicleFacts, mission: Mission, vehicle: MissionVehicle, today: date | None
) -> Iterator[Finding]:
    if facts.unreachable is not None:
        found, step = facts.unreachable
        if facts.silent and vehicle.section.reserve:
            why, step = "it cannot take over yet", "switch it on whenever it is ready: the flight looks for it"
            yield Finding(Grade.WARNING, facts.vehicle_id, "link", f"in reserve, and not received: {found}", why, step)
            return
        why = "commands would not arrive, or would reach another vehicle"
        yield Finding(Grade.REFUSE, facts.vehicle_id, "link", found, why, step)
        return
    yield Finding(
        Grade.PASS, facts.vehicle_id, "link", f"received on {vehicle.section.url} as system {vehicle.system_id}"
    )
    for check in VEHICLE_CHECKS + (AUTOPILOT_CHECKS if facts.autopilot.is_known else ()):
        yield from check(facts, mission, vehicle)
    yield from profile(facts, mission, vehicle, today)


STYLES = {Grade.REFUSE: "bold red", Grade.WARNING: "yellow", Grade.PASS: "green"}
SUBJECT_WIDTH = 20
HEADLINES = {
    Grade.REFUSE: "not fit to fly",
    Grade.WARNING: "fit to fly, with warnings",
    Grade.PASS: "fit to fly",
}


RECOVERY_HEADLINES = {
    Grade.REFUSE: "nothing is sent to the vehicles",
    Grade.WARNING: "can be brought home, with warnings",
    Grade.PASS: "can be brought home",
}


def findings_view(
    mission: str, findings: Sequence[Finding], *, passes: bool = False, headlines: Mapping[Grade, str] = HEADLINES
) -> RenderableType:
    """Return the findings as a table, refusals last; a finding of several vehicles is one row with all their ids.

    Without `passes` the passed checks are only counted.
    """
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(max_width=SUBJECT_WIDTH)
    table.add_column()
    alike: dict[Finding, list[Subject]] = {}
    by_grade = [each for grade in reversed(Grade) for each in findings if each.grade is grade]
    for finding in (each for each in by_grade if passes or each.grade is not Grade.PASS):
        alike.setdefault(replace(finding, about=MISSION), []).append(finding.about)
    for finding, subjects in alike.items():
        cell = Text(finding.found)
        if finding.grade is not Grade.PASS:
            cell.append(f"\nwhy: {finding.why}\nnext: {finding.next_step}", style="dim")
        table.add_row(Text(finding.grade.value, style=STYLES[finding.grade]), Text(subjects_text(subjects)), cell)
    grade = worst(findings)
    count = Counter(finding.grade for finding in findings)
    counted = ", ".join(f"{count[each]} {each.value}" for each in Grade)
    return Group(table, Text(f"{mission}: {headlines[grade]} ({counted})", style=STYLES[grade]))


def findings_json(mission: str, findings: Sequence[Finding]) -> str:
    """Return the findings as one JSON object on one line; `grade` at the top is the most severe."""
    listed = [_plain(finding) for finding in findings]
    return json_output({"mission": mission, "grade": worst(findings).value, "findings": listed})


def _plain(finding: Finding) -> dict[str, object]:
    said = {"grade": finding.grade.value, "subject": finding.subject}
    return said | {name: value for name, value in asdict(finding).items() if name not in ("grade", "about")}


def exit_code(findings: Sequence[Finding]) -> Exit:
    """Return the exit code: only a refusal is a failure."""
    return Exit.REFUSED if worst(findings) is Grade.REFUSE else Exit.HOLDS
