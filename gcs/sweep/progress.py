"""Progress of `cordon sweep`: a bar on a terminal, lines elsewhere."""

from time import monotonic
from types import TracebackType
from typing import Self

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from gcs.console.terminal import STDERR, print_line

LINE_EVERY_S = 10.0


class SweepProgress:
    """The number of finished runs, and the remaining time."""

    def __init__(self, runs: int) -> None:
        self._runs = runs
        self._flown = 0
        self._failed = 0
        self._began_s = self._printed_s = monotonic()
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeRemainingColumn(),
            console=STDERR,
            transient=True,
            refresh_per_second=2,
            disable=not STDERR.is_terminal,
        )
        self._task = self._bar.add_task(self._text(), total=runs)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def add(self, *, failed: bool) -> None:
        """Count a finished run."""
        self._flown += 1
        self._failed += failed
        self._bar.update(self._task, completed=self._flown, description=self._text())
        if not STDERR.is_terminal and monotonic() - self._printed_s >= LINE_EVERY_S:
            self._printed_s = monotonic()
            left_s = (self._printed_s - self._began_s) * (self._runs / self._flown - 1.0)
            print_line(f"{self._text()}, about {left_s:.0f} s left")

    def _text(self) -> str:
        failed = f", {self._failed} failed" if self._failed else ""
        return f"{self._flown} of {self._runs} runs flown{failed}"
