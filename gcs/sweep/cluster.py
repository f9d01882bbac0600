"""The workers of a Dask cluster: any number of processes on any computers that have this version of cordon."""

from concurrent.futures import Future
from typing import Any

from gcs.errors import InputError
from gcs.sweep.columns import Row
from gcs.sweep.plan import Task
from gcs.sweep.run import flown

MISSING = "--scheduler needs Dask's distributed; install it by: pip install 'cordon-gcs[cluster]'"
CONNECT_S = 10.0


class ClusterWorkers:
    """The workers of a cluster; its scheduler gives the runs of one that dies to the others."""

    at_once = 1000
    """More than a cluster has workers, and few enough for their missions to be small beside the scheduler's memory."""

    def __init__(self, scheduler: str) -> None:
        """Connect; raises InputError where there is no scheduler."""
        self._client = _connected(scheduler)
        self._executor = self._client.get_executor(pure=False)

    @property
    def losses(self) -> tuple[type[Exception], ...]:
        """The error of a run under which several workers died."""
        from distributed import KilledWorker  # noqa: PLC0415

        return (KilledWorker,)

    @property
    def count(self) -> int:
        """How many workers the cluster has now."""
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def submit(self, task: Task) -> "Future[Row]":
        """Hand a run over to the scheduler."""
        return self._executor.submit(flown, task)  # type: ignore[no-any-return]  # distributed has no types

    def close(self) -> None:
        """Cancel what is under way and disconnect; the cluster stays."""
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
