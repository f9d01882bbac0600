"""Output of commands: JSON on standard output; progress, figures and questions for people elsewhere."""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from shlex import quote
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from gcs.cli.options import only_file
from gcs.console.summary import show_result, verdict_of
from gcs.console.terminal import STDERR, discard, print_line, printable_lines
from gcs.errors import Exit, InputError
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import formation_reference, ring_references
from gcs.mission.mission import Mission

if TYPE_CHECKING:
    from gcs.flightlog.reader import FlightLog
    from gcs.metrics.result import PlantResult
    from gcs.preflight.findings import Finding
    from gcs.vehicle_logs.vehicle_log import VehicleLog

_PROGRESS_STEP_S = 1.0
_PROGRESS_STEP_SHARE = 0.01
_PROGRESS_STEP_TICKS = 100


class _ProgressBar:
    """A progress bar on a terminal, no output elsewhere; redrawn in steps of `step`, which keeps updates cheap."""

    def __init__(self, label: str, words: str, total: float, step: float) -> None:
        self._bar = Progress(
            TextColumn(f"{{task.description}}: {words}", markup=False),
            BarColumn(),
            TimeRemainingColumn(),
            console=STDERR,
            transient=True,
            disable=not STDERR.is_terminal,
        )
        self._task: TaskID = self._bar.add_task(label, total=total)
        self._step = step
        self._shown = 0.0

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, done: float) -> None:
        """Show how much is done."""
        if done - self._shown >= self._step:
            self._shown = done
            self._bar.update(self._task, completed=done)


class SimulationProgress(_ProgressBar):
    """Progress of a simulated mission [s]."""

    def __init__(self, mission: str, duration_s: float) -> None:
        super().__init__(mission, "{task.completed:.0f} of {task.total:.0f} s flown", duration_s, _PROGRESS_STEP_S)


class ReplayProgress(_ProgressBar):
    """Progress of a replay in ticks."""

    def __init__(self, mission: str, ticks: int) -> None:
        super().__init__(
            mission, "{task.completed:.0f} of {task.total:.0f} ticks replayed", ticks, _PROGRESS_STEP_TICKS
        )


class ReadingProgress(_ProgressBar):
    """Progress of reading a file, as a fraction."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.name, "{task.percentage:.0f} % read", 1.0, _PROGRESS_STEP_SHARE)


class ExportProgress(_ProgressBar):
    """How much of a log is exported, as a share."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.name, "{task.percentage:.0f} % exported", 1.0, _PROGRESS_STEP_SHARE)


class FolderProgress(_ProgressBar):
    """How many of a folder's logs are read, as a share."""

    def __init__(self, folder: Path, logs: int) -> None:
        super().__init__(f"{folder}: {logs} logs", "{task.percentage:.0f} % read", 1.0, _PROGRESS_STEP_SHARE)


class TilesProgress(_ProgressBar):
    """How many of an area's tiles are stored, or not there."""

    def __init__(self, path: Path, tiles: int) -> None:
        super().__init__(path.name, "{task.completed:.0f} of {task.total:.0f} tiles", tiles, 1)


