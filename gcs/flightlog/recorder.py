"""The flight recorder: recorders of the cores, and the writing of their records to a log.

A core's recorder only appends to a queue. `drain` hands the records to a writer, in a thread of its own during a
flight: a slow, full or missing disk does not affect the flight.
"""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from time import monotonic, sleep
from typing import Protocol, Self

from agents.control.plan import PlannerFactory
from agents.core import VehicleCore
from agents.inputs import CoreInput, Message
from agents.outputs import TickOutput
from agents.recording import RecordedCore
from agents.settings.config import AgentConfig
from agents.team.codec import encode
from agents.team.messages import BusMessage, OperatorCommand
from gcs.flightlog.audit import AuditEntry, AuditHead, AuditTrail
from gcs.flightlog.records import Carried, Cost, Decision, Run, RunEnd, Taken, TargetTruth, Truth, VehicleEnd, recorded
from gcs.flightlog.writer import LogWriter
from gcs.metrics.ending import VehicleEnding
from sitl.simulation.simulation import SimulatedFlight

CLOSING_TIMEOUT_S = 10.0
DRAIN_PERIOD_S, FLUSH_PERIOD_S = 0.1, 0.8
"""A killed process loses the records since the last flush, which may be late by one drain: less than a second's."""
QUEUE_MAX = 100_000
"""Items, several minutes of a team. The queue is full only if the disk hangs; further items are lost and detected."""
SLICE_ITEMS, SLICE_PAUSE_S = 25, 2e-4
"""The thread pauses after this many items: a control loop that waits for the interpreter lock gets it within a
millisecond; the interpreter itself would switch threads after five."""
BACKLOG_SHARE = 20
"""A slice is at least this part of what waits: while the lock is held all the time, the thread gets it rarely, once in
five milliseconds, and writes as much as has come since. Otherwise what waits grows by megabytes a second until it is
lost."""
TOGETHER_MAX = 256
"""Messages in one record."""
CARRIED_KEPT = 2048
"""Messages whose numbers are kept, 4 kB each: all cores receive a message within a tick, this covers seconds of 64."""

_Item = tuple[int, int, float, object]
"""A vehicle's id (0: the run), the number and time of the record, and the record or the item that becomes one."""


class RecordWriter(Protocol):
    """The recorder's output: the log itself, or the process that writes it."""

    @property
    def fault(self) -> str:
        """The reason why the log does not hold the whole flight, empty if it does."""

    def fail(self, reason: str) -> None:
        """Store the reason why the log will not hold the whole flight; the first one is kept."""

    def write(self, vehicle_id: int, number: int, log_time_ns: int, record: object) -> None:
        """Write a vehicle's record, or one of the whole run with vehicle 0."""

    def flush(self) -> None:
        """Pass all that has been written to the operating system."""

    def close(self) -> None:
        """Complete the log."""


