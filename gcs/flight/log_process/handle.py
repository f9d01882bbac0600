"""The flying process's handle on the process that writes its log."""

import subprocess
import sys
import threading
from contextlib import suppress
from multiprocessing import Pipe
from pathlib import Path
from typing import NamedTuple

from agents.ports import VehicleRefusedError
from gcs.flight.log_process.frames import CLOSE, FLUSH, Batch
from gcs.mission.mission import Mission
from gcs.viewer.address import Address

BATCH_RECORDS = 50
"""The records of three vehicles in 0.1 s; at 32 vehicles less than the connection's buffer."""
_PROGRAM = "gcs.flight.log_process.program"
_ENDED = "the process that writes it has ended"


class LogRequest(NamedTuple):
    """A log to write: `path` is None for a log that only viewers receive.

    `address` is where viewers may connect, `origins` are the web pages that may connect beside those of Foxglove.
    """

    mission: Mission
    path: Path | None
    address: Address | None = None
    origins: tuple[str, ...] = ()


class Refused(NamedTuple):
    """The log process cannot serve viewers: the reason and the next step."""

    reason: str
    next_step: str


class LogStatus(NamedTuple):
    """The bytes in the file, and why it does not hold the whole flight (empty if it does)."""

    size_bytes: int
    fault: str


class LogProcess:
    """Writes records through another process, which completes the log even if this one is killed.

    Once open it never raises: `fault` is the first error, empty if there was none.
    """

    def __init__(self, request: LogRequest) -> None:
        """Start it; raises OSError when the file cannot be opened, VehicleRefusedError when the address is taken."""
        self.path = request.path
        self._batch = Batch()
        self._failure = ""
        self._connection, theirs = Pipe()
        with theirs:
            command = [sys.executable, "-m", _PROGRAM, str(theirs.fileno())]
            self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)
        self._status = self._opened(request)
        self._listener = threading.Thread(target=self._listen, name="log status", daemon=True)
        self._listener.start()

    def _opened(self, request: LogRequest) -> LogStatus:
        try:
            self._connection.send(request)
            answer = self._connection.recv()
        except (EOFError, OSError) as error:
            answer = OSError("the process that writes the log did not start")
            answer.__cause__ = error
        if isinstance(answer, LogStatus):
            return answer
        self._process.wait()
        if isinstance(answer, Refused):
            raise VehicleRefusedError(*answer)
        raise answer

    @property
    def fault(self) -> str:
        """The reason why the file does not hold the whole flight."""
        return self._failure or self._status.fault

    @property
    def size_bytes(self) -> int:
        """The bytes written to the file, at the last flush."""
        return self._status.size_bytes

    def fail(self, reason: str) -> None:
        """Store the reason why the file will not hold the whole flight; the first one is kept."""
        self._failure = self._failure or reason

    def write(self, vehicle_id: int, number: int, log_time_ns: int, record: object) -> None:
        """Write a vehicle's record, or one of the whole run with vehicle 0."""
        self._batch.add(vehicle_id, number, log_time_ns, record)
        if len(self._batch) == BATCH_RECORDS:
            self._send(self._batch.take())

    def flush(self) -> None:
        """Pass all that has been written to the operating system."""
        self._send(self._batch.take(), FLUSH)

    def close(self) -> None:
        """Complete the file, close it, and wait for the process's end."""
        self._send(self._batch.take(), CLOSE)
        self._listener.join()
        if self._process.wait() != 0:
            self.fail(_ENDED)

    def _send(self, *frames: bytes) -> None:
        try:
            for frame in frames:
                self._connection.send_bytes(frame)
        except OSError:
            self.fail(_ENDED)

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._status = self._connection.recv()
