"""Ctrl-C, blocked until the program polls for it.

OSQP discards an interrupt during a solve, and filterpy treats one as a singular matrix: neither may receive it in the
control loop. A signal that is blocked before the first thread starts stays pending until the program polls for it.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

ENDING = frozenset({signal.SIGINT, signal.SIGTERM, signal.SIGHUP})


def hold_back() -> None:
    """Block the signals that end a program, in this thread and in all threads that it starts from now on."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)


def pending() -> bool:
    """Return whether one is pending."""
    return bool(ENDING & signal.sigpending())


@contextmanager
def as_they_are() -> Iterator[None]:
    """Restore the blocked signals after this context: the first process of multiprocessing unblocks signals."""
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def relay(ask: Callable[[], object]) -> None:
    """Call `ask` for each pending and each future signal, on a thread of its own, until the process ends."""

    def wait() -> None:
        while True:
            signal.sigwait(ENDING)
            with suppress(RuntimeError):  # the event loop is closed: nothing to stop
                ask()

    threading.Thread(target=wait, name="signals", daemon=True).start()