class Recorder:
    """Collects the records of this process' cores and writes them."""

    def __init__(
        self,
        writer: RecordWriter,
        now_s: Callable[[], float],
        speed: Callable[[], float],
        audit: AuditTrail | None = None,
    ) -> None:
        """Take the log; the records' clock runs `speed()` times as fast as that of the log's time stamps.

        `audit` makes the entries of the audit log; None for a log without an audit log.
        """
        self._audit = audit
        self.head: AuditHead | None = None
        """The head of the audit log at the last flush: what a killed process does not lose."""
        self._writer = writer
        self._now_s = now_s
        self._speed = speed
        self._queue: deque[_Item] = deque()
        self._vehicles: list[VehicleRecorder] = []
        self._carried = _CarriedMessages()
        self._eventful = False

    @property
    def fault(self) -> str:
        """The reason why the log ends before the flight does, empty if it does not."""
        return self._writer.fault

    def vehicle(self, vehicle_id: int) -> "VehicleRecorder":
        """Return the recorder of a vehicle's core."""
        recorder = VehicleRecorder(vehicle_id, self._queue, self._now_s, self._overflow)
        self._vehicles.append(recorder)
        return recorder

    def note(self, vehicle_id: int, number: int, record: object, time_s: float | None = None) -> None:
        """Add a record, with the present time by default; never blocks, never raises."""
        self._queue.append((vehicle_id, number, self._now_s() if time_s is None else time_s, record))

    def fail(self, reason: str) -> None:
        """Store the reason why the log will be incomplete; the first one is kept."""
        self._writer.fail(reason)

    def drain(self, most: int = QUEUE_MAX) -> bool:
        """Write up to `most` waiting records, and flush after a decision with notes; return whether some still wait."""
        self._drain(most)
        if self._eventful:
            self._flush()
        return bool(self._queue)

    def drain_slice(self) -> bool:
        """Write as many waiting records as the interpreter lock may be held for; return whether some still wait."""
        return self.drain(max(SLICE_ITEMS, len(self._queue) // BACKLOG_SHARE))

    def _drain(self, most: int = QUEUE_MAX) -> None:
        queue, speed = self._queue, self._speed()
        for _ in range(min(most, len(queue))):
            vehicle_id, number, time_s, item = queue.popleft()
            try:
                self._write(vehicle_id, number, time_s, round(max(time_s, 0.0) / speed * 1e9), item)
            except Exception as error:  # a bug with one record must not lose the others, nor end the flight
                self.fail(f"a {type(item).__name__} could not be written: {_error_text(error)}")

    def flush(self) -> None:
        """Write and flush all records so far, so that they survive this process."""
        self._drain()
        self._flush()

    def _flush(self) -> None:
        self._eventful = False
        head = None if self._audit is None else self._audit.head(self._now_s())
        self._writer.flush()
        self.head = head

    def close(self) -> None:
        """Write the remaining records and close the log."""
        for recorder in self._vehicles:
            recorder.end()
        self._drain()
        if self._audit is not None:
            self.note(0, 0, AuditEntry(self._now_s(), "closed", 0, "", "", "", 0, "", "", ""))
            self._drain()
        self._writer.close()

    def _write(self, vehicle_id: int, number: int, time_s: float, time_ns: int, item: object) -> None:
        if not isinstance(item, AuditEntry):
            record = self._taken(time_ns, item) if isinstance(item, list) else recorded(item)
            self._eventful |= type(record) is Decision and bool(record.notes)
            self._writer.write(vehicle_id, number, time_ns, record)
        if self._audit is not None:
            for each in _commands(item) if isinstance(item, list) else (item,):
                for entry in self._audit.take(vehicle_id, time_s, each):
                    self._writer.write(0, 0, time_ns, entry)

    def _taken(self, time_ns: int, messages: list[Message]) -> Taken:
        """Return the record of messages that a core received; a message new to all cores is written first."""
        places = []
        for each in messages:
            place, is_new = self._carried.place(each.message)
            if is_new:
                self._writer.write(0, place, time_ns, Carried(encode(each.message)))
            places.append(place)
        return Taken(tuple(places), tuple([each.now_s for each in messages]))

    def _overflow(self) -> None:
        self.fail("its disk is too slow: records are missing")


class _CarriedMessages:
    """The numbers of the newest messages that cores received. A message is one object for all cores of a process."""

    def __init__(self) -> None:
        self._count = 0
        self._places: dict[int, tuple[int, BusMessage]] = {}

    def place(self, message: BusMessage) -> tuple[int, bool]:
        """Return the number of a message among all, from 1, and whether it is new."""
        known = self._places.get(id(message))
        if known is not None:
            return known[0], False
        self._count += 1
        if len(self._places) == CARRIED_KEPT:
            del self._places[next(iter(self._places))]
        self._places[id(message)] = self._count, message  # keeping the object reserves its id
        return self._count, True


class RecorderThread:
    """Writes a recorder's records in a thread, and flushes them every second and after every event.

    Use it as a context manager.
    """

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="flight recorder", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Write the remaining records and close the log, unless the disk hangs for CLOSING_TIMEOUT_S."""
        self._ended.set()
        self._thread.join(CLOSING_TIMEOUT_S)
        if self._thread.is_alive():
            self._recorder.fail(f"its disk has not answered for {CLOSING_TIMEOUT_S:g} s: it is not closed")

    def _run(self) -> None:
        try:
            self._record()
        except BaseException as error:  # a bug must be reported, not only end this thread
            self._recorder.fail(f"the recorder ended: {_error_text(error)}")

    def _record(self) -> None:
        flushed_s = monotonic()
        while not self._ended.wait(DRAIN_PERIOD_S):
            while self._recorder.drain_slice() and not self._ended.is_set():
                sleep(SLICE_PAUSE_S)
            if monotonic() - flushed_s >= FLUSH_PERIOD_S:
                self._recorder.flush()
                flushed_s = monotonic()
        self._recorder.close()


class VehicleRecorder:
    """Records one vehicle's core, and further records of the vehicle. Messages in a row become one record."""

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
        self._messages: list[Message] = []

    def write(self, item: CoreInput | TickOutput) -> None:
        """Add the next item; never blocks, never raises."""
        if type(item) is Message:
            self._messages.append(item)
            if len(self._messages) == TOGETHER_MAX:
                self.end()
        else:
            self.note(item)

    def note(self, record: object, time_s: float | None = None) -> None:
        """Add any record, with the present time by default."""
        self.end()
        self._add(record, self._now_s() if time_s is None else time_s)

    def end(self) -> None:
        """Add the record of the messages that came last."""
        if self._messages:
            messages, self._messages = self._messages, []
            self._add(messages, self._now_s())

    def _add(self, record: object, time_s: float) -> None:
        self._number += 1
        if len(self._queue) < QUEUE_MAX:
            self._queue.append((self._vehicle_id, self._number, time_s, record))
        else:
            self._overflow()


def _commands(messages: list[Message]) -> list[Message]:
    return [each for each in messages if isinstance(each.message, OperatorCommand)]


def _error_text(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


DRAIN_PERIOD_S = 1.0
"""Writing after every tick would evict the processor's caches before the next one."""


class SimulationRecording:
    """A recorder whose clock is the simulation's."""

    def __init__(self, writer: LogWriter, run: Run) -> None:
        self.writer = writer
        self._now_s = self._drained_s = 0.0
        self._recorder = Recorder(writer, lambda: self._now_s, lambda: 1.0)
        self._vehicles: dict[int, VehicleRecorder] = {}
        self._recorder.note(0, 0, run)

    def core(self, config: AgentConfig, planner: PlannerFactory | None = None) -> VehicleCore:
        """Return a core that is recorded; `planner` makes its plug-in planner, if any."""
        recorder = self._vehicles[config.vehicle_id] = self._recorder.vehicle(config.vehicle_id)
        return RecordedCore(config, recorder, planner)

    def advance(self, now_s: float) -> None:
        """Set the time of the records from now on. Write the waiting records from time to time."""
        self._now_s = now_s
        if now_s - self._drained_s >= DRAIN_PERIOD_S:
            self._drained_s = now_s
            self._recorder.drain()

    def target(self, now_s: float, position_m: tuple[float, float]) -> None:
        """Add the true position of a target that reacts."""
        self._recorder.note(0, 0, TargetTruth(now_s, position_m))

    def end(self, endings: Sequence[VehicleEnding], flight: SimulatedFlight, wall_time_s: float) -> None:
        """Add the truth, the computing time of each tick, and each vehicle's ending, in the order of the flight."""
        ticks = flight.time_s.size
        for column, ending in enumerate(endings):
            recorder, times_s = self._vehicles[ending.vehicle], flight.time_s.tolist()
            known = (each[:, column].tolist() for each in (flight.motion, flight.altitude_m, flight.tick_us))
            for self._now_s, motion, altitude_m, tick_us in zip(times_s, *known, strict=True):
                x, y, x_rate, y_rate = motion
                recorder.note(Truth(self._now_s, (x, y, altitude_m), (x_rate, y_rate, 0.0)))
                recorder.note(Cost(self._now_s, tick_us))
            recorder.note(VehicleEnd(ticks, 0, None, ending.how.value, ending.reason))
            self._recorder.drain()
        self._recorder.note(0, 0, RunEnd(float(flight.time_s[-1]), wall_time_s))
        self._recorder.close()
