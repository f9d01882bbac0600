"""The log of a flight: opened before take-off, reported after it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from time import time

from foxglove import Context

from gcs.console.terminal import STDERR, print_line
from gcs.errors import InputError
from gcs.flight.log_process import LogProcess, LogRequest
from gcs.flightlog.recorder import SimulationRecording
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.keys.private_files import FOLDER_MODE
from gcs.mission.mission import Mission
from gcs.mission.planner import ChosenPlanner
from gcs.viewer.origin_gate import Address
from gcs.viewer.scene import Scene

_TRIES = 10
FOLDER_VARIABLE = "CORDON_LOGS"
"""The environment variable that names the folder of logs, in place of the default."""


def log_folder() -> Path:
    """Return the default folder of logs; raises OSError without a home folder."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if folder:
        return Path(folder)
    shared = os.environ.get("XDG_DATA_HOME")
    try:
        return Path(shared or Path.home() / ".local" / "share") / "cordon" / "logs"
    except RuntimeError as error:
        raise OSError(f"there is no home folder; set {FOLDER_VARIABLE} to a folder for logs") from error


def default_path(mission: str, only: int | None, now: datetime) -> Path:
    """Return the path of a log that begins now, by date and mission; raises OSError without a home folder."""
    folder = log_folder()
    folder.mkdir(FOLDER_MODE, parents=True, exist_ok=True)
    name = "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in mission)
    vehicle = "" if only is None else f"-vehicle{only}"
    return next(path for path in _numbered(folder, f"{now:%Y-%m-%d_%H-%M-%S}-{name}{vehicle}") if not path.exists())


def _numbered(folder: Path, stem: str) -> Iterator[Path]:
    yield folder / f"{stem}.mcap"
    number = 2
    while True:
        yield folder / f"{stem}-{number}.mcap"
        number += 1


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """Where a flight is recorded: in the file `path`, in the default folder without one, or not at all.

    `only` is the only vehicle whose agent this process runs; the default file name contains it. `live_address`
    (HOST:PORT) is where viewers may connect, `live_origins` are the web pages that may connect beside Foxglove's.
    """

    path: Path | None = None
    recorded: bool = True
    only: int | None = None
    live_address: str | None = None
    live_origins: tuple[str, ...] = ()


def flight_log(options: RecordingOptions, mission: Mission) -> LogProcess | None:
    """Open the log of a flight and serve it to viewers; return None if it is neither recorded nor served.

    Raises InputError when the path or the address cannot be used, VehicleRefusedError when the address is taken.
    If no path was given, a log that cannot be opened is a warning: the flight continues without a log.
    """
    address = None if options.live_address is None else Address.parsed(options.live_address)
    log = _recorded(LogRequest(mission, options.path, address, options.live_origins), options)
    if address is None:
        return log
    _report_address(address)
    return log or LogProcess(LogRequest(mission, None, address, options.live_origins))


def _recorded(request: LogRequest, options: RecordingOptions) -> LogProcess | None:
    if not options.recorded:
        return None
    if request.path is not None:
        with log_input_errors(request.path, "--log"):
            return LogProcess(request)
    error: OSError | None = None
    for _ in range(_TRIES):
        try:
            path = default_path(request.mission.mission.name, options.only, datetime.now())
            return LogProcess(request._replace(path=path))
        except FileExistsError as taken:  # another flight began in this moment
            error = taken
        except OSError as failed:
            error = failed
            break
    print_line(f"this flight is not recorded: {error}", "yellow")
    return None


def _report_address(address: Address) -> None:
    STDERR.print(f"live: {address.url} (open it in Foxglove or Lichtblick)", markup=False, highlight=False)
    if not address.is_loopback:
        warning = "any host that reaches this computer can connect as a viewer"
        STDERR.print(warning, style="yellow", markup=False, highlight=False)


def report_log(log: LogProcess | LogWriter | None) -> None:
    """Print the path of the log, and what it lacks if it is incomplete."""
    if log is None or log.path is None:
        return
    if log.fault:
        print_line(f"the log is incomplete: {log.fault}", "red")
    print_line(f"log: {log.path} ({log.size_bytes / 1e6:.1f} MB)")


@contextmanager
def log_input_errors(path: Path, named_by: str) -> Iterator[None]:
    """Turn errors of opening the log that the user named by an option or an argument into InputError."""
    try:
        yield
    except FileExistsError as error:
        raise InputError([f"{named_by}: {str(path)!r} exists already, and is not overwritten; name another"]) from error
    except OSError as error:
        raise InputError([f"{named_by}: {str(path)!r}: {error.strerror or error}"]) from error


def simulation_recording(
    mission: Mission,
    path: Path,
    seed: int,
    duration_s: float,
    named_by: str,
    planner: ChosenPlanner | None = None,
) -> SimulationRecording:
    """Return the recording of a simulated flight; raises InputError with the option or argument that named the log."""
    run = run_of(
        mission,
        mission.ids,
        seed=seed,
        source="simulation",
        speed=1.0,
        began_s=time(),
        duration_s=duration_s,
        planner=planner,
    )
    context = Context()
    with log_input_errors(path, named_by):
        return SimulationRecording(LogWriter(path, context, Scene(context, mission)), run)
