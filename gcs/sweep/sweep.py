"""Flies a sweep: submits its runs to workers, and keeps the row of each."""

from collections import Counter, deque
from collections.abc import Callable, Collection
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from functools import partial
from time import monotonic
from types import TracebackType
from typing import Protocol, Self

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from gcs.console.terminal import STDERR, print_line
from gcs.sweep.columns import Row
from gcs.sweep.plan import SweepPlan, Tasks
from gcs.sweep.workers import Task, UnlikeWorkerError, Workers, failure, flown

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


TRIES = 3
"""A run during which this many workers died has failed."""
_POLL_S = 0.2


class WorkersError(Exception):
    """The workers cannot continue."""


class Flights(Protocol):
    """The runs of a sweep, as tasks for workers by their indexes."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Task: ...


class PlannedFlights:
    """The runs of a plan."""

    def __init__(self, plan: SweepPlan) -> None:
        self._runs, self._tasks = plan.runs, Tasks(plan)

    def __len__(self) -> int:
        return len(self._runs)

    def __getitem__(self, index: int) -> Task:
        return partial(flown, self._tasks.of(self._runs[index]))


class FinishedRuns(Protocol):
    """The finished runs."""

    @property
    def finished(self) -> Collection[int]:
        """The indexes of the finished runs."""

    def append(self, run: int, row: Row) -> None:
        """Append a finished run; raises OSError if it cannot be written."""


def fly_missing(
    flights: Flights,
    journal: FinishedRuns,
    workers: Workers,
    finished: Callable[[Row], None],
    interrupted: Callable[[], bool],
) -> None:
    """Fly the runs that are not in the journal yet, and call `finished` with the row of each.

    Raises KeyboardInterrupt when `interrupted`, WorkersError if the workers cannot continue, and OSError if the journal
    cannot be written. The journal then holds all finished runs; a second call continues from there.
    """
    waiting = deque(index for index in range(len(flights)) if index not in journal.finished)
    flying: dict[Future[Row], int] = {}
    deaths: Counter[int] = Counter()
    rows: list[tuple[int, Row]] = []
    while waiting or flying or rows:
        while waiting and len(flying) < workers.at_once:
            index = waiting.popleft()
            flying[workers.submit(flights[index])] = index
        for done, row in rows:  # written while the workers fly the next ones
            journal.append(done, row)
            finished(row)
        if interrupted():
            raise KeyboardInterrupt
        rows = []
        for future in wait(flying, _POLL_S, FIRST_COMPLETED).done:
            index = flying.pop(future)
            row_of_run = _row(future, workers)
            deaths[index] += row_of_run is None
            if row_of_run is None and deaths[index] < TRIES:
                waiting.appendleft(index)
            else:
                rows.append((index, row_of_run or failure(f"its worker process died {TRIES} times")))


def _row(future: "Future[Row]", workers: Workers) -> Row | None:
    """Return the row of a run, None if its worker died; raises WorkersError for any other error of the workers."""
    try:
        return future.result()
    except workers.losses:
        return None
    except CancelledError as error:
        raise WorkersError("the scheduler cancelled the runs: it ended, or the connection to it was lost") from error
    except UnlikeWorkerError as error:
        raise WorkersError(str(error)) from error
    except Exception as error:
        raise WorkersError(f"a worker failed: {type(error).__name__}: {error}") from error
