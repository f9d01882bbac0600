"""A flight as a command: open the log, fly the plan under supervision, judge and report the result."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain, repeat
from math import isinf

from agents.flight_end import FlightEnd
from agents.ports import VehicleRefusedError
from agents.shell.outcome import Outcome
from gcs.console.advice import late_ticks
from gcs.console.buffered_output import unblocked
from gcs.console.live import LiveView
from gcs.console.terminal import STDERR, print_line, print_problem
from gcs.errors import Exit, InputError
from gcs.flight.flight import FlightOutcome, fly
from gcs.flight.heartbeat import SupervisorHeartbeat
from gcs.flight.live.operating import ProgramLink
from gcs.flight.log_process import LogProcess
from gcs.flight.plan import FlightPlan
from gcs.flight.recording import RecordingOptions, flight_log, report_log
from gcs.flight.team import ending_of
from gcs.garbage import collect_rarely
from gcs.link.ports import added_text
from gcs.metrics.ending import HEADLINES, watch_them
from gcs.metrics.record import FlightRecord
from gcs.mission.added_vehicle import recovery_command
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade
from gcs.preflight.preflight import RECOVERY_HEADLINES, findings_view

_SPEED_REACHED_SHARE = 0.97


Judge = Callable[[Mission, FlightRecord], Exit]


def run_flight(
    plan: FlightPlan, recording: RecordingOptions, judge: Judge, file: str = "MISSION", changes: Sequence[str] = ()
) -> Exit:
    """Fly a plan, whose `log` is opened here, in the supervised process; return the exit code.

    `file` is the mission's name on the command line, `changes` are the values of `--set`, for commands that are named.
    `judge` receives the mission and the record of one that began, shows it and returns its verdict. Raises InputError.
    """
    try:
        flight, log = flown(plan, recording)
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    verdict = Exit.VERDICT_FAILED
    if flight.record is not None:
        verdict = judge(flight.mission, flight.record)
        _warn_of_lateness(flight, flight.record, slower=plan.is_governed and flight.speed > 1.0)
    if flight.mission.added is not None and plan.mission.added is None:
        report_abandoned(plan.mission, file, changes)
    report_log(log)
    return exit_code(plan.mission, flight.outcomes, verdict)


def flown(
    plan: FlightPlan, recording: RecordingOptions, program: ProgramLink | None = None
) -> tuple[FlightOutcome, LogProcess | None]:
    """Fly a plan in the supervised process, operated by a program if there is one; return its outcome and its log.

    Raises InputError and VehicleRefusedError.
    """
    log = flight_log(recording, plan.mission)
    with (
        SupervisorHeartbeat.inherited(_report_supervisor_lost) as supervisor,
        unblocked(STDERR),
        LiveView(STDERR, plan.mission.safety.separation_m) as view,
    ):
        report = partial(_report_findings, plan.mission) if plan.recovery is None else _reporting(plan.mission)
        collect_rarely(full=False)
        return asyncio.run(fly(replace(plan, log=log), view, report, supervisor, program)), log


def _report_supervisor_lost() -> None:
    print_problem("this flight's supervisor process has ended: the vehicles hold, then land")


def _report_findings(mission: Mission, findings: Sequence[Finding]) -> None:
    """Print the findings that are not passes."""
    if any(finding.grade is not Grade.PASS for finding in findings):
        STDERR.print(findings_view(mission.mission.name, findings))


def _reporting(mission: Mission) -> Callable[[Sequence[Finding]], None]:
    """Return what prints first what is done with each vehicle of a team that is brought home, then other findings."""
    first = chain([True], repeat(False))

    def report(findings: Sequence[Finding]) -> None:
        if next(first):
            name = mission.mission.name
            STDERR.print(findings_view(name, findings, passes=True, headlines=RECOVERY_HEADLINES))
        else:
            _report_findings(mission, findings)

    return report


def report_abandoned(mission: Mission, file: str, changes: Sequence[str]) -> None:
    """Name the command that reaches a vehicle whose process was killed, which had joined the flight from here.

    `file` and `changes` as in `run_flight`.
    """
    with suppress(InputError, VehicleRefusedError):  # without a folder of claims none has joined from here
        if (text := added_text(mission, abandoned=True)) is not None:
            joined = mission.parse(text, mission.folder, mission.profile_texts)
            killed = f"vehicle {joined.added} had joined this flight, and the process that flew it was killed"
            print_problem(killed, watch_them(recovery_command(joined, file, changes)))


def exit_code(mission: Mission, outcomes: dict[int, Outcome], verdict: Exit) -> Exit:
    """Report each vehicle whose flight was not completed, and return the command's exit code.

    Those that are unaccounted for come first, with their last positions.
    """
    failed = {i: outcome for i, outcome in outcomes.items() if outcome.how is not FlightEnd.LANDED}
    for vehicle_id, outcome in sorted(failed.items(), key=lambda each: each[1].unaccounted is None):
        ending = ending_of(vehicle_id, outcome, mission.mission_frame())
        where = "" if ending.unaccounted is None else f"{ending.unaccounted.line}\n"
        print_problem(f"{where}{HEADLINES[outcome.how]}: vehicle {vehicle_id}: {outcome.reason}", outcome.next_step)
    if not failed:
        return verdict
    return Exit.ENDED_IN_FLIGHT if any(outcome.flew for outcome in outcomes.values()) else Exit.REFUSED


def _warn_of_lateness(flight: FlightOutcome, record: FlightRecord, *, slower: bool) -> None:
    """Report a computer that was too slow, with advice; `slower` is whether the flight could have been slower."""
    if isinf(flight.speed):
        print_line(f"this computer reached speed {flight.speed_reached:.1f}")
    elif flight.speed_reached < _SPEED_REACHED_SHARE * flight.speed:
        print_line(f"this computer reached speed {flight.speed_reached:.1f}, not {flight.speed:g}", "yellow")
    if late := late_ticks(record.loop.missed, record.loop.ticks, below_speed=flight.speed if slower else None):
        print_line(late, "yellow")
