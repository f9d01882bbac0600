"""What the commands do once the command line is parsed: load, fly, show, and say how it went."""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from agents.ports import VehicleRefusedError
from agents.settings.shapes import Shape
from agents.shell.outcome import Ending, Outcome
from agents.team.messages import Verb
from gcs.cli.output import (
    STDERR,
    SimulationProgress,
    check_plot,
    confirmed,
    present,
    print_result,
)
from gcs.errors import Exit, InputError
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import Finding, Grade
from gcs.signals import pending

if TYPE_CHECKING:
    from gcs.flight.equipment import Equipment
    from gcs.metrics.record import FlightRecord

_SPEED_KEPT_SHARE = 0.97
_MISSED_SHARE = 0.01


def simulate_mission(
    name: str,
    *,
    seed: int | None,
    duration: float | None,
    log: Path | None,
    json: bool,
    plot: Path | None,
    timing: bool | None,
) -> Exit:
    """`cordon sim`."""
    from gcs.cli.logbook import simulation_recording, tell_of_log  # noqa: PLC0415
    from gcs.flight.simulated import fly_simulated  # noqa: PLC0415

    check_plot(plot)
    mission = load_mission(name)
    flown_s = duration or mission.mission.duration_s
    seed_used = mission.mission.seed if seed is None else seed
    recording = simulation_recording(mission, log, seed_used, flown_s)

    def update(time_s: float) -> None:
        if pending():
            raise KeyboardInterrupt
        progress.update(time_s)

    try:
        with SimulationProgress(mission.mission.name, flown_s) as progress:
            record = fly_simulated(mission, seed_used, flown_s, update, recording)
    except KeyboardInterrupt:
        _say("the simulation was ended", "")
        return Exit.ENDED_IN_FLIGHT
    verdict = present(mission, record, json=json, plot=plot, timed=seed is None if timing is None else timing)
    if recording is not None:
        tell_of_log(recording.writer)
    return verdict


def fly_mission(
    name: str,
    *,
    sitl: bool,
    speed: float | None,
    only: int | None,
    duration: float | None,
    log: Path | None,
    json: bool,
    plot: Path | None,
    recorded: bool = True,
    live: str | None = None,
    equipment: "Equipment | None" = None,
) -> Exit:
    """`cordon fly`; a drill brings equipment that can fail. It is recorded at `log`, or at the default place.

    Viewers may look on at the address `live`.
    """
    check_plot(plot)
    mission = load_mission(name)
    if sitl and only is not None:
        raise InputError(["--only: with --sitl all vehicles fly in this process; serve them by `cordon sitl` instead"])
    duration = duration or mission.mission.duration_s

    def shown(record: "FlightRecord") -> Exit:
        return present(mission, record, json=json, plot=plot)

    return fly_loaded(
        mission,
        duration,
        shown,
        sitl=sitl,
        speed=speed,
        only=only,
        log=log,
        recorded=recorded,
        live=live,
        equipment=equipment,
    )


