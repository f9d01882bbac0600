"""`python -m gcs` is `cordon`."""

import os
import sys
from contextlib import suppress

_ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - pathlib costs 10 ms


def main() -> None:
    """Run the command line; neither it nor its processes import modules of the current folder."""
    leave_current_folder()
    # OpenBLAS, as numpy is imported, would start threads that do not block Ctrl-C, which then interrupts the main one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from gcs.cli import main as run  # noqa: PLC0415 - not before the current folder is left

    run()


def leave_current_folder() -> None:
    """Remove the current folder from Python's path, here and in all processes that this one starts.

    A mission's folder may come from elsewhere, and hold modules with the names of others. `python -m` looks there
    first, and so do the processes of multiprocessing. Sources run from their own folder stay on the path.
    """
    with suppress(OSError):  # the folder may have been removed
        here = os.getcwd()  # noqa: PTH109
        if not sys.flags.safe_path and sys.path[0] in ("", here):
            if os.path.realpath(here) == _ROOT:
                os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
            else:
                del sys.path[0]
    os.environ["PYTHONSAFEPATH"] = "1"


if __name__ == "__main__":
    main()
