"""The process that workers are forked from. It imports the modules of a run once, while the sweep is being planned.

Light: it is started before anything else is imported.
"""

import os
from multiprocessing import forkserver

from gcs.signals import as_they_are

_PRELOADED = ["gcs.sweep.workers", "osqp"]
"""The module that flies a run, and its lazy imports."""
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""One thread for linear algebra: the matrices of a flight are small, and workers share the cores."""


def start_forkserver() -> None:
    """Start it, unless it runs; it ends with this process."""
    given = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)  # workers inherit it
    forkserver.set_forkserver_preload(_PRELOADED)
    try:
        with as_they_are():
            forkserver.ensure_running()
    finally:
        for name, value in given.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
