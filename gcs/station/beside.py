"""The operator's page beside a flight: `cordon station` as a process of its own, which ends with the flight.

It can hang, crash or be overloaded without delaying a tick of the flight. Imports nothing heavy: the supervisor of a
flight starts it.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

LIFELINE_VARIABLE = "CORDON_STATION_LIFELINE"
"""The environment variable with the number of a pipe's end: the station ends when the pipe is closed."""
_END_TIMEOUT_S = 3.0


@contextmanager
def station_beside(arguments: Sequence[str]) -> Iterator[tuple[str, int | None]]:
    """Run a station as long as this context, or this process, lasts.

    Yield the line with the page's address and None, or without a page the exit code of the station, which printed why.
    """
    lifeline, held = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", "gcs", "station", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        pass_fds=[lifeline],
        env={**os.environ, LIFELINE_VARIABLE: str(lifeline)},
        start_new_session=True,  # Ctrl-C in the flight's terminal lands the vehicles; the page stays open and shows it
    )
    os.close(lifeline)
    assert process.stdout is not None
    try:
        line = process.stdout.readline().rstrip()
        yield line, None if line else process.wait()
    finally:
        os.close(held)
        process.stdout.close()
        try:
            process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()


def lifeline() -> int | None:
    """Return the end of the pipe that a flight holds, hidden from other processes; None for a station on its own."""
    number = os.environ.pop(LIFELINE_VARIABLE, None)
    return None if number is None else int(number)