class AnimationProgress(_ProgressBar):
    """How much of an animation is drawn, as a share."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.name, "{task.percentage:.0f} % drawn", 1.0, _PROGRESS_STEP_SHARE)


class IdentifyProgress(_ProgressBar):
    """Progress of an identification, as a fraction."""

    def __init__(self, vehicle: str) -> None:
        super().__init__(vehicle, "{task.percentage:.0f} % identified", 1.0, _PROGRESS_STEP_SHARE)


def check_plot(path: Path | None, number: int | None = None) -> None:
    """Refuse a figure that cannot be drawn or written, before anything flies; raises InputError."""
    from gcs.report.figure import METADATA, PANELS

    if number is not None and number not in PANELS:
        raise InputError([f"--figure: the paper has no figure {number} (figures: {', '.join(map(str, PANELS))})"])
    if number is not None and path is None:
        raise InputError([f"--figure: {number}: no file to plot to; add --plot figure{number}.png"])
    if path is not None:
        check_file("--plot", path, tuple(METADATA))


def check_page(path: Path | None) -> None:
    """Refuse a page that cannot be written, before anything is read; raises InputError."""
    if path is not None:
        check_file("--html", path, (".html", ".htm"))


def check_animation(path: Path | None) -> None:
    """Refuse, before anything is read, an animation that could not be written; raises InputError."""
    from gcs.report.animation import SUFFIXES

    if path is not None:
        check_file("--animate", path, SUFFIXES)


def check_file(option: str, path: Path, suffixes: Sequence[str]) -> None:
    """Refuse an output file that cannot be written, or has another suffix; raises InputError."""
    if path.suffix.lower() not in suffixes:
        raise InputError([f"{option}: {path.name!r} must end in {', '.join(suffixes)}"])
    try:
        only_file(Path, path)
    except ValueError as error:
        raise InputError([f"{option}: {error}"]) from error
    check_folder(option, path.parent)


def check_folder(option: str, folder: Path) -> None:
    """Refuse a folder for output that does not exist or cannot be written to; raises InputError."""
    if not folder.is_dir():
        raise InputError([f"{option}: no folder {str(folder)!r} to write to; next: mkdir -p {quote(str(folder))}"])
    if not os.access(folder, os.W_OK):
        raise InputError([f"{option}: no permission to write to the folder {str(folder)!r}"])


@contextmanager
def writing(option: str, path: Path) -> Iterator[None]:
    """Write an output file inside this context: an OSError becomes an InputError that names the option."""
    try:
        yield
    except OSError as error:
        raise InputError([f"{option}: {path}: {error.strerror or error}"]) from error


def confirmed(question: str) -> bool:
    """Ask on the terminal, and return whether the answer is yes; raises InputError without a terminal."""
    if not (sys.stdin.isatty() and STDERR.is_terminal):
        raise InputError(["--yes: there is no terminal to ask for confirmation; give --yes to confirm"])
    STDERR.print(f"{question} [y/N] ", markup=False, highlight=False, soft_wrap=True, end="")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def print_warning(finding: "Finding", whose: str = "") -> None:
    """Print a finding of a mission that flies nevertheless."""
    about = f"{finding.subject}: " if isinstance(finding.about, int) else ""
    print_line(f"warning: {whose}{about}{finding.found}: {finding.why}; next: {finding.next_step}", "yellow")


def print_log_faults(log: "FlightLog") -> None:
    """Print the faults of a log, and how much of a damaged one was read."""
    for fault in log.faults:
        print_line(f"{log.path}: {fault}", "yellow")
    if log.is_damaged:
        print_line(f"{log.path}: damaged: {log.recovered}; `cordon log recover` writes them to a new log", "red")


def print_notes(logs: "Sequence[VehicleLog]") -> None:
    """Print the faults of vehicles' logs."""
    for log in logs:
        for note in log.notes:
            print_line(f"{log.path}: {note}", "yellow")
    print_damage(logs)


def print_damage(logs: "Sequence[VehicleLog]") -> None:
    """Print which logs are damaged."""
    for path in dict.fromkeys(log.path for log in logs if log.is_damaged):
        print_line(f"{path}: damaged: the result covers only the readable part; copy it from the vehicle again", "red")


def print_result(text: str) -> None:
    """Print to standard output, as printable; a closed pipe (`| head`) is no error.

    Raises InputError if it cannot be written.
    """
    try:
        print(printable_lines(text), flush=True)
    except BrokenPipeError:
        discard(sys.stdout)
    except OSError as error:
        discard(sys.stdout)
        raise InputError([f"standard output: {error.strerror or error}"]) from error


def present(
    mission: Mission,
    record: FlightRecord,
    *,
    json: bool,
    plot: Path | None,
    figure: int | None = None,
    timed: bool = True,
    plants: "tuple[PlantResult, ...] | None" = None,
) -> Exit:
    """Evaluate a flight, show it, and return its verdict; `figure` selects one of the paper's figures to plot."""
    result = replace(show_result(mission, record), plants=plants)
    if plot is not None:
        from gcs.report.figure import save_figure

        with writing("--plot", plot):
            save_figure(record, result, ring_references(mission, record), plot, formation_reference(mission), figure)
        print_line(f"figure: {plot}")
    if json:
        print_result((result if timed else result.untimed()).to_json())
    return verdict_of(result)
