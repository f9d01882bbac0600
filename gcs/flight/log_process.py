"""The flying process's handle on the process that writes its log and serves it to viewers (gcs/flight/log_program.py).

Encoding, drawing and compressing hold the interpreter lock: in the flying process they would delay the control loops.
"""

import subprocess
import sys
import threading
from contextlib import suppress
from math import inf
from multiprocessing import Pipe
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

from msgspec import Raw, msgpack

from gcs.flightlog.records import RUN_TOPICS, VEHICLE_TOPICS
from gcs.mission.mission import Mission
from gcs.viewer.origin_gate import Address

FLUSH, CLOSE = b"flush", b"close"
"""No batch begins like these: a batch is a MessagePack array."""
_KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in (*RUN_TOPICS, *VEHICLE_TOPICS)}


class EncodedRecord(NamedTuple):
    """An encoded record, with its vehicle's id (0: the run's), its number and the time stamp of the log [ns]."""

    vehicle_id: int
    number: int
    log_time_ns: int
    kind: str
    record: Raw


class Batch:
    """Records that are sent together."""

    def __init__(self) -> None:
        self._encoder = msgpack.Encoder()
        self._rows: list[Raw] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, vehicle_id: int, number: int, log_time_ns: int, record: object) -> None:
        """Add a record; raises TypeError for one that cannot be encoded."""
        row = (vehicle_id, number, log_time_ns, type(record).__name__, record)
        self._rows.append(Raw(self._encoder.encode(row)))

    def take(self) -> bytes:
        """Return the frame of all records, and empty the batch."""
        frame = self._encoder.encode(self._rows)
        self._rows.clear()
        return frame


class BatchReader:
    """Reads the frames of batches."""

    def __init__(self) -> None:
        self._rows = msgpack.Decoder(list[EncodedRecord])
        self._records = {name: msgpack.Decoder(kind) for name, kind in _KINDS.items()}

    def rows(self, frame: bytes) -> list[EncodedRecord]:
        """Return the encoded records of a frame."""
        return self._rows.decode(frame)

    def record(self, row: EncodedRecord) -> object:
        """Return a record; raises ValidationError for one that does not fit its type."""
        return self._records[row.kind].decode(row.record)


BATCH_RECORDS, BATCH_RECORDS_MAX = 50, 400
"""The records of a batch: those of three vehicles in 0.1 s, and the most, less than the connection's buffer."""
BATCH_PERIOD_S = 0.02
"""The least time between two batches of fewer records than the most: each gives the interpreter lock away, and gets it
again after five milliseconds or more while other threads hold it all the time, as with 64 vehicles."""
_PROGRAM = "gcs.flight.log_program"
_ENDED = "the process that writes it has ended"


class LogRequest(NamedTuple):
    """A log to write: `path` is None for a log that only viewers receive.

    `address` is where viewers may connect, `origins` are the web pages that may connect beside those of Foxglove.
    """

    mission: Mission
    path: Path | None
    address: Address | None = None
    origins: tuple[str, ...] = ()


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
        self._sent_s = -inf
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
        waiting = len(self._batch)
        if waiting >= BATCH_RECORDS and (waiting >= BATCH_RECORDS_MAX or monotonic() - self._sent_s >= BATCH_PERIOD_S):
            self._send(self._batch.take())
            self._sent_s = monotonic()

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
