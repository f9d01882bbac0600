"""The command line: parses, loads the mission, hands over. What is heavy is imported by the command that needs it."""

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, CycloptsError, Parameter

from gcs.cli.logs import (
    identify,
    logs,
    replay,
    report,
)
from gcs.cli.options import (
    RESULT,
    Duration,
    Json,
    Log,
    MissionName,
    Plot,
    RunningMission,
    Seed,
    Speed,
    Timing,
)
from gcs.cli.target_command import target
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

app = App(
    name="cordon",
    help="Fly a team of quadrotors line abreast, and let each decide for itself to encircle a target.",
    help_epilogue="Start with: cordon fly case2 --sitl --speed 10",
)
for _command in (logs, report, identify, replay, target):
    app.command(_command)


@app.command
def sim(
    mission: MissionName,
    *,
    seed: Seed = None,
    duration: Duration = None,
    log: Log = None,
    json: Json = False,
    plot: Plot = None,
    timing: Timing = None,
) -> Exit:
    """Fly a mission in one process with simulated time: deterministic, far faster than real time.

    Example: cordon sim case2-field --seed 7 --plot flight.png
    """
    hold_back()
    from gcs.cli.commands import simulate_mission  # noqa: PLC0415

    return simulate_mission(mission, seed=seed, duration=duration, log=log, json=json, plot=plot, timing=timing)


@app.command
def fly(
    mission: MissionName,
    *,
    sitl: Annotated[bool, Parameter(negative="", help="Bring stub vehicles along: no hardware is needed.")] = False,
    speed: Speed = None,
    only: Annotated[
        int | None, Parameter(help="Run the agent of this vehicle alone; the others run elsewhere.")
    ] = None,
    duration: Duration = None,
    log: Log = None,
    recorded: Annotated[
        bool,
        Parameter(
            name="--recorded",
            negative="--no-log",
            show_default=False,
            group=RESULT,
            help="Whether the flight is recorded. It is unless told otherwise, in ~/.local/share/cordon/logs.",
        ),
    ] = True,
    live: Annotated[
        bool,
        Parameter(negative="", group=RESULT, help="Show the flight to viewers that look on: Foxglove or Lichtblick."),
    ] = False,
    live_address: Annotated[
        str | None,
        Parameter(group=RESULT, help="Where --live listens, HOST:PORT, in place of 127.0.0.1:8765: here alone."),
    ] = None,
    json: Json = False,
    plot: Plot = None,
) -> int:
    """Fly a mission over MAVLink and Zenoh. Ctrl-C: hold, land, disarm; twice: land at once.

    It flies in a process of its own, which is ended when a control loop hangs: the autopilots' failsafes take over.

    Example: cordon fly case2 --sitl --speed 10 --plot flight.png
    """
    hold_back()
    if live_address is not None and not live:
        raise InputError(["--live-address: without --live nobody can look on, wherever that is"])
    from gcs.flight.supervisor import is_supervised, supervise  # noqa: PLC0415

    if not is_supervised():
        return supervise(_tell)
    from gcs.cli.commands import fly_mission  # noqa: PLC0415

    return fly_mission(
        mission,
        sitl=sitl,
        speed=speed,
        only=only,
        duration=duration,
        log=log,
        json=json,
        plot=plot,
        recorded=recorded,
        live=(live_address or "127.0.0.1:8765") if live else None,
    )


@app.command
def excite(
    mission: MissionName,
    *,
    vehicle: Annotated[int | None, Parameter(help="The vehicle to fly; otherwise the mission's first.")] = None,
    sitl: Annotated[bool, Parameter(negative="", help="Bring a stub vehicle along: no hardware is needed.")] = False,
    speed: Speed = None,
    preview: Annotated[
        bool,
        Parameter(negative="", group=RESULT, help="Show what it would take - space, time, speed - and fly nothing."),
    ] = False,
    log: Log = None,
    recorded: Annotated[
        bool,
        Parameter(
            name="--recorded",
            negative="--no-log",
            show_default=False,
            group=RESULT,
            help="Whether the flight is recorded. It is unless told otherwise, in ~/.local/share/cordon/logs.",
        ),
    ] = True,
    json: Json = False,
) -> int:
    """Fly one vehicle so that it can be identified: steps and swept sines inside a box, as `[excitation]` says.

    Guard, failsafes, preflight and Ctrl-C are those of `cordon fly`. The log is what identification reads.

    Example: cordon excite case2 --vehicle 1 --preview
    """
    hold_back()
    from gcs.flight.supervisor import is_supervised, supervise  # noqa: PLC0415

    if not (preview or is_supervised()):
        return supervise(_tell)
    from gcs.cli.excite import excite_vehicle  # noqa: PLC0415

    return excite_vehicle(
        mission, vehicle, sitl=sitl, speed=speed, preview_only=preview, log=log, recorded=recorded, json=json
    )


