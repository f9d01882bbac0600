"""Workers that fly the runs of a sweep, behind one interface; on this computer they are processes."""

import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from multiprocessing import active_children, get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from threading import Thread
from types import ModuleType
from typing import Any, Protocol

from agents.control.plan import PlannerFactory
from gcs.errors import InputError
from gcs.flight.simulated import fly_simulated
from gcs.flightlog.run import versions
from gcs.garbage import collect_rarely
from gcs.metrics.metrics import evaluated
from gcs.mission.file import parse_mission
from gcs.mission.mission import Mission
from gcs.mission.planner import ChosenPlanner, named_planner, own_planner
from gcs.signals import ENDING, as_they_are
from gcs.sweep.columns import Row, result_row
from gcs.sweep.forkserver import start_forkserver
from gcs.sweep.plan import SweepTask

Task = Callable[[], Row]
"""What a worker does for one run: it is sent there, and returns the run's row."""


class UnlikeWorkerError(Exception):
    """A worker has other versions of packages that results depend on, or another source of a user's planner."""


def flown(task: SweepTask) -> Row:
    """Fly a run and return its metrics; a failed run is a row with only `error`.

    Raises UnlikeWorkerError if this computer's versions or planners differ from those of the task.
    """
    here = _versions()
    unlike = [
        f"{name} {here.get(name)} instead of {wanted}"
        for name, wanted in task.versions.items()
        if here.get(name) != wanted
    ]
    if unlike:
        raise UnlikeWorkerError(f"a worker has {', '.join(unlike)}")
    try:
        mission = parse_mission(task.mission_text, None, task.profile_texts)
        duration_s = task.duration_s or mission.mission.duration_s
        record = fly_simulated(mission, task.seed, duration_s, _ignore, planner=_factory(mission, task.planners))
        return result_row(evaluated(mission, record))
    except UnlikeWorkerError:
        raise
    except InputError as error:
        return failure("; ".join(error.faults))
    except Exception as error:  # no error of one run ends the sweep
        return failure(f"{type(error).__name__}: {error}")


def _factory(mission: Mission, planners: Mapping[str, str]) -> PlannerFactory | None:
    """Return what makes the planners of a run, None for cordon's; only those of the task are imported.

    Raises UnlikeWorkerError for a planner of another source than where the sweep was planned.
    """
    name = own_planner(mission)
    if not name:
        return None
    wanted = planners[name]
    try:
        planner = _imported(name)
    except InputError as error:
        raise UnlikeWorkerError(f"a worker lacks a planner: {'; '.join(error.faults)}") from error
    if planner.digest != wanted:
        sources = f"source {planner.digest or 'unknown'} instead of {wanted or 'unknown'}"
        raise UnlikeWorkerError(f"a worker has planner {name} of {sources}; it keeps what it imported until it ends")
    return planner.factory


@cache
def _imported(name: str) -> ChosenPlanner:
    """Import a planner once: the digest remains that of the source that runs, whatever becomes of the file."""
    return named_planner(name, allowed=True)


def failure(reason: str) -> Row:
    """Return the row of a run that failed."""
    return {"error": reason}


def _ignore(_time_s: float) -> None:
    """Discard the progress of a run."""


@cache
def _versions() -> dict[str, str]:
    return {each.name: each.version for each in versions()}


MISSING = "--scheduler needs Dask's distributed; install it by: pip install 'cordon-gcs[cluster]'"
CONNECT_S = 10.0


class ClusterWorkers:
    """The workers of a cluster; its scheduler repeats the runs of a dead worker on others."""

    at_once = 1000
    """More than the workers of a cluster; few enough for the missions to fit into the scheduler's memory."""

    def __init__(self, scheduler: str) -> None:
        """Connect; raises InputError without a scheduler."""
        self._client = _connected(scheduler)
        self._executor = self._client.get_executor(pure=False)

    @property
    def losses(self) -> tuple[type[Exception], ...]:
        """The error of a run during which several workers died."""
        from distributed import KilledWorker  # noqa: PLC0415

        return (KilledWorker,)

    @property
    def count(self) -> int:
        """The present number of workers."""
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def submit(self, task: Task) -> "Future[Row]":
        """Submit a run to the scheduler."""
        return self._executor.submit(task)  # type: ignore[no-any-return]  # distributed has no types

    def close(self) -> None:
        """Cancel pending runs and disconnect; the cluster keeps running."""
        self._executor.shutdown(wait=False)
        self._client.close()


def _connected(scheduler: str) -> Any:
    try:
        from distributed import Client  # noqa: PLC0415
    except ImportError as error:
        raise InputError([MISSING]) from error
    try:
        return Client(scheduler, timeout=CONNECT_S)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InputError(
            [f"--scheduler {scheduler}: {error}; start one by `dask scheduler`, which prints its address"]
        ) from error


class Workers(Protocol):
    """Flies runs, each once, and again if its worker died."""

    @property
    def at_once(self) -> int:
        """The number of runs to submit at a time."""

    @property
    def losses(self) -> tuple[type[Exception], ...]:
        """The errors of a future whose worker died."""

    def submit(self, task: Task) -> "Future[Row]":
        """Submit a run."""

    def close(self) -> None:
        """End at once; unfinished runs are cancelled."""


class LocalWorkers:
    """Processes on this computer, each in a separate pool: a process that dies affects only its own run."""

    losses = (BrokenProcessPool,)

    def __init__(self, count: int) -> None:
        start_forkserver()
        self.at_once = count
        self._others = {*active_children()}
        self._context = get_context("forkserver")
        self._workers_end, self._own_end = self._context.Pipe(duplex=False)
        self._pools = [self._pool() for _ in range(count)]
        self._futures: list[Future[Row] | None] = [None] * count

    def submit(self, task: Task) -> "Future[Row]":
        """Submit a run to an idle process: at most `at_once` may be pending."""
        free = next(index for index, future in enumerate(self._futures) if future is None or future.done())
        with as_they_are(), _without_main():
            try:
                future = self._pools[free].submit(task)
            except BrokenProcessPool:
                self._pools[free] = self._pool()
                future = self._pools[free].submit(task)
        self._futures[free] = future
        return future

    def close(self) -> None:
        """End all processes."""
        self._own_end.close()
        for child in active_children():
            if (
                isinstance(child, ForkServerProcess) and child not in self._others
            ):  # one that hangs or is stopped does not end by itself
                child.kill()
        for pool in self._pools:
            pool.shutdown()
        self._workers_end.close()

    def _pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, self._context, _begin, (self._workers_end,))


@contextmanager
def _without_main() -> Iterator[None]:
    """Start processes that do not run the program's main module again: a script needs no guard against that."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _begin(parent: Connection) -> None:
    """Prepare a worker: it ignores Ctrl-C, and ends with its parent."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    Thread(target=_end_with, args=(parent,), daemon=True).start()
    collect_rarely()


def _end_with(parent: Connection) -> None:
    """Wait until the parent's end of an unused pipe closes, and end this process."""
    parent.poll(None)
    os._exit(0)
