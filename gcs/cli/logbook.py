"""The log of a command: opened before anything flies, told of afterwards."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from time import time

from foxglove import Context

from gcs.cli.output import STDERR
from gcs.errors import InputError
from gcs.flightlog.place import default_path
from gcs.flightlog.run import run_of
from gcs.flightlog.simulation import SimulationRecording
from gcs.flightlog.writer import LogWriter
from gcs.mission.mission import Mission
from gcs.viewer.onlookers import Address, onlookers
from gcs.viewer.scene import Scene


def simulation_recording(
    mission: Mission, path: Path | None, seed: int, duration_s: float
) -> SimulationRecording | None:
    """Return what records a simulated flight, if it is to be recorded; raises InputError."""
    if path is None:
        return None
    run = run_of(mission, mission.ids, seed=seed, source="simulation", speed=1.0, began_s=time(), duration_s=duration_s)
    writer = _opened(path, Context())
    return SimulationRecording(writer, run, Scene(writer.context, mission))


@contextmanager
def flight_log(
    path: Path | None, mission: str, only: int | None, *, recorded: bool, live: str | None
) -> Iterator[LogWriter | None]:
    """Open the log of a flight, and show it at the address `live`; None if it is neither recorded nor shown.

    Raises InputError when the log cannot be where it was told to be, or the address is none; VehicleRefusedError when
    that is taken. Where nobody told, a flight without a log is better than none: that is said.
    """
    context = Context()
    if live is None:
        yield _flight_writer(path, mission, only, context) if recorded else None
        return
    address = Address.parsed(live)
    with onlookers(address, context):
        writer = _flight_writer(path, mission, only, context) if recorded else None
        _tell_of_address(address)
        yield writer or LogWriter(None, context)


def _flight_writer(path: Path | None, mission: str, only: int | None, context: Context) -> LogWriter | None:
    if path is not None:
        return _opened(path, context)
    try:
        return LogWriter(default_path(mission, only, datetime.now()), context)
    except OSError as error:
        _say(f"this flight is not recorded: {error}", "yellow")
        return None


def _tell_of_address(address: Address) -> None:
    STDERR.print(f"live: {address.url} (open it in Foxglove or Lichtblick)", markup=False, highlight=False)
    if not address.is_loopback:
        STDERR.print("whoever reaches this computer can look on", style="yellow", markup=False, highlight=False)


def tell_of_log(writer: LogWriter | None) -> None:
    """Say where the log is, and whether it is whole."""
    if writer is None or writer.path is None:
        return
    if writer.fault:
        _say(f"the log is not whole: {writer.fault}", "red")
    _say(f"log: {writer.path} ({writer.size_bytes / 1e6:.1f} MB)")


def _opened(path: Path, context: Context) -> LogWriter:
    try:
        return LogWriter(path, context)
    except FileExistsError as error:
        raise InputError([f"--log: {str(path)!r} exists already: nothing is overwritten"]) from error
    except OSError as error:
        raise InputError([f"--log: {str(path)!r}: {error.strerror or error}"]) from error


def _say(text: str, style: str = "") -> None:
    STDERR.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