@app.command
def check(mission: MissionName, *, json: Json = False) -> Exit:
    """Preflight, without arming: is the mission feasible, are its vehicles fit to fly it? Parameters are only read.

    Example: cordon check case2
    """
    from gcs.cli.commands import check_mission  # noqa: PLC0415

    return check_mission(mission, json=json)


@app.command
def sitl(mission: MissionName, *, speed: Speed = None) -> Exit:
    """Serve a mission's stub vehicles alone, for `cordon fly`, QGroundControl or any MAVLink client; Ctrl-C ends it.

    Example: cordon sitl case2 --speed 5
    """
    hold_back()
    from gcs.cli.commands import serve_stubs  # noqa: PLC0415

    return serve_stubs(mission, speed or 1.0)


@app.command
def drill(
    mission: MissionName,
    *,
    fault: Annotated[
        list[str] | None,
        Parameter(negative="", help="Only this fault, as killed-agent or foreign-mode; may be given again."),
    ] = None,
    log: Annotated[
        Path | None, Parameter(group=RESULT, help="Record the flights in this folder, a log for each flight.")
    ] = None,
    json: Json = False,
) -> Exit:
    """Bring one fault after another upon a team of stub vehicles, and measure how it reacts: nothing real flies.

    Example: cordon drill case2 --fault killed-agent
    """
    from gcs.cli.commands import drill_team  # noqa: PLC0415

    return drill_team(mission, fault or [], log=log, json=json)


@app.command
def command(
    verb: Literal["hold", "resume", "land", "rtl", "abort", "kill", "formation"],
    shape: Annotated[
        Literal["line", "column", "wedge", "free"] | None, Parameter(help="The shape that the formation takes.")
    ] = None,
    /,
    *,
    vehicle: Annotated[int | None, Parameter(help="Tell this vehicle alone; otherwise all of them.")] = None,
    mission: RunningMission = "case2",
    yes: Annotated[bool, Parameter(negative="", help="Kill without asking for confirmation.")] = False,
) -> Exit:
    """Tell a running team to hold, resume, land, return, abort, kill or change formation; every answer is shown.

    An abort hovers at once, and lands after `safety.abort_hover_s` unless resumed, or at a second abort. A kill cuts
    the motors: vehicles fall. `formation` comes with a shape, which all vehicles in formation change to.

    Example: cordon command formation wedge --mission case2
    """
    from gcs.cli.commands import command_team  # noqa: PLC0415

    return command_team(verb, shape, vehicle, mission, yes=yes)


@app.command
def watch(*, mission: RunningMission = "case2") -> Exit:
    """Watch a running team from another terminal: it is listened to, and told nothing; Ctrl-C ends the watching.

    Example: cordon watch --mission case2
    """
    hold_back()
    from gcs.cli.commands import watch_team  # noqa: PLC0415

    return watch_team(mission)


def _tell(line: str) -> None:
    """Write a line for people, whether anybody is left to read it or not."""
    with suppress(OSError):
        os.write(sys.stderr.fileno(), f"{line}\n".encode())


def main() -> None:
    """Run the command line and exit with its code."""
    try:
        command, bound, _ = app.parse_args(exit_on_error=False)
    except CycloptsError:
        sys.exit(Exit.BAD_INPUT)
    try:
        sys.exit(command(*bound.args, **bound.kwargs))
    except InputError as error:
        print(*error.faults, sep="\n", file=sys.stderr)
        sys.exit(Exit.BAD_INPUT)
    except KeyboardInterrupt:  # in flight, Ctrl-C is the flight's own business: here nothing has moved yet
        sys.exit(Exit.REFUSED)
