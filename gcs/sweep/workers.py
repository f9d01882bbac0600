"""Workers that fly the runs of a sweep, behind one interface; on this computer they are processes."""

import gc
import os
import signal
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import Protocol

from gcs.signals import ENDING, as_they_are
from gcs.sweep.columns import Row
from gcs.sweep.forkserver import start_forkserver
from gcs.sweep.plan import SweepTask
from gcs.sweep.run import flown


class Workers(Protocol):
    """Flies runs, each once, and again if its worker died."""

    @property
    def at_once(self) -> int:
        """The number of runs to submit at a time."""

    @property
    def losses(self) -> tuple[type[Exception], ...]:
        """The errors of a future whose worker died."""

    def submit(self, task: SweepTask) -> "Future[Row]":
        """Submit a run."""

    def close(self) -> None:
        """End at once; unfinished runs are cancelled."""


class LocalWorkers:
    """Processes on this computer, each in a separate pool: a process that dies affects only its own run."""

    losses = (BrokenProcessPool,)

    def __init__(self, count: int) -> None:
        start_forkserver()
        self.at_once = count
        self._context = get_context("forkserver")
        self._workers_end, self._own_end = self._context.Pipe(duplex=False)
        self._pools = [self._pool() for _ in range(count)]
        self._futures: list[Future[Row] | None] = [None] * count

    def submit(self, task: SweepTask) -> "Future[Row]":
        """Submit a run to an idle process: at most `at_once` may be pending."""
        free = next(index for index, future in enumerate(self._futures) if future is None or future.done())
        with as_they_are():
            try:
                future = self._pools[free].submit(flown, task)
            except BrokenProcessPool:
                self._pools[free] = self._pool()
                future = self._pools[free].submit(flown, task)
        self._futures[free] = future
        return future

    def close(self) -> None:
        """End all processes."""
        self._own_end.close()
        for pool in self._pools:
            pool.shutdown()
        self._workers_end.close()

    def _pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, self._context, _begin, (self._workers_end,))


def _begin(parent: Connection) -> None:
    """Prepare a worker: it ignores Ctrl-C, and ends with its parent."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    Thread(target=_end_with, args=(parent,), daemon=True).start()
    gc.freeze()  # modules live until the end: collections need not traverse them


def _end_with(parent: Connection) -> None:
    """Wait until the parent's end of an unused pipe closes, and end this process."""
    parent.poll(None)
    os._exit(0)
