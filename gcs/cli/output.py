"""What a command leaves behind: JSON on standard output, people's text on standard error, and the figure."""

import os
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from gcs.console.live import summary
from gcs.errors import Exit, InputError
from gcs.metrics.metrics import evaluate
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import formation_reference, ring_reference, verdict_tolerances
from gcs.mission.mission import Mission
from gcs.report.figure import METADATA, save_figure


class _Console(Console):
    """A console whose reader may go away: a flight goes on without anybody who looks at it."""

    def on_broken_pipe(self) -> None:
        """Write to nowhere from now on, and end nothing."""
        self.quiet = True
        _to_nowhere(sys.stderr)


STDERR = _Console(stderr=True)
_PROGRESS_STEP_S = 1.0
_PROGRESS_STEP_SHARE = 0.01
_PROGRESS_STEP_TICKS = 100


class _ProgressBar:
    """A progress bar on a terminal, silence elsewhere; it moves by steps of `step`, to spare who reports to it."""

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
    """How much of a mission has been flown [s]."""

    def __init__(self, mission: str, duration_s: float) -> None:
        super().__init__(mission, "{task.completed:.0f} of {task.total:.0f} s flown", duration_s, _PROGRESS_STEP_S)


class ReplayProgress(_ProgressBar):
    """How many ticks of a log have been replayed."""

    def __init__(self, mission: str, ticks: int) -> None:
        super().__init__(
            mission, "{task.completed:.0f} of {task.total:.0f} ticks replayed", ticks, _PROGRESS_STEP_TICKS
        )


class ReadingProgress(_ProgressBar):
    """How much of a file has been read, as a share."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.name, "{task.percentage:.0f} % read", 1.0, _PROGRESS_STEP_SHARE)


class IdentifyProgress(_ProgressBar):
    """How much of an identification is done, as a share."""

    def __init__(self, vehicle: str) -> None:
        super().__init__(vehicle, "{task.percentage:.0f} % identified", 1.0, _PROGRESS_STEP_SHARE)


def check_plot(path: Path | None) -> None:
    """Refuse, before anything flies, a figure that could not be written; raises InputError."""
    if path is None:
        return
    if path.suffix.lower() not in METADATA:
        raise InputError([f"--plot: {path.name!r} must end in {', '.join(METADATA)}"])
    if path.is_dir():
        raise InputError([f"--plot: {str(path)!r} is a folder"])
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise InputError([f"--plot: no folder {str(path.parent)!r} to write into"])


def confirmed(question: str) -> bool:
    """Ask on the terminal, and return whether the answer is yes; raises InputError where there is no terminal."""
    if not (sys.stdin.isatty() and STDERR.is_terminal):
        raise InputError(["--yes: there is no terminal to ask for confirmation on; say --yes to go ahead without"])
    STDERR.print(f"{question} [y/N] ", markup=False, highlight=False, soft_wrap=True, end="")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def print_result(text: str) -> None:
    """Print to standard output; a reader that has read enough (`| head`) and is gone changes nothing."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        _to_nowhere(sys.stdout)


def _to_nowhere(stream: TextIO) -> None:
    """Let a stream that nobody reads end quietly: it is flushed once more when the program ends."""
    with suppress(OSError, ValueError):  # it may be no file
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def present(mission: Mission, record: FlightRecord, *, json: bool, plot: Path | None, timed: bool = True) -> Exit:
    """Evaluate a flight, show it, and return how it went."""
    ring, formation = ring_reference(mission), formation_reference(mission)
    result = evaluate(record, ring, formation, verdict_tolerances(mission))
    STDERR.print(summary(result))
    if plot is not None:
        try:
            save_figure(record, result, ring, plot, formation)
        except OSError as error:
            raise InputError([f"--plot: {plot}: {error.strerror or error}"]) from error
        STDERR.print(f"figure: {plot}", markup=False, highlight=False, soft_wrap=True)
    if json:
        print_result((result if timed else result.untimed()).to_json())
    return Exit.HOLDS if result.all_hold else Exit.VERDICT_FAILED
