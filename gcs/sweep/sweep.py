"""Flies a sweep: submits its runs to workers, and writes each row to the journal."""

from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait

from gcs.sweep.columns import Row
from gcs.sweep.journal import SweepJournal
from gcs.sweep.plan import SweepPlan, SweepRun, Tasks
from gcs.sweep.run import UnlikeWorkerError, failure
from gcs.sweep.workers import Workers

TRIES = 3
"""A run during which this many workers died has failed."""
_POLL_S = 0.2


class WorkersError(Exception):
    """The workers cannot continue."""


def fly_missing(
    plan: SweepPlan,
    journal: SweepJournal,
    workers: Workers,
    finished: Callable[[Row], None],
    interrupted: Callable[[], bool],
) -> None:
    """Fly the runs that are not in the journal yet, and call `finished` with the row of each.

    Raises KeyboardInterrupt when `interrupted`, WorkersError if the workers cannot continue, and OSError if the journal
    cannot be written. The journal then holds all finished runs; a second call continues from there.
    """
    waiting = deque(run for run in plan.runs if run.index not in journal.rows)
    tasks = Tasks(plan)
    flying: dict[Future[Row], SweepRun] = {}
    deaths: Counter[int] = Counter()
    rows: list[tuple[int, Row]] = []
    while waiting or flying or rows:
        while waiting and len(flying) < workers.at_once:
            run = waiting.popleft()
            flying[workers.submit(tasks.of(run))] = run
        for index, row in rows:  # written while the workers fly the next ones
            journal.append(index, row)
            finished(row)
        if interrupted():
            raise KeyboardInterrupt
        rows = []
        for future in wait(flying, _POLL_S, FIRST_COMPLETED).done:
            run = flying.pop(future)
            flown = _row(future, workers)
            deaths[run.index] += flown is None
            if flown is None and deaths[run.index] < TRIES:
                waiting.appendleft(run)
            else:
                rows.append((run.index, flown or failure(f"its worker process died {TRIES} times")))


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
