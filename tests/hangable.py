"""`cordon`, which fails at a signal: by a held interpreter lock, a blocked event loop, or an end all of a sudden.

`python -m tests.hangable fly ...` starts its flying process in the same way. That one writes its process id into the
file that HANGABLE_PID_FILE names.
"""

import ctypes
import os
import signal
import time
from pathlib import Path

from gcs.cli import main
from gcs.supervision import LIFELINE

PID_FILE = "HANGABLE_PID_FILE"
HOLD_THE_LOCK, BLOCK_THE_LOOP, EXIT = signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM
HANG_S = 6


def _hold_the_lock(*_: object) -> None:
    ctypes.PyDLL(None).sleep(HANG_S)  # unlike CDLL, this keeps the lock: no thread of Python runs


def _block_the_loop(*_: object) -> None:
    time.sleep(HANG_S)  # signal handlers run in the main thread, which is the event loop's


def _exit(*_: object) -> None:
    os._exit(0)


if __name__ == "__main__":
    signal.signal(HOLD_THE_LOCK, _hold_the_lock)
    signal.signal(BLOCK_THE_LOOP, _block_the_loop)
    signal.signal(EXIT, _exit)
    if LIFELINE in os.environ:
        Path(os.environ[PID_FILE]).write_text(str(os.getpid()), encoding="utf-8")
    main()
