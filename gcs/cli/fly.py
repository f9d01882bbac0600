"""`cordon fly`: a mission over MAVLink and Zenoh."""

import sys
from dataclasses import dataclass, field
from shlex import join
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.options import (
    ALL_STUBS,
    RESULT,
    AllowPlugins,
    Changes,
    ChecklistDone,
    Duration,
    FigureNumber,
    Json,
    Leave,
    Log,
    MissionName,
    Plot,
    Recorded,
    Speed,
    Station,
    StationAddress,
    StationTiles,
    TakeFromPilot,
    TakeWithoutAsking,
    bus_mission,
    chosen_vehicle,
    loaded_mission,
    require_answer,
    require_known,
    require_station,
    stub_ids,
)
from gcs.errors import Exit, InputError
from gcs.flight.faults.names import OPTIONS
from gcs.signals import hold_back

if TYPE_CHECKING:
    from gcs.metrics.record import FlightRecord
    from gcs.mission.mission import Mission

OFF = "off"
_LIVE_ADDRESS = "127.0.0.1:8765"


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FlyOptions:
    """Options of `cordon fly`."""

    mission: MissionName = field(kw_only=False)
    changes: Changes = ()
    allow_plugins: AllowPlugins = False
    sitl: Annotated[
        str | None,
        Parameter(help="Fly bundled stub vehicles: all of them (no hardware needed), or those of a list such as 2,3."),
    ] = None
    bench: Annotated[
        bool,
        Parameter(negative="", help="Fly autopilot boards in hardware-in-the-loop simulation (HITL), propellers off."),
    ] = False
    speed: Speed = None
    fault: Annotated[
        tuple[str, ...],
        Parameter(
            negative="",
            show_default=False,
            help="Inject a fault, with --sitl: NAME@SECONDS or NAME@SECONDS:VEHICLE, such as link-cut@120:2; may be "
            "repeated. "
            f"Names: {', '.join(OPTIONS)}.",
        ),
    ] = ()
    only: Annotated[int | None, Parameter(help="Run the agent of this vehicle only; the others run elsewhere.")] = None
    adopt: Annotated[
        bool,
        Parameter(
            negative="",
            help="Take vehicles that are in the air already, as `cordon recover` does, and fly the mission with them.",
        ),
    ] = False
    take_from_pilot: TakeFromPilot = ()
    leave: Leave = ()
    yes: TakeWithoutAsking = False
    duration: Duration = None
    wait: Annotated[
        float,
        Parameter(
            validator=Number(gte=0, lte=3600),
            help="Seconds to wait on the ground for vehicles that are not ready yet; 0: refuse at once.",
        ),
    ] = 60.0
    checklist_done: ChecklistDone = None
    weather: Annotated[
        str | None, Parameter(help="The weather as you see it, for log and report, such as 'gusts from the west'.")
    ] = None
    wait_for_start: Annotated[
        bool,
        Parameter(
            negative="",
            help="Wait on the ground until an operator runs `cordon start`: for agents on companion computers.",
        ),
    ] = False
    log: Log = None
    recorded: Recorded = True
    live: Annotated[
        bool,
        Parameter(negative="", group=RESULT, help="Serve the flight live to Foxglove or Lichtblick."),
    ] = False
    live_address: Annotated[
        str | None,
        Parameter(group=RESULT, help=f"Address of --live, HOST:PORT, instead of {_LIVE_ADDRESS} (this computer only)."),
    ] = None
    live_origin: Annotated[
        tuple[str, ...],
        Parameter(
            negative="",
            show_default=False,
            group=RESULT,
            help="Also serve viewers whose web page has this origin, such as http://localhost:8080; may be repeated.",
        ),
    ] = ()
    station: Station = False
    station_address: StationAddress = None
    station_tiles: StationTiles = None
    json: Json = False
    plot: Plot = None
    figure: FigureNumber = None


def fly(options: FlyOptions) -> int:
    """Fly a mission over MAVLink and Zenoh. Ctrl-C: hold, land, disarm; twice: land at once.

    The flight runs in a separate process. If a control loop hangs, a supervisor kills that process; the autopilots'
    failsafes then act.

    cordon waits for vehicles that have no position yet or fail their arming checks; Ctrl-C ends the wait.

    With --sitl, --speed is an upper limit: the stubs wait for a slow computer, which changes no result; --speed max
    flies as fast as the computer can. With --sitl 2,3 these vehicles are stubs and the others are at their urls; all
    fly at the wall clock's speed, or at --speed.

    With --adopt cordon shows what it finds, and asks once. The vehicles in the air hold where they are; once all do,
    the mission begins with them, from their places. Those on the ground stay there.

    Example: cordon fly case2 --sitl --speed 10 --plot flight.png

    Example: cordon fly mixed-team --sitl --station --fault link-cut@60:2

    Example: cordon fly px4-trio --wait 120

    Example: cordon fly px4-trio --adopt
    """
    from gcs.flight.supervisor import is_supervised, supervise

    if options.bench and not is_supervised() and not _ask_for_propellers():
        return Exit.REFUSED
    hold_back()
    for option, given in (("--live-address", options.live_address), ("--live-origin", options.live_origin)):
        if given and not options.live:
            raise InputError([f"{option}: it needs --live"])
    _check_adoption(options)
    require_station(options.station, options.station_address, options.station_tiles)
    if is_supervised():
        return _fly(options)
    if options.station:
        return _supervise_with_station(options)
    return supervise(json=options.json, recovery=_recovery(options))


