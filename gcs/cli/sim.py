"""`cordon sim`: a mission in simulated time."""

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.options import (
    RESULT,
    STATION_ADDRESS,
    AllowPlugins,
    Changes,
    Duration,
    FigureNumber,
    Json,
    Log,
    MissionName,
    Plot,
    Station,
    StationAddress,
    StationTiles,
    loaded_mission,
    require_station,
)
from gcs.errors import Exit, InputError
from gcs.garbage import collect_rarely
from gcs.signals import hold_back, pending


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SimOptions:
    """Options of `cordon sim`."""

    mission: MissionName = field(kw_only=False)
    changes: Changes = ()
    seed: Annotated[
        int | None,
        Parameter(help="Seed of noise, delay and loss, instead of the mission's.", validator=Number(gte=0)),
    ] = None
    duration: Duration = None
    allow_plugins: AllowPlugins = False
    log: Log = None
    station: Station = False
    station_address: StationAddress = None
    station_tiles: StationTiles = None
    json: Json = False
    plot: Plot = None
    figure: FigureNumber = None
    timing: Annotated[
        bool | None,
        Parameter(
            group=RESULT,
            help="Whether the JSON holds wall times. Default: yes without --seed, no with it: equal seeds then give "
            "equal bytes.",
        ),
    ] = None


def sim(options: SimOptions) -> Exit:
    """Fly a mission in simulated time, in one process: deterministic, far faster than real time.

    Example: cordon sim case2-field --seed 7 --plot flight.png
    """
    hold_back()
    require_station(options.station, options.station_address, options.station_tiles)
    from gcs.console.terminal import print_problem

    try:
        verdict, log = _sim(options)
    except KeyboardInterrupt:
        print_problem("the simulation was interrupted")
        return Exit.ENDED_IN_FLIGHT
    if not options.station or log is None:
        return verdict
    from gcs.cli.station import StationOptions, station

    address = options.station_address or STATION_ADDRESS
    shown = station(log, options=StationOptions(address=address, tiles=options.station_tiles))
    return verdict if shown is Exit.HOLDS else shown


def _sim(options: SimOptions) -> tuple[Exit, Path | None]:
    """Fly; return the verdict and the log. Raises InputError, and KeyboardInterrupt for Ctrl-C."""
    from gcs.cli.output import SimulationProgress, check_plot, present, print_warning
    from gcs.flight.simulated import fly_simulated
    from gcs.mission.planner import planner_of
    from gcs.preflight.findings import Grade
    from gcs.preflight.mission import encounter

    check_plot(options.plot, options.figure)
    mission = loaded_mission(options.mission, options.changes)
    planner = planner_of(mission, allowed=options.allow_plugins)
    for finding in encounter(mission):
        if finding.grade is not Grade.PASS:
            print_warning(finding)
    if options.station_tiles is not None:
        from gcs.station.picture import origin_deg
        from gcs.station.tiles import opened_tiles

        opened_tiles(options.station_tiles, origin_deg(mission))  # refuses tiles that cannot be drawn before the flight
    flown_s = options.duration or mission.mission.duration_s
    seed = mission.mission.seed if options.seed is None else options.seed
    recording, log = None, _log_path(options, mission.mission.name)
    if log is not None:
        from gcs.flight.recording import report_log, simulation_recording

        recording = simulation_recording(mission, log, seed, flown_s, "--log", planner)

    def update(time_s: float) -> None:
        if pending():
            raise KeyboardInterrupt
        progress.update(time_s)

    collect_rarely()
    with SimulationProgress(mission.mission.name, flown_s) as progress:
        record = fly_simulated(mission, seed, flown_s, update, recording, None if planner is None else planner.factory)
    timed = options.seed is None if options.timing is None else options.timing
    verdict = present(mission, record, json=options.json, plot=options.plot, figure=options.figure, timed=timed)
    if recording is not None:
        report_log(recording.writer)
    return verdict, log


def _log_path(options: SimOptions, mission: str) -> Path | None:
    """Return where to record: the page needs a log. Raises InputError if no log can be written."""
    if options.log is not None or not options.station:
        return options.log
    from gcs.flight.recording import default_path

    try:
        return default_path(mission, None, datetime.now())
    except OSError as error:
        raise InputError([f"--station: {error}; give a file by --log"]) from error
