"""The process that workers are forked from. It imports the modules of a run once, while the sweep is being planned.

Light: it is started before anything else is imported.
"""

import os
from multiprocessing import forkserver

from gcs.signals import as_they_are

_PRELOADED = ["gcs.sweep.workers", "osqp", "cyclopts"]
"""The module that flies a run, its lazy imports, and those of the program's main module, which each copy runs."""
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""One thread for linear algebra: the matrices of a flight are small, and workers share the cores."""


def start_forkserver() -> None:
    """Start it, unless it runs; it ends with this process."""
    os.environ.update(_ONE_THREAD)  # workers inherit it
    forkserver.set_forkserver_preload(_PRELOADED)
    with as_they_are():
        forkserver.ensure_running()