def _recovery(options: FlyOptions) -> str:
    """Return the command that brings home the vehicles of this process if it is killed."""
    only = () if options.only is None else ("--only", str(options.only))
    return join(["cordon", "recover", options.mission, *_settings(options), *only])


def _settings(options: FlyOptions) -> list[str]:
    return [part for given in options.changes for part in ("--set", given)]


def _check_adoption(options: FlyOptions) -> None:
    """Raise InputError for options that do not go with --adopt, or need it."""
    if options.adopt:
        others = {
            "--sitl": options.sitl is not None,
            "--only": options.only is not None,
            "--wait-for-start": options.wait_for_start,
            "--bench": options.bench,
        }
        if faults := [f"--adopt: not with {option}" for option, given in others.items() if given]:
            raise InputError(faults)
        taken = options.take_from_pilot, options.leave
        require_answer(lambda: require_known(loaded_mission(options.mission, options.changes), *taken), yes=options.yes)
    else:
        needing = {"--take-from-pilot": options.take_from_pilot, "--leave": options.leave, "--yes": options.yes}
        if faults := [f"{option}: it needs --adopt" for option, given in needing.items() if given]:
            raise InputError(faults)


def _supervise_with_station(options: FlyOptions) -> int:
    """Fly with the operator's page in a separate process; without the page no vehicle flies."""
    from agents.ports import VehicleRefusedError
    from gcs.console.terminal import print_line, print_problem
    from gcs.flight.supervisor import supervise
    from gcs.station.station_process import run_station

    address = () if options.station_address is None else ("--address", options.station_address)
    tiles = () if options.station_tiles is None else ("--tiles", str(options.station_tiles))
    mission = ["--mission", options.mission, *_settings(options)]
    try:
        with run_station([*mission, *address, *tiles, "--vehicles", _source(options)]) as station:
            if not station.line:
                return station.exit_code
            print_line(station.line)
            code = supervise(json=options.json, page=station, recovery=_recovery(options))
            if station.is_kept:
                print_line(f"{station.line} stays open and shows the last state; Ctrl-C closes it")
            station.wait()
            return code
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED


def _source(options: FlyOptions) -> str:
    """Return the kind of vehicles that the page shows."""
    if options.bench:
        return "bench"
    return {None: "flight", ALL_STUBS: "sitl"}.get(options.sitl, "hybrid")


def _ask_for_propellers() -> bool:
    """Ask on the terminal whether the propellers are off; return False without a terminal."""
    from gcs.console.terminal import print_line, print_problem

    answer = ""
    if sys.stdin.isatty():
        print_line(f"Boards may drive their motors. Type {OFF} if all propellers are off:", "bold yellow")
        answer = sys.stdin.readline().strip()
    if answer != OFF:
        found = "there is no terminal to answer on" if not sys.stdin.isatty() else f"the answer was {answer!r}"
        print_problem(f"--bench: propellers off was not confirmed: {found}", f"start again and type {OFF}")
    return answer == OFF


def _fly(options: FlyOptions) -> Exit:
    from gcs.cli.output import check_plot, present
    from gcs.flight.plan import TeamRecovery
    from gcs.flight.recording import RecordingOptions
    from gcs.flight.request import FlightRequest
    from gcs.flight.run import run_flight

    check_plot(options.plot, options.figure)
    mission = bus_mission(options.mission, options.changes)
    if options.only is not None:
        chosen_vehicle(mission, options.only, "--only")
    require_known(mission, options.take_from_pilot, options.leave)
    recovery = TeamRecovery(options.take_from_pilot, options.yes, flies_on=True) if options.adopt else None
    request = FlightRequest(
        mission=mission,
        stubs=() if options.sitl is None else stub_ids(options.sitl, mission),
        only=options.only,
        speed=options.speed,
        duration_s=options.duration,
        faults=options.fault,
        wait_s=options.wait,
        awaits_start=options.wait_for_start,
        bench=options.bench,
        allow_plugins=options.allow_plugins,
        checklist_done=options.checklist_done,
        weather=options.weather or "",
        recovery=recovery,
        left=options.leave,
    )
    live_address = (options.live_address or _LIVE_ADDRESS) if options.live else None
    recording = RecordingOptions(options.log, options.recorded, options.only, live_address, options.live_origin)

    def judge(flown: "Mission", record: "FlightRecord") -> Exit:
        return present(flown, record, json=options.json, plot=options.plot, figure=options.figure)

    return run_flight(request.plan(), recording, judge, options.mission, options.changes)
