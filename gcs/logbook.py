"""The log of a command: opened before anything flies, told of afterwards, recovered after a crash."""

from datetime import datetime
from importlib.resources import files
from pathlib import Path
from time import time

from foxglove import Context

from gcs.exits import Exit, InputError
from gcs.flightlog.place import default_path
from gcs.flightlog.recover import examine, recover, recovered_path
from gcs.flightlog.run import run_of
from gcs.flightlog.scene import Scene
from gcs.flightlog.simulation import SimulationRecording
from gcs.flightlog.writer import LogWriter
from gcs.mission import Mission
from gcs.output import STDERR, ReadingProgress


def simulation_recording(
    mission: Mission, path: Path | None, seed: int, duration_s: float
) -> SimulationRecording | None:
    """Return what records a simulated flight, if it is to be recorded; raises InputError."""
    if path is None:
        return None
    run = run_of(mission, mission.ids, seed=seed, source="simulation", speed=1.0, began_s=time(), duration_s=duration_s)
    writer = _opened(path)
    return SimulationRecording(writer, run, Scene(writer.context, mission))


def open_log(path: Path | None, mission: str, only: int | None) -> LogWriter | None:
    """Open the log of a flight; raises InputError when that is not possible where it was told to be.

    Where it was not told, a flight without a log is better than none: that is said, and None returned.
    """
    if path is not None:
        return _opened(path)
    try:
        return LogWriter(default_path(mission, only, datetime.now()), Context())
    except OSError as error:
        _say(f"this flight is not recorded: {error}", "yellow")
        return None


def tell_of_log(writer: LogWriter | None) -> None:
    """Say where the log is, and whether it is whole."""
    if writer is None or writer.path is None:
        return
    if writer.fault:
        _say(f"the log is not whole: {writer.fault}", "red")
    _say(f"log: {writer.path} ({writer.size_bytes / 1e6:.1f} MB)")


def write_layout(path: Path) -> None:
    """Write the layout for viewers; raises InputError when that is not possible, or when the file exists already."""
    text = files("gcs.flightlog").joinpath("cordon-layout.json").read_text(encoding="utf-8")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise InputError([f"--output: {str(path)!r}: {error.strerror or error}"]) from error


def _opened(path: Path) -> LogWriter:
    try:
        return LogWriter(path, Context())
    except FileExistsError as error:
        raise InputError([f"--log: {str(path)!r} exists already: nothing is overwritten"]) from error
    except OSError as error:
        raise InputError([f"--log: {str(path)!r}: {error.strerror or error}"]) from error


def recover_log(path: Path, output: Path | None) -> Exit:
    """`cordon log recover`; raises InputError."""
    target = output or recovered_path(path)
    with ReadingProgress(path) as progress:
        found = examine(path, progress.update)
    if not found.faults:
        _say(f"{path}: it is whole: {found.records} records of {found.seconds:.1f} s; nothing is to be recovered")
        return Exit.HOLDS
    with ReadingProgress(path) as progress:
        recovered = recover(path, target, progress.update)
    _say(f"{target}: {recovered.records} records of {recovered.seconds:.1f} s are recovered; {path} is as it was")
    for fault in recovered.faults:
        _say(f"not whole: {fault}", "yellow")
    return Exit.HOLDS


def _say(text: str, style: str = "") -> None:
    STDERR.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
