"""`cordon station`: the operator's page of a running team, or of a recorded flight."""

import asyncio
import os
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from gcs.cli.options import STATION_ADDRESS, Changes, KeyName, Tiles, only_file, running_mission
from gcs.errors import Exit, InputError
from gcs.signals import hold_back, relay

if TYPE_CHECKING:
    from gcs.console.vehicle_view import Pair
    from gcs.metrics.ending import LostFlight
    from gcs.mission.mission import Mission
    from gcs.station.access import Access
    from gcs.station.tiles import MapTiles
    from gcs.viewer.connections import ListeningSocket


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class StationOptions:
    """Options of `cordon station`, without a log."""

    mission: Annotated[
        tuple[str, ...],
        Parameter(
            negative="", help="The mission that the team flies; repeated: the missions of several teams on one page."
        ),
    ] = ("case2",)
    changes: Changes = ()
    address: Annotated[
        str, Parameter(help="Address of the page, HOST:PORT. Beyond this computer it needs --tls and --token-file.")
    ] = STATION_ADDRESS
    tls: Annotated[
        tuple[Path, Path] | None,
        Parameter(negative="", validator=only_file, help="The server's certificate and private key, PEM files."),
    ] = None
    token_file: Annotated[
        Path | None,
        Parameter(validator=only_file, help="A file with an access token of your own, for pages elsewhere."),
    ] = None
    tiles: Tiles = None
    edit: Annotated[
        bool,
        Parameter(
            negative="", help="Draw the fence and the no-fly zones of the mission file on the map, before a flight."
        ),
    ] = False
    key: KeyName = None
    vehicles: Annotated[
        Literal["flight", "sitl", "hybrid", "bench"] | None,
        Parameter(help="Vehicles as labelled on the page: flight if real, sitl for stubs, hybrid for some, bench."),
    ] = None


_DEFAULTS = StationOptions()


def station(
    log: Annotated[
        Path | None, Parameter(validator=only_file, help="A flight log to show instead of a running team.")
    ] = None,
    /,
    *,
    options: StationOptions = _DEFAULTS,
) -> Exit:
    """Serve the operator's page: the team's state, alarms and commands. Open the printed address in a browser.

    The page receives the team's messages as `cordon watch` does: before, during and after flights. Commands need an
    operator's keys. Ctrl-C ends the page, not the flight.

    Example: cordon station --mission case2-field

    Example: cordon station --mission red.toml --mission blue.toml

    Example: cordon station --mission field.toml --edit
    """
    from gcs.station.station_process import flight_pipe

    hold_back()
    ending = _Ending(flight_pipe())
    access = _access(options)
    if options.edit:
        return _serve_editor(access, options, ending)
    return _serve_teams(access, options, ending) if log is None else _serve_flight(log, access, options, ending)


class _Ending:
    """What ends the station: the end of the flight that started it, or else a signal, also before it serves."""

    def __init__(self, pipe: int | None) -> None:
        """Take the pipe from the flight, None without one."""
        self.pipe = pipe
        self.stop: Callable[[], object] = lambda: os._exit(Exit.REFUSED)  # whatever the main thread waits for
        if pipe is None:
            relay(self._take_signal)

    def _take_signal(self) -> None:
        self.stop()


def _access(options: StationOptions) -> "Access":
    """Return the access rules of the page; raises InputError."""
    from gcs.station.access import checked_access, read_token
    from gcs.viewer.origin_gate import Address

    address, file = Address.parsed(options.address, "--address"), options.token_file
    _require_regular("--token-file", *([] if file is None else [file]))
    _require_regular("--tls", *(options.tls or ()))
    return checked_access(address, None if file is None else read_token(file), options.tls)


def _require_regular(option: str, *paths: Path) -> None:
    """Raise InputError for a pipe or a device in place of a file: to read it may take for ever."""
    for path in paths:
        if path.exists() and not path.is_file():
            raise InputError([f"{option}: {path}: not a regular file"])


