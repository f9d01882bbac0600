"""Workers: what flies the runs of a sweep, behind one interface. Those of this computer are processes."""

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
from gcs.sweep.plan import Task
from gcs.sweep.run import flown


class Workers(Protocol):
    """What flies runs, each once or again where its worker died."""

    @property
    def at_once(self) -> int:
        """How many runs to hand over at a time."""

    @property
    def losses(self) -> tuple[type[Exception], ...]:
        """The errors with which the future of a run ends whose worker died."""

    def submit(self, task: Task) -> "Future[Row]":
        """Hand over a run."""

    def close(self) -> None:
        """End at once; runs that are under way are given up."""


class LocalWorkers:
    """Processes of this computer. Each is a pool of its own: one that dies takes its own run along, and no other."""

    losses = (BrokenProcessPool,)

    def __init__(self, count: int) -> None:
        start_forkserver()
        self.at_once = count
        self._context = get_context("forkserver")
        self._workers_end, self._own_end = self._context.Pipe(duplex=False)
        self._pools = [self._pool() for _ in range(count)]
        self._futures: list[Future[Row] | None] = [None] * count

    def submit(self, task: Task) -> "Future[Row]":
        """Hand a run over to a process that has none: no more than `at_once` may be under way."""
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
    """Prepare a worker: Ctrl-C is for the parent, and the worker ends when the parent does, however that ends."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    Thread(target=_end_with, args=(parent,), daemon=True).start()
    gc.freeze()  # modules stay until the end: no full collection needs to traverse them


def _end_with(parent: Connection) -> None:
    """Wait for the parent's end of a pipe that nothing is sent through, and end this process."""
    parent.poll(None)
    os._exit(0)
