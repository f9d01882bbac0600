"""The workers of a Dask cluster: processes on any computers with the same version of cordon."""

from concurrent.futures import Future
from typing import Any

from gcs.errors import InputError
from gcs.sweep.columns import Row
from gcs.sweep.plan import SweepTask
from gcs.sweep.run import flown

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

    def submit(self, task: SweepTask) -> "Future[Row]":
        """Submit a run to the scheduler."""
        return self._executor.submit(flown, task)  # type: ignore[no-any-return]  # distributed has no types

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
