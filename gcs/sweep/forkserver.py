"""The process that workers are copies of. It imports what a run needs once, while the sweep is still being planned.

Light: it is started before anything else is imported.
"""

import os
from multiprocessing import forkserver

from gcs.signals import as_they_are

_PRELOADED = ["gcs.sweep.run", "osqp", "cyclopts"]
"""What flies a run, what that imports when it flies, and what the program's main module needs, which each copy runs."""
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""The matrices of a flight are small: more threads only take time from the other workers."""


def start_forkserver() -> None:
    """Start it, unless it runs; it ends with this process."""
    # Processes are started with it. Python would look for modules in the present folder first, where a clone may be.
    os.environ.update(_ONE_THREAD, PYTHONSAFEPATH="1")
    forkserver.set_forkserver_preload(_PRELOADED)
    with as_they_are():
        forkserver.ensure_running()
