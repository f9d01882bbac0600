"""The operator's page beside a flight: `cordon station` as a process of its own, which ends with the flight.

It can hang, crash or be overloaded without delaying a tick of the flight. It outlives a flight whose process is gone
while its vehicles may be in the air. Imports nothing heavy: the supervisor of a flight starts it.
"""

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from typing import IO

from agents.ports import VehicleRefusedError
from gcs.metrics.ending import LostFlight
from gcs.signals import pending

PIPE_VARIABLE = "CORDON_STATION_PIPE"
"""The environment variable with the number of a pipe's end: the station ends when the pipe is closed."""
START_TIMEOUT_S = 120.0
_END_TIMEOUT_S = 3.0
_POLL_S = 0.2


class StationProcess:
    """A station that runs: `line` has its address, and is empty if it ended at once, with the reason printed."""

    def __init__(self, process: "subprocess.Popen[str]", held: int, line: str) -> None:
        """Take its process, and the pipe's end that keeps it running."""
        self.line = line
        self._process = process
        self._held = held
        self._is_kept = False
        self._interrupted = threading.Event()

    @property
    def kept_open(self) -> Sequence[int]:
        """The pipe's end: the station runs as long as the supervisor or the flying process holds it."""
        return (self._held,)

    @property
    def exit_code(self) -> int:
        """The exit code of a station that ended at once."""
        return self._process.wait()

    def lose(self, flight: LostFlight) -> None:
        """Show a flight whose process is gone, on a page that stays open."""
        with suppress(OSError):  # the station has crashed
            os.write(self._held, f"{json.dumps(asdict(flight))}\n".encode())
            self._is_kept = True

    def interrupt(self) -> None:
        """End the wait for a page that stays open; called on any thread."""
        if self._is_kept:
            self._interrupted.set()

    @property
    def is_kept(self) -> bool:
        """Whether the page stays open."""
        return self._is_kept and self._process.poll() is None

    def wait(self) -> None:
        """Wait until a page that stays open has been left, or the operator interrupts; return at once otherwise."""
        while self.is_kept and not self._interrupted.wait(_POLL_S):
            pass


@contextmanager
def run_station(arguments: Sequence[str]) -> Iterator[StationProcess]:
    """Run a station as long as this context lasts, or this process and those that inherit its `kept_open`.

    Signals must be blocked already. Raises KeyboardInterrupt for one that comes before the station serves, and
    VehicleRefusedError for a station that does not come to serve.
    """
    flight_pipe, held = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", "gcs", "station", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        pass_fds=[flight_pipe],
        env={**os.environ, PIPE_VARIABLE: str(flight_pipe)},
        start_new_session=True,  # Ctrl-C in the flight's terminal lands the vehicles; the page stays open and shows it
    )
    os.close(flight_pipe)
    assert process.stdout is not None
    try:
        yield StationProcess(process, held, _first_line(process.stdout))
    finally:
        os.close(held)
        process.stdout.close()
        try:
            process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()


def _first_line(output: IO[str]) -> str:
    """Return a station's first line, empty if it ended.

    Raises KeyboardInterrupt for a signal, which is held back, and VehicleRefusedError when nothing comes.
    """
    end_s = time.monotonic() + START_TIMEOUT_S
    while not select.select([output], [], [], _POLL_S)[0]:
        if pending():
            raise KeyboardInterrupt
        if time.monotonic() > end_s:
            raise VehicleRefusedError(
                f"the operator's page did not start within {START_TIMEOUT_S:g} s",
                "start it on its own by `cordon station` with the same options, or fly without --station",
            )
    return output.readline().rstrip()


class FlightPipe:
    """The station's end of the pipe: the loss of its flight, and its end."""

    def __init__(self, number: int, end: Callable[[], object], lose: Callable[[LostFlight], object]) -> None:
        self._number = number
        self._end = end
        self._lose = lose

    def read(self) -> None:
        """Take what has arrived: a line about a lost flight, which fits into the pipe's buffer, or the pipe's end."""
        line = os.read(self._number, 65536)
        if not line:
            self._end()
            return
        fields = json.loads(line)
        self._lose(LostFlight(**{**fields, "vehicles": tuple(fields["vehicles"])}))


def flight_pipe() -> int | None:
    """Return the end of the pipe that a flight holds, hidden from other processes; None for a station on its own."""
    number = os.environ.pop(PIPE_VARIABLE, None)
    return None if number is None else int(number)
