"""The flight recorder: tapes for the cores, and what brings their contents into a log beside the flight.

Writing onto a tape only puts an item into a queue. Encoding and the disk are the business of `drain`, which a thread of
its own calls while something flies: a disk that is slow, full or gone disturbs nobody.
"""

import threading
from collections import deque
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import Self

from agents.outputs import TickOutput
from agents.tape import CoreInput
from gcs.flightlog.records import Decision, recorded
from gcs.flightlog.writer import LogWriter, Picture

CLOSING_TIMEOUT_S = 10.0
DRAIN_PERIOD_S, FLUSH_PERIOD_S = 0.1, 0.8
"""A killed process loses what it did since the last flush, which may be one draining late: less than a second."""
QUEUE_MAX = 100_000
"""Items: minutes of a team's. More wait only for a disk that hangs; what comes then is lost, and its number missing."""


_Item = tuple[int, int, float, object]
"""A vehicle's id (0: the run's), the number and time of the record, and the record or what makes one."""


class Recorder:
    """Takes what the cores of this process do, and writes it when told to."""

    def __init__(
        self,
        writer: LogWriter,
        now_s: Callable[[], float],
        speed: Callable[[], float],
        picture: Picture | None = None,
    ) -> None:
        """Take the log; the clock of the records passes `speed()` times as fast as that of the log's time stamps."""
        self._writer = writer
        self._now_s = now_s
        self._speed = speed
        self._picture = picture
        self._queue: deque[_Item] = deque()
        self._eventful = False

    @property
    def fault(self) -> str:
        """Why the log ends before the flight does, empty if it does not."""
        return self._writer.fault

    def tape(self, vehicle_id: int) -> "VehicleTape":
        """Return the tape of a vehicle's core."""
        return VehicleTape(vehicle_id, self._queue, self._now_s, self._overflow)

    def note(self, vehicle_id: int, number: int, record: object, time_s: float | None = None) -> None:
        """Take a record, of now unless a time is given; never blocks, never raises."""
        self._queue.append((vehicle_id, number, self._now_s() if time_s is None else time_s, record))

    def fail(self, reason: str) -> None:
        """Note why the log will not be whole; the first reason counts."""
        self._writer.fail(reason)

    def drain(self) -> None:
        """Write all that has been taken so far; what people are told of outlives this process from then on."""
        self._drain()
        if self._eventful:
            self._eventful = False
            self._writer.flush()

    def _drain(self) -> None:
        queue, speed = self._queue, self._speed()
        while queue:
            vehicle_id, number, time_s, item = queue.popleft()
            try:
                self._write(vehicle_id, number, round(max(time_s, 0.0) / speed * 1e9), item)
            except Exception as error:  # a bug with one record must not cost the others, and never a flight
                self.fail(f"a {type(item).__name__} could not be written: {_words(error)}")

    def flush(self) -> None:
        """Write all that has been taken so far, so that it outlives this process."""
        self._drain()
        self._eventful = False
        self._writer.flush()

    def close(self) -> None:
        """Write what is left, and complete the log."""
        self._drain()
        self._writer.close()

    def _write(self, vehicle_id: int, number: int, time_ns: int, item: object) -> None:
        record = recorded(item)
        self._eventful |= type(record) is Decision and bool(record.notes)
        self._writer.write(vehicle_id, number, time_ns, record)
        if self._picture is None:
            return
        try:
            self._picture(vehicle_id, time_ns, record)
        except Exception as error:  # a bug in what only viewers need must not cost the log
            self._picture = None
            self.fail(f"what only viewers need ended: {_words(error)}")

    def _overflow(self) -> None:
        self.fail("its disk is too slow: records are missing")


class RecorderThread:
    """Lets a recorder write beside a flight, and makes what it wrote outlive this process: every second, and at once
    after every event. Use it as a context manager.
    """

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="flight recorder", daemon=True)

    def __enter__(self) -> Self:
        """Start."""
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write what is left, and complete the log, unless the disk hangs for seconds."""
        self._ended.set()
        self._thread.join(CLOSING_TIMEOUT_S)
        if self._thread.is_alive():
            self._recorder.fail(f"its disk has not answered for {CLOSING_TIMEOUT_S:g} s: it is not closed")

    def _run(self) -> None:
        try:
            self._record()
        except BaseException as error:  # a bug must be told of, not only end this thread
            self._recorder.fail(f"the recorder ended: {_words(error)}")

    def _record(self) -> None:
        flushed_s = monotonic()
        while not self._ended.wait(DRAIN_PERIOD_S):
            self._recorder.drain()
            if monotonic() - flushed_s >= FLUSH_PERIOD_S:
                self._recorder.flush()
                flushed_s = monotonic()
        self._recorder.close()


class VehicleTape:
    """The tape of one vehicle's core, and what is noted of the vehicle beside it."""

    def __init__(
        self,
        vehicle_id: int,
        queue: deque[_Item],
        now_s: Callable[[], float],
        overflow: Callable[[], None],
    ) -> None:
        self._vehicle_id = vehicle_id
        self._queue = queue
        self._now_s = now_s
        self._overflow = overflow
        self._number = 0

    def write(self, item: CoreInput | TickOutput) -> None:
        """Take the next item; never blocks, never raises."""
        self._number += 1
        queue = self._queue
        if len(queue) < QUEUE_MAX:
            queue.append((self._vehicle_id, self._number, self._now_s(), item))
        else:
            self._overflow()

    def note(self, record: object, time_s: float | None = None) -> None:
        """Take any record, of now unless a time is given."""
        self._number += 1
        if len(self._queue) < QUEUE_MAX:
            time_s = self._now_s() if time_s is None else time_s
            self._queue.append((self._vehicle_id, self._number, time_s, record))
        else:
            self._overflow()


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