def fly_loaded(
    mission: Mission,
    duration: float,
    shown: Callable[["FlightRecord"], Exit],
    *,
    sitl: bool,
    speed: float | None,
    only: int | None,
    log: Path | None,
    recorded: bool,
    live: str | None = None,
    equipment: "Equipment | None" = None,
) -> Exit:
    """Fly a mission that is loaded, and return how it went: `shown` is told its record, and says whether it holds."""
    from gcs.cli.logbook import flight_log, tell_of_log  # noqa: PLC0415
    from gcs.console.live import LiveView  # noqa: PLC0415
    from gcs.flight.flight import fly  # noqa: PLC0415
    from gcs.flight.heartbeat import SupervisorHeartbeat  # noqa: PLC0415
    from gcs.flight.plan import FlightPlan  # noqa: PLC0415

    vehicles = mission.vehicles if only is None else (chosen(mission, only, "--only"),)
    speed = speed or (1.0 if sitl else None)
    orphaned = partial(_say, "this flight's supervisor is gone: the vehicles hold and land", "")
    try:
        with (
            flight_log(log, mission.mission.name, only, recorded=recorded, live=live) as writer,
            SupervisorHeartbeat.inherited(orphaned) as heartbeat,
            LiveView(STDERR) as view,
        ):
            plan = FlightPlan(mission, duration, vehicles, sitl, speed, equipment, writer)
            flight = asyncio.run(fly(plan, view, partial(_show_alarms, mission), heartbeat))
    except VehicleRefusedError as refusal:
        _say(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    verdict = Exit.VERDICT_FAILED
    if flight.record is not None:
        verdict = shown(flight.record)
        _warn_of_lateness(flight.record.loop.missed, flight.record.loop.ticks, flight.speed, flight.speed_kept)
    tell_of_log(writer)
    return _judged(flight.outcomes, verdict)


def _show_alarms(mission: Mission, findings: Sequence[Finding]) -> None:
    """Show what is not well; silent when all is."""
    from gcs.preflight.findings_view import findings_view  # noqa: PLC0415

    if any(finding.grade is not Grade.PASS for finding in findings):
        STDERR.print(findings_view(mission.mission.name, findings, passes=False))


def check_mission(name: str, *, json: bool) -> Exit:
    """`cordon check`."""
    from gcs.preflight.findings_view import exit_code, findings_json, findings_view  # noqa: PLC0415
    from gcs.preflight.link_facts import gather_facts  # noqa: PLC0415
    from gcs.preflight.preflight import preflight  # noqa: PLC0415

    mission = load_mission(name)
    findings = preflight(mission, asyncio.run(gather_facts(mission)), date.today())
    STDERR.print(findings_view(mission.mission.name, findings))
    if json:
        print_result(findings_json(mission.mission.name, findings))
    return exit_code(findings)


def serve_stubs(name: str, speed: float) -> Exit:
    """`cordon sitl`."""
    from gcs.flight.stubs import serve_until_ctrl_c, stub_configs  # noqa: PLC0415

    configs = stub_configs(load_mission(name))
    for config in configs:
        STDERR.print(
            f"vehicle {config.vehicle_id}: MAVLink to udp {config.client_host}:{config.client_port}", highlight=False
        )
    STDERR.print(f"simulated time passes {speed:g} times as fast as the wall's; Ctrl-C ends it", highlight=False)
    try:
        asyncio.run(serve_until_ctrl_c(configs, speed))
    except OSError as error:
        _say(f"the stub vehicles did not start: {error}", "see whether something else holds their ports")
        return Exit.REFUSED
    return Exit.HOLDS


def watch_team(mission_name: str) -> Exit:
    """`cordon watch`."""
    from gcs.console.watch import WatchView, watch_until_ctrl_c  # noqa: PLC0415

    mission = load_mission(mission_name)
    try:
        with WatchView(STDERR) as view:
            asyncio.run(watch_until_ctrl_c(mission, view))
    except VehicleRefusedError as refusal:
        _say(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    return Exit.HOLDS


def drill_team(name: str, faults: Sequence[str], *, log: Path | None, json: bool) -> Exit:
    """`cordon drill`; its flights are recorded if there is a folder for their logs."""
    from gcs.drill.faults import chosen  # noqa: PLC0415
    from gcs.drill.run import DrillRun  # noqa: PLC0415
    from gcs.drill.stubs import StubFlight  # noqa: PLC0415
    from gcs.drill.view import DrillProgress, drill_table, drills_json  # noqa: PLC0415

    drills, mission = chosen(faults), load_mission(name)
    if log is not None and not log.is_dir():
        raise InputError([f"--log: no folder {str(log)!r} for the logs of the drill's flights"])
    fly = partial(StubFlight, logs=log)
    try:
        rows = asyncio.run(DrillRun(name, fly, drills, DrillProgress(STDERR, len(drills))).run())
    except VehicleRefusedError as refusal:
        _say(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    STDERR.print(drill_table(mission.mission.name, rows))
    if json:
        print_result(drills_json(mission.mission.name, rows))
    return Exit.VERDICT_FAILED if any(row.holds is False for row in rows) else Exit.HOLDS


def command_team(verb: Verb, shape: Shape | None, vehicle: int | None, mission_name: str, *, yes: bool) -> Exit:
    """`cordon command`; the verb formation comes with a shape, and is for the whole team."""
    from gcs.console.operator import Operator  # noqa: PLC0415

    mission = load_mission(mission_name)
    vehicles = mission.ids if vehicle is None else (chosen(mission, vehicle, "--vehicle").id,)
    if faults := list(_shape_faults(mission, verb, shape, vehicle)):
        raise InputError(faults)
    if verb == "kill" and not yes and not confirmed(_kill_question(vehicles, mission)):
        _say("nothing was said to anybody", "")
        return Exit.REFUSED
    operator = Operator(mission)
    try:
        answers = asyncio.run(operator.command(verb, vehicles, vehicle, shape))
    except VehicleRefusedError as refusal:
        _say(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    for vehicle_id, answer in answers.items():
        told = "did not answer" if answer is None else f"{answer.did} (answered after {answer.after_s * 1000:.0f} ms)"
        STDERR.print(f"vehicle {vehicle_id}: {verb}: {told}", markup=False, highlight=False, soft_wrap=True)
    STDERR.print(
        f"joining the team's bus took {operator.joined_after_s * 1000:.0f} ms before it was said", highlight=False
    )
    return Exit.HOLDS if all(answer and answer.obeyed for answer in answers.values()) else Exit.REFUSED


def _shape_faults(mission: Mission, verb: Verb, shape: Shape | None, vehicle: int | None) -> Iterator[str]:
    if verb != "formation":
        if shape is not None:
            yield f"shape: '{shape}' goes with the verb formation, not with {verb}"
        return
    shapes = mission.agent_config(mission.vehicles[0]).shapes
    if shape is None:
        yield f"shape: this argument is missing (shapes: {', '.join(shapes)})"
    elif shape not in shapes:
        why = "its vehicles have no slot_m" if shape == "free" else "formation.spacing_m is less than the separation"
        yield f"shape: not '{shape}' in {mission.mission.name}: {why} (shapes: {', '.join(shapes)})"
    if vehicle is not None:
        yield f"--vehicle: a formation is the whole team's: leave it out (given: {vehicle})"


def _kill_question(vehicles: Sequence[int], mission: Mission) -> str:
    named = f"vehicle {vehicles[0]}" if len(vehicles) == 1 else f"vehicles {', '.join(map(str, vehicles))}"
    return f"Cut the motors of {named} of {mission.mission.name}, and let them fall?"


def chosen(mission: Mission, vehicle_id: int, option: str) -> MissionVehicle:
    """Return one of a mission's vehicles; raises InputError that names the option."""
    try:
        return mission.vehicle(vehicle_id)
    except KeyError as error:
        ids = ", ".join(map(str, mission.ids))
        raise InputError([f"{option}: the mission has no vehicle {vehicle_id} (it has {ids})"]) from error


def _judged(outcomes: dict[int, Outcome], verdict: Exit) -> Exit:
    """Tell how each flight ended that did not end well, and return the command's exit code."""
    failed = {i: outcome for i, outcome in outcomes.items() if outcome.ending is not Ending.COMPLETED}
    for vehicle_id, outcome in failed.items():
        _say(f"vehicle {vehicle_id} {outcome.ending.value}: {outcome.reason}", outcome.next_step)
    if not failed:
        return verdict
    return Exit.ENDED_IN_FLIGHT if any(outcome.flew for outcome in outcomes.values()) else Exit.REFUSED


def _say(reason: str, next_step: str) -> None:
    STDERR.print(reason, style="red", markup=False, highlight=False, soft_wrap=True)
    if next_step:
        STDERR.print(f"next: {next_step}", markup=False, highlight=False, soft_wrap=True)


def _warn_of_lateness(missed: int, ticks: int, speed: float, speed_kept: float) -> None:
    if speed_kept < _SPEED_KEPT_SHARE * speed:
        STDERR.print(f"this machine reached speed {speed_kept:.1f}, not {speed:g}", style="yellow", highlight=False)
    if missed > _MISSED_SHARE * ticks:
        STDERR.print(
            f"{missed} of {missed + ticks} ticks came too late: ask for less than --speed {speed:g}",
            style="yellow",
            highlight=False,
        )
