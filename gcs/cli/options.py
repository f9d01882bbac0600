"""Options that several verbs share, and functions that resolve their values. Light: `--help` imports this file."""

import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import inf, nan
from pathlib import Path
from stat import S_IFREG, S_ISDIR, S_ISREG
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter
from cyclopts.validators import Number

from gcs.errors import InputError

if TYPE_CHECKING:
    from cyclopts import Token

    from gcs.mission.mission import Mission, MissionVehicle

RESULT = Group("Result")


def only_file(_kind: object, given: object) -> None:
    """Refuse a pipe, a device, a socket or a folder, as a validator of options: reading one may never end."""
    _require(given, "is not a file", folders=False)


def file_or_folder(_kind: object, given: object) -> None:
    """Refuse a pipe, a device or a socket, as a validator of options."""
    _require(given, "is neither a file nor a folder", folders=True)


def _require(given: object, fault: str, *, folders: bool) -> None:
    for path in given if isinstance(given, (list, tuple)) else (given,):
        with suppress(OSError):  # there is none, or who opens it says why not
            mode = path.stat().st_mode if isinstance(path, Path) else S_IFREG
            if not (S_ISREG(mode) or (folders and S_ISDIR(mode))):
                raise ValueError(f"{str(path)!r} {fault}")


MissionName = Annotated[
    str,
    Parameter(help="A bundled mission such as case1 (see `cordon missions`), or a mission file (see `cordon new`)."),
]
RunningMission = Annotated[str, Parameter(help="The mission that the team flies; it holds the team's addresses.")]
Changes = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        negative="",
        show_default=False,
        help="KEY=VALUE: replace a value of the mission, such as encirclement.radius_m=12 or "
        "vehicles[0].profile=px4; may be repeated. Use the same for all that fly, watch or command one team.",
    ),
]
KeyName = Annotated[
    str | None,
    Parameter(help="The holder whose keys are used, such as anna; needed if the mission's key folder has several."),
]
ChecklistDone = Annotated[
    str | None, Parameter(help="Name of the person who has done the mission's checklist, without the operator's page.")
]
AllowPlugins = Annotated[
    bool,
    Parameter(
        negative="",
        help="Run the planner that the mission or the log names, which is code of its own (docs/planners.md); "
        "CORDON_ALLOW_PLUGINS=1 does the same.",
    ),
]
Duration = Annotated[
    float | None,
    Parameter(help="Seconds of mission time to fly, instead of the mission's.", validator=Number(gt=0, lte=86400)),
]
Share = Annotated[float, Parameter(validator=Number(gte=0.0, lte=1.0))]
AS_FAST_AS_POSSIBLE = "max"


def _speed(_kind: object, tokens: "Sequence[Token]") -> float:
    """Return a speed; infinity for one that only the computer limits."""
    text = tokens[0].value
    try:
        speed = inf if text.lower() == AS_FAST_AS_POSSIBLE else float(text)
    except ValueError:
        speed = nan
    if not (speed == inf or 0.1 <= speed <= 50.0):
        raise ValueError(f"{text!r} is neither {AS_FAST_AS_POSSIBLE} nor a number from 0.1 to 50")
    return speed


Speed = Annotated[
    float | None,
    Parameter(
        help="Speed of simulated time, as a multiple of the wall clock's (0.1 to 50), or max: as fast as this computer "
        "can, if every vehicle is a stub.",
        converter=_speed,
    ),
]
Json = Annotated[bool, Parameter(name="--json", negative="", group=RESULT, help="Print the result as one JSON object.")]
Plot = Annotated[
    Path | None,
    Parameter(
        validator=only_file,
        group=RESULT,
        help="Draw the flight, the paper's figures 1 to 6, into a .png, .svg or .pdf.",
    ),
]
FigureNumber = Annotated[
    int | None,
    Parameter(name="--figure", group=RESULT, help="Plot only this figure of the paper, by its number."),
]
Log = Annotated[
    Path | None,
    Parameter(
        validator=only_file, group=RESULT, help="Record the flight to this file (MCAP), which must not exist yet."
    ),
]
Recorded = Annotated[
    bool,
    Parameter(
        name="--recorded",
        negative="--no-log",
        show_default=False,
        group=RESULT,
        help="Whether to record the flight. By default it is recorded in ~/.local/share/cordon/logs.",
    ),
]
ALL_STUBS = "all"
_IDS = re.compile(r"\d+(,\d+)*")


def with_stubs(tokens: Sequence[str]) -> list[str]:
    """Return a command line in which `--sitl` of `fly` has a value: the ids that follow it, or all vehicles.

    No option of cyclopts takes a value or none, wherever it stands.
    """
    given = list(tokens)
    if given[:1] != ["fly"] or "--sitl" not in given:
        return given
    at = given.index("--sitl")
    ids = given[at + 1] if at + 1 < len(given) and _IDS.fullmatch(given[at + 1]) else None
    return [*given[:at], f"--sitl={ids or ALL_STUBS}", *given[at + (1 if ids is None else 2) :]]


