"""`cordon station`: the operator's page of a running team, or of a recorded flight."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from gcs.cli.options import STATION_ADDRESS, Changes, KeyName, RunningMission, Tiles, bus_mission, only_file
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

if TYPE_CHECKING:
    import socket

    from gcs.console.vehicle_view import Pair
    from gcs.metrics.ending import LostFlight
    from gcs.station.access import Access
    from gcs.station.tiles import MapTiles


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class StationOptions:
    """Options of `cordon station`, without a log."""

    mission: RunningMission = "case2"
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
        Parameter(
            validator=only_file, help="A file with the page's access token, instead of the one that cordon stores."
        ),
    ] = None
    tiles: Tiles = None
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
    """
    hold_back()
    access = _access(options)
    return _serve_team(access, options) if log is None else _serve_flight(log, access, options)


def _access(options: StationOptions) -> "Access":
    """Return the access rules of the page; raises InputError."""
    from gcs.keys.run_keys import runtime_folder
    from gcs.station.access import checked_access, kept_token, read_token
    from gcs.viewer.origin_gate import Address

    address, file = Address.parsed(options.address, "--address"), options.token_file
    token = kept_token(runtime_folder() / ".station-token") if file is None else read_token(file)
    return checked_access(address, token, options.tls, is_own_token=file is not None)


def _serve_team(access: "Access", options: StationOptions) -> Exit:
    from gcs.station.broadcast import Broadcast
    from gcs.station.commands import Commands
    from gcs.station.live_team import LiveTeam
    from gcs.station.picture import origin_deg
    from gcs.station.server import serve_team

    mission = bus_mission(options.mission, options.changes)
    tiles = _tiles(options.tiles, origin_deg(mission))
    team = LiveTeam(mission, options.vehicles or "unstated")

    def commands(broadcast: Broadcast) -> Commands:
        return Commands(mission, options.key, broadcast.publish)

    async def serve(listening: "socket.socket", stop: asyncio.Event) -> None:
        await serve_team(team, commands, access, listening, stop, tiles=tiles, outlives=lambda: team.has_lost_flight)

    return _serve(serve, access, f"team {mission.network.team}", team.lose)


def _serve_flight(path: Path, access: "Access", options: StationOptions) -> Exit:
    """Serve the page of a recorded flight; raises InputError for a log that cordon did not record."""
    from gcs.cli.output import print_log_faults
    from gcs.flightlog.reader import read_log
    from gcs.station.recorded_flight import recorded_flight
    from gcs.station.server import recorded_app, serve
    from gcs.vehicle_logs.foreign import is_foreign

    if is_foreign(path):
        raise InputError([f"{path}: not recorded by cordon; use `cordon report`"])
    log = read_log(path)
    print_log_faults(log)
    flight = recorded_flight(log)
    app = recorded_app(flight, tiles=_tiles(options.tiles, flight.mission.origin_deg))
    return _serve(lambda listening, stop: serve(app, access, listening, stop), access, path.name)


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
    serve: "Callable[[socket.socket, asyncio.Event], Awaitable[None]]",
    access: "Access",
    subject: str,
    lose: "Callable[[LostFlight], object]" = lambda _flight: None,
) -> Exit:
    """Serve until Ctrl-C, or until the end of the flight that started this station; `lose` takes its loss."""
    from agents.ports import VehicleRefusedError
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_line, print_problem
    from gcs.signals import relay
    from gcs.station.server import listen
    from gcs.station.station_process import FlightPipe, flight_pipe

    try:
        listening = listen(access)
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    pipe = flight_pipe()
    say = print_line if pipe is None else print_result  # a flight reads it, and says it
    say(f"page of {subject}: {access.url}")

    async def run() -> None:
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        if pipe is not None:
            loop.add_reader(pipe, FlightPipe(pipe, stop.set, lose).read)
        else:
            relay(lambda: loop.call_soon_threadsafe(stop.set))
        await serve(listening, stop)

    asyncio.run(run())
    return Exit.HOLDS
