"""The log of a command: opened before anything flies, told of afterwards."""

from datetime import datetime
from pathlib import Path
from time import time

from foxglove import Context

from gcs.exits import InputError
from gcs.flightlog.place import default_path
from gcs.flightlog.run import run_of
from gcs.flightlog.simulation import SimulationRecording
from gcs.flightlog.writer import LogWriter
from gcs.mission import Mission
from gcs.output import STDERR


def simulation_recording(
    mission: Mission, path: Path | None, seed: int, duration_s: float
) -> SimulationRecording | None:
    """Return what records a simulated flight, if it is to be recorded; raises InputError."""
    if path is None:
        return None
    run = run_of(mission, mission.ids, seed=seed, source="simulation", speed=1.0, began_s=time(), duration_s=duration_s)
    return SimulationRecording(_opened(path), run)


def open_log(path: Path | None, mission: str, only: int | None) -> LogWriter | None:
    """Open the log of a flight; raises InputError when that is not possible where it was told to be.

    Where it was not told, a flight without a log is better than none: that is said, and None returned.
    """
    if path is not None:
        return _opened(path)
    try:
        return LogWriter(default_path(mission, only, datetime.now()), Context())
    except OSError as error:
        STDERR.print(f"this flight is not recorded: {error}", style="yellow", markup=False, highlight=False)
        return None


def tell_of_log(writer: LogWriter | None) -> None:
    """Say where the log is, and whether it is whole."""
    if writer is None or writer.path is None:
        return
    if writer.fault:
        STDERR.print(f"the log is not whole: {writer.fault}", style="red", markup=False, highlight=False)
    STDERR.print(
        f"log: {writer.path} ({writer.size_bytes / 1e6:.1f} MB)", markup=False, highlight=False, soft_wrap=True
    )


def _opened(path: Path) -> LogWriter:
    if path.exists():
        raise InputError([f"--log: {str(path)!r} exists already: nothing is overwritten"])
    try:
        return LogWriter(path, Context())
    except OSError as error:
        raise InputError([f"--log: {str(path)!r}: {error.strerror or error}"]) from error
