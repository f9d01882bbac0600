"""The log of a flight: opened before take-off, reported after it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from time import time

from foxglove import Context

from gcs.console.terminal import STDERR, print_line
from gcs.errors import InputError
from gcs.flightlog.place import default_path
from gcs.flightlog.run import run_of
from gcs.flightlog.simulation import SimulationRecording
from gcs.flightlog.writer import LogWriter
from gcs.mission.mission import Mission
from gcs.viewer.live_server import Address, live_server
from gcs.viewer.scene import Scene


@dataclass(frozen=True, slots=True)
class RecordingOptions:
    """Where a flight is recorded: in the file `path`, in the default folder without one, or not at all.

    `only` is the vehicle whose agent alone this process runs; the default file name holds it. `live_address`
    (HOST:PORT) is where viewers may connect, `live_origins` the web pages that may beside those of Foxglove.
    """

    path: Path | None = None
    recorded: bool = True
    only: int | None = None
    live_address: str | None = None
    live_origins: tuple[str, ...] = ()


def simulation_recording(mission: Mission, path: Path, seed: int, duration_s: float) -> SimulationRecording:
    """Return the recording of a simulated flight; raises InputError."""
    run = run_of(mission, mission.ids, seed=seed, source="simulation", speed=1.0, began_s=time(), duration_s=duration_s)
    writer = _opened(path, Context())
    return SimulationRecording(writer, run, Scene(writer.context, mission))


@contextmanager
def flight_log(options: RecordingOptions, mission: str) -> Iterator[LogWriter | None]:
    """Open the log of a flight and serve it to viewers; None if it is neither recorded nor served.

    Raises InputError when the path or the address cannot be used, VehicleRefusedError when the address is taken.
    Where no path was given, a log that cannot be opened is a warning: the flight goes on unrecorded.
    """
    context = Context()
    if options.live_address is None:
        yield _flight_writer(options, mission, context)
        return
    address = Address.parsed(options.live_address)
    with live_server(address, context, options.live_origins):
        writer = _flight_writer(options, mission, context)
        _report_address(address)
        yield writer or LogWriter(None, context)


def _flight_writer(options: RecordingOptions, mission: str, context: Context) -> LogWriter | None:
    if not options.recorded:
        return None
    if options.path is not None:
        return _opened(options.path, context)
    try:
        return LogWriter(default_path(mission, options.only, datetime.now()), context)
    except OSError as error:
        print_line(f"this flight is not recorded: {error}", "yellow")
        return None


def _report_address(address: Address) -> None:
    STDERR.print(f"live: {address.url} (open it in Foxglove or Lichtblick)", markup=False, highlight=False)
    if not address.is_loopback:
        warning = "any host that reaches this computer can connect as a viewer"
        STDERR.print(warning, style="yellow", markup=False, highlight=False)


def report_log(writer: LogWriter | None) -> None:
    """Print the path of the log, and what it lacks if it is incomplete."""
    if writer is None or writer.path is None:
        return
    if writer.fault:
        print_line(f"the log is incomplete: {writer.fault}", "red")
    print_line(f"log: {writer.path} ({writer.size_bytes / 1e6:.1f} MB)")


def _opened(path: Path, context: Context) -> LogWriter:
    try:
        return LogWriter(path, context)
    except FileExistsError as error:
        raise InputError([f"--log: {str(path)!r} exists already: nothing is overwritten"]) from error
    except OSError as error:
        raise InputError([f"--log: {str(path)!r}: {error.strerror or error}"]) from error
