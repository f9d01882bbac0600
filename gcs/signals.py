"""Ctrl-C, held back until the program asks for it.

OSQP swallows an interrupt that comes during a solve, and filterpy takes one for a singular matrix: in the control loop
neither may ever see it. Held back before anything starts a thread, it stays pending until it is looked for.
"""

import signal
import threading
from collections.abc import Callable
from contextlib import suppress

ENDING = frozenset({signal.SIGINT, signal.SIGTERM, signal.SIGHUP})


def hold_back() -> None:
    """Keep the signals that end a program pending, in this thread and in all that it will start."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)


def pending() -> bool:
    """Return whether one has come."""
    return bool(ENDING & signal.sigpending())


def relay(ask: Callable[[], object]) -> None:
    """Call `ask` for each one that comes or has come, on a thread of its own, until the process ends."""

    def wait() -> None:
        while True:
            signal.sigwait(ENDING)
            with suppress(RuntimeError):  # the loop that was to be asked has ended: so has what it did
                ask()

    threading.Thread(target=wait, name="signals", daemon=True).start()