def stub_ids(given: str, mission: "Mission") -> tuple[int, ...]:
    """Return the ids of the stub vehicles, by the value of `--sitl`; raises InputError for invalid ids."""
    if given == ALL_STUBS:
        return mission.ids
    if not _IDS.fullmatch(given):
        raise InputError([f"--sitl: {given!r} is not a list of vehicles like 2,3"])
    ids = [int(each) for each in given.split(",")]
    faults = [f"--sitl: the mission has no vehicle {each}" for each in ids if each not in mission.ids]
    faults = [f"{fault} (it has {', '.join(map(str, mission.ids))})" for fault in faults]
    faults += [f"--sitl: vehicle {each} is given twice" for each in sorted({*ids}) if ids.count(each) > 1]
    if faults:
        raise InputError(faults)
    return tuple(ids)


STATION_ADDRESS = "127.0.0.1:8766"
TakeFromPilot = Annotated[
    tuple[int, ...],
    Parameter(
        negative="",
        show_default=False,
        help="Take this vehicle although its flight mode is one that a pilot steers in; may be repeated.",
    ),
]
Leave = Annotated[
    tuple[int, ...],
    Parameter(negative="", show_default=False, help="Leave this vehicle as it is; may be repeated."),
]
TakeWithoutAsking = Annotated[
    bool, Parameter(negative="", help="Take vehicles that are in the air without asking for confirmation.")
]
Station = Annotated[
    bool,
    Parameter(
        negative="",
        group=RESULT,
        help="Serve the operator's page as `cordon station` does: during a flight, or after a simulation.",
    ),
]
StationAddress = Annotated[
    str | None,
    Parameter(group=RESULT, help=f"Address of --station, HOST:PORT, instead of {STATION_ADDRESS}."),
]
TILES_HELP = "map tiles to draw under the scene: a folder Z/X/Y.png (.jpg, .webp), or an .mbtiles file."
Tiles = Annotated[Path | None, Parameter(validator=file_or_folder, help=f"The {TILES_HELP}")]
StationTiles = Annotated[
    Path | None, Parameter(validator=file_or_folder, group=RESULT, help=f"With --station, {TILES_HELP}")
]


def require_station(station: bool, address: str | None, tiles: Path | None) -> None:
    """Raise InputError for options of the page if it is not served."""
    for option, given in (("--station-address", address), ("--station-tiles", tiles)):
        if given and not station:
            raise InputError([f"{option}: it needs --station"])


def loaded_mission(name: str, changes: Sequence[str] = ()) -> "Mission":
    """Return the mission of a name or file, with the values of `--set`; raises InputError."""
    from gcs.mission.file import load_mission
    from gcs.mission.overrides import override

    return load_mission(name, dict(map(override, changes)))


def bus_mission(name: str, changes: Sequence[str] = ()) -> "Mission":
    """Return the mission of a verb that joins the team's bus, with the values of `--set`; warn if it is insecure.

    Raises InputError, also for a bus beyond this computer without `[network.security]`, and for a mission that only
    `cordon sim` flies.
    """
    from gcs.console.terminal import print_line
    from gcs.keys.team_keys import INSECURE, security_faults
    from gcs.mission.simulation import only_simulated

    mission = loaded_mission(name, changes)
    if faults := [*security_faults(mission), *only_simulated(mission)]:
        raise InputError(faults)
    if mission.network.security is not None and mission.network.security.insecure:
        print_line(f"warning: {INSECURE}", "yellow")
    return mission


def running_mission(name: str, changes: Sequence[str] = ()) -> "Mission":
    """Return the mission of a verb that reaches a team in flight: as `bus_mission`, with a vehicle that has joined the
    flight from this computer (`cordon rejoin --add`). Raises InputError.
    """
    from agents.ports import VehicleRefusedError
    from gcs.link.ports import added_text

    mission = bus_mission(name, changes)
    with suppress(InputError, VehicleRefusedError):  # without a folder of claims no vehicle has joined from here
        if (text := added_text(mission)) is not None:
            return mission.parse(text, mission.folder, mission.profile_texts)
    return mission


def require_answer(check: Callable[[], object], *, yes: bool) -> None:
    """Raise InputError where vehicles in the air are to be taken and there is no terminal to ask on.

    It names as well what `check` finds wrong with the mission and the vehicles given: the next try needs both.
    """
    if yes or (sys.stdin.isatty() and sys.stderr.isatty()):
        return
    faults = ["--yes: there is no terminal to ask for confirmation; give --yes to confirm"]
    try:
        check()
    except InputError as error:
        faults = [*error.faults, *faults]
    raise InputError(faults)


def require_known(mission: "Mission", from_pilot: Sequence[int], left: Sequence[int]) -> None:
    """Raise InputError for vehicles of --take-from-pilot and --leave that are not the mission's, or are in both."""
    faults = list[str]()
    for option, ids in (("--take-from-pilot", from_pilot), ("--leave", left)):
        for each in ids:
            try:
                chosen_vehicle(mission, each, option)
            except InputError as error:
                faults += error.faults
    if faults:
        raise InputError(faults)
    if both := {*left} & {*from_pilot}:
        raise InputError([f"--leave: vehicle {each} is also given by --take-from-pilot" for each in sorted(both)])


def chosen_vehicle(mission: "Mission", vehicle_id: int, option: str) -> "MissionVehicle":
    """Return one of a mission's vehicles; raises InputError that names the option."""
    try:
        return mission.vehicle(vehicle_id)
    except KeyError as error:
        ids = ", ".join(map(str, mission.ids))
        raise InputError([f"{option}: the mission has no vehicle {vehicle_id} (it has {ids})"]) from error