def _serve_teams(access: "Access", options: StationOptions, ending: _Ending) -> Exit:
    from gcs.checklist import Checklist
    from gcs.station.access import camera_origins
    from gcs.station.broadcast import Broadcast
    from gcs.station.commands import Commands
    from gcs.station.live_team import LiveTeam
    from gcs.station.picture import origin_deg
    from gcs.station.server import ServedTeam, serve_teams

    missions = [running_mission(name, options.changes) for name in options.mission]
    names = [each.network.team for each in missions]
    if len(missions) > 1 and options.changes:
        raise InputError(["--set: with several missions, change their files"])
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        raise InputError([f"--mission: two missions are of team {twice[0]}: give each another team in [network]"])
    tiles = _tiles(options.tiles, origin_deg(missions[0]))
    teams = [LiveTeam(each, options.vehicles or "unstated") for each in missions]
    streams = [each.section.camera_url or "" for mission in missions for each in mission.vehicles]
    access = replace(access, cameras=camera_origins(streams))

    def served(mission: "Mission", team: LiveTeam) -> ServedTeam:
        def commands(broadcast: Broadcast) -> Commands:
            return Commands(mission, options.key, broadcast.publish)

        return ServedTeam(team, commands, Checklist(mission.network.team, mission.checklist))

    async def serve(listening: "Sequence[ListeningSocket]", stop: asyncio.Event) -> None:
        shown = [served(*each) for each in zip(missions, teams, strict=True)]
        await serve_teams(shown, access, listening, stop, tiles=tiles, outlives=lambda: teams[0].has_lost_flight)

    of = "team" if len(names) == 1 else "teams"
    return _serve(serve, access, f"{of} {', '.join(names)}", ending, teams[0].lose)


def _serve_editor(access: "Access", options: StationOptions, ending: _Ending) -> Exit:
    """Serve the page as an editor of the mission file; raises InputError for one that cannot be edited."""
    from gcs.mission.file import bundled_missions, mission_path
    from gcs.station.picture import origin_deg
    from gcs.station.plan_editor import PlanEditor

    if options.changes:
        raise InputError(["--edit: the file is edited, without --set"])
    if len(options.mission) > 1:
        raise InputError(["--edit: it edits one mission"])
    (name,) = options.mission
    if name in bundled_missions():
        raise InputError([f"--edit: {name} is bundled with cordon: edit a file, such as one of `cordon new`"])
    path = mission_path(name)
    tiles = None
    editor = PlanEditor(path)
    if options.tiles is not None:
        tiles = _tiles(options.tiles, origin_deg(editor.mission))
        editor = PlanEditor(path, tiles)
    serve_pages = partial(editor.serve, access)
    return _serve(serve_pages, access, f"editor of {path.name}", ending)


def _serve_flight(path: Path, access: "Access", options: StationOptions, ending: _Ending) -> Exit:
    """Serve the page of a recorded flight; raises InputError for a log that cordon did not record."""
    from gcs.cli.output import print_log_faults
    from gcs.flightlog.reader import read_log
    from gcs.station.recorded_flight import recorded_flight
    from gcs.station.server import recorded_app, serve
    from gcs.vehicle_logs.foreign import is_foreign

    _require_regular("LOG", path)
    if is_foreign(path):
        raise InputError([f"{path}: not recorded by cordon; use `cordon report`"])
    log = read_log(path)
    print_log_faults(log)
    flight = recorded_flight(log)
    app = recorded_app(flight, tiles=_tiles(options.tiles, flight.mission.origin_deg))
    return _serve(lambda listening, stop: serve(app, access, listening, stop), access, path.name, ending)


def _tiles(path: Path | None, origin_deg: "Pair | None") -> "MapTiles | None":
    """Return the map tiles of an option, for a mission with this origin; raises InputError."""
    from gcs.console.terminal import print_line
    from gcs.station.tiles import opened_tiles

    if path is None:
        return None
    tiles = opened_tiles(path, origin_deg)
    if not tiles.covers_origin:
        print_line(f"warning: map tiles {path}: no tile covers the mission's origin {origin_deg}", "yellow")
    return tiles


def _serve(
    serve: "Callable[[Sequence[ListeningSocket], asyncio.Event], Awaitable[None]]",
    access: "Access",
    subject: str,
    ending: _Ending,
    lose: "Callable[[LostFlight], object]" = lambda _flight: None,
) -> Exit:
    """Serve until Ctrl-C, or until the end of the flight that started this station; `lose` takes its loss."""
    from agents.ports import VehicleRefusedError
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_line, print_problem
    from gcs.station.server import listen
    from gcs.station.station_process import FlightPipe

    try:
        listening = listen(access)
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    pipe = ending.pipe
    say = print_line if pipe is None else print_result  # a flight reads it, and says it

    async def run() -> None:
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        if pipe is not None:
            loop.add_reader(pipe, FlightPipe(pipe, stop.set, lose).read)
        else:
            ending.stop = lambda: loop.call_soon_threadsafe(stop.set)
        say(f"page of {subject}: {access.url}")
        await serve(listening, stop)

    asyncio.run(run())
    return Exit.HOLDS
