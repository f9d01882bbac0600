"""What a command leaves behind: JSON on standard output, people's text on standard error, and the figure."""

import os
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from gcs.compose import formation_reference, ring_reference, verdict_tolerances
from gcs.exits import Exit, InputError
from gcs.figure import METADATA, save_figure
from gcs.live import summary
from gcs.metrics import evaluate
from gcs.mission import Mission
from gcs.record import FlightRecord

STDERR = Console(stderr=True)
_PROGRESS_STEP_S = 1.0


class SimulationProgress:
    """A progress bar on a terminal, silence elsewhere."""

    def __init__(self, mission: str, duration_s: float) -> None:
        self._bar = Progress(
            TextColumn("{task.description}: {task.completed:.0f} of {task.total:.0f} s flown", markup=False),
            BarColumn(),
            TimeRemainingColumn(),
            console=STDERR,
            transient=True,
            disable=not STDERR.is_terminal,
        )
        self._task: TaskID = self._bar.add_task(mission, total=duration_s)
        self._shown_s = 0.0

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, flown_s: float) -> None:
        """Show the mission time flown."""
        if flown_s - self._shown_s >= _PROGRESS_STEP_S:
            self._shown_s = flown_s
            self._bar.update(self._task, completed=flown_s)


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
        print((result if timed else result.untimed()).to_json())
    return Exit.HOLDS if result.all_hold else Exit.VERDICT_FAILED
