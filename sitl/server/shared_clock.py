"""A simulated time in shared memory, with the participants that it waits for.

Each participant has a seat, which states the time of its next event. The participant with the earliest event is the
only one that may go on: it sets the time to that of its event, handles it, and states its next one. So the time never
passes a participant, and events happen in one order on every computer. Simultaneous events happen in the order of the
seats.

A participant that does not go on for `HUNG_S` of wall time, and does not say that it waits, is passed over until it
states another event; the time for which it waits for the processor does not count. One whose process has ended is
removed. Imports nothing heavy: a supervisor uses it.
"""

import errno
import fcntl
import os
import select
import shutil
import tempfile
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import IntEnum
from math import isnan
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Self

from sitl.server.clock_memory import IDLE, NEVER_US, SEAT_BITS, SEATS, VERSION, ClockMemory
from sitl.server.file_lock import is_locked
from sitl.server.wall_limit import WallLimit

HUNG_S, HUNG_LONGEST_S = 2.0, 20.0
"""Wall time for which the others wait for a participant that does not go on: by itself, and without the processor."""
LOOK_S = 0.02
"""Wall time after which a waiting participant looks again, if none has woken it."""
LATE_MAX_S = 0.05
"""Wall time that is made up: a clock that is further behind its speed does not run faster to catch up."""
US_PER_S = 1e6
FOLDER_VARIABLE = "CORDON_CLOCKS"
"""The environment variable that names the folder of the clocks; by default that of shared memory, if there is one."""

_PREFIX = "cordon-clock"
_OWNER = "owner"
"""The file that the program that made the clock holds locked as long as it runs."""


class Rank(IntEnum):
    """Who goes first of those whose events are simultaneous."""

    STUBS = 0
    AGENTS = 1
    SUPERVISOR = 2
    GUEST = 3


class ClockError(Exception):
    """A shared clock that cannot be made or joined, with the reason."""


@dataclass(frozen=True, slots=True)
class ClockName:
    """The number that identifies a clock on this computer, and its folder."""

    number: int

    @property
    def folder(self) -> Path:
        """The folder of its memory and of the pipes that wake its participants."""
        return clocks_folder() / f"{_PREFIX}-{os.getuid()}-{self.number:08x}"


def clocks_folder() -> Path:
    """Return the folder of all clocks."""
    if given := os.environ.get(FOLDER_VARIABLE):
        return Path(given)
    shared = Path("/dev/shm")
    return shared if os.access(shared, os.W_OK) else Path(tempfile.gettempdir())


@contextmanager
def new_clock(speed: float, ports: Collection[int] = ()) -> Iterator[ClockName]:
    """Make a clock that runs at most `speed` times as fast as the wall's (infinity: as fast as its participants).

    It begins at the present Unix time, in whole seconds, and is removed at the end of the context. Clocks that killed
    programs have left are removed as well. Clients find it by the UDP `ports` that its stubs send to (`clock_of`).
    Raises ClockError.
    """
    if isnan(speed) or speed <= 0.0:
        raise ValueError(f"speed = {speed}: it must be positive")
    name = ClockName(int.from_bytes(os.urandom(4)))
    try:
        _remove_abandoned()
        owned = _write_folder(name, speed, ports)
    except OSError as error:
        raise ClockError(f"no memory can be shared in {clocks_folder()}: {error}") from error
    try:
        yield name
    finally:
        shutil.rmtree(name.folder, ignore_errors=True)
        os.close(owned)


def _write_folder(name: ClockName, speed: float, ports: Collection[int]) -> int:
    """Write the folder of a clock; return the descriptor that shows that it is owned, while it is open."""
    # Under another name at first: without an owner it would look abandoned.
    folder = Path(tempfile.mkdtemp(prefix=".cordon-clock-", dir=clocks_folder()))
    owned = os.open(folder / _OWNER, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(owned, fcntl.LOCK_EX)
        _write_memory(folder / "memory", speed)
        (folder / "ports").write_text(" ".join(map(str, sorted(ports))))
        folder.rename(name.folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(owned)
        raise
    return owned


def clock_of(ports: Collection[int]) -> ClockName | None:
    """Return the clock of the stubs that send to these UDP ports, None if there is none."""
    for folder in _own_folders():
        with suppress(OSError, ValueError):
            served = {int(port) for port in (folder / "ports").read_text().split()}
            if served.issuperset(ports) and is_locked(folder / _OWNER):
                return ClockName(int(folder.name.rpartition("-")[2], 16))
    return None


def clock_time_s(ports: Collection[int]) -> float | None:
    """Return the present time of the clock of the stubs that send to these UDP ports, None if there is none."""
    if (name := clock_of(ports)) is None:
        return None
    with suppress(OSError), (name.folder / "memory").open("rb") as file:
        memory = ClockMemory(mmap(file.fileno(), ClockMemory.size(), access=ACCESS_READ))
        try:
            return float(memory.epoch_s[0]) + int(memory.now_us[0]) / US_PER_S
        finally:
            memory.close()
    return None


def _own_folders() -> Iterator[Path]:
    """Yield the folders of this user's clocks: other users may make folders of any name beside them."""
    return filter(_is_own, clocks_folder().glob(f"{_PREFIX}-{os.getuid()}-*"))


def _is_own(folder: Path) -> bool:
    with suppress(OSError):
        return folder.lstat().st_uid == os.getuid()
    return False


def _write_memory(path: Path, speed: float) -> None:
    descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
    try:
        # Not truncated to its size, which would reserve nothing: writing to memory that is short ends a process.
        if os.write(descriptor, bytes(ClockMemory.size())) < ClockMemory.size():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        memory = ClockMemory(mmap(descriptor, ClockMemory.size()))
    finally:
        os.close(descriptor)
    memory.epoch_s[0], memory.speed[0] = float(int(time.time())), speed
    for seat in range(SEATS):
        memory.event[seat], memory.hung[seat] = IDLE, -1
    memory.version[0] = VERSION
    memory.close()


def _remove_abandoned() -> None:
    for folder in _own_folders():
        with suppress(OSError):
            if not is_locked(folder / _OWNER):
                shutil.rmtree(folder, ignore_errors=True)


class Seat:
    """A participant's seat at a clock. Use it from one thread.

    Between `state` and a `turn` that returns 0 the participant waits; from then to the next `state` it handles its
    event, and the time stands still. A participant without a next event is not waited for.
    """

    def __init__(self, name: ClockName, rank: Rank) -> None:
        """Take a seat without an event. Raises ClockError if there is no such clock, or no seat is left."""
        self._folder = name.folder
        if self._folder.exists() and not _is_own(self._folder):
            raise ClockError(f"the clock in {self._folder} belongs to another user")
        try:
            descriptor = os.open(self._folder / "memory", os.O_RDWR)
            try:
                self.memory = ClockMemory(mmap(descriptor, ClockMemory.size()))
            finally:
                os.close(descriptor)
            if self.memory.version[0] != VERSION:
                raise ClockError(f"the clock in {self._folder} is of another version of cordon")
            self._woken, self._seat = self._take(rank)
        except (OSError, ValueError) as error:
            raise ClockError(f"there is no clock in {self._folder}: {error}") from error
        self._serial = self.memory.serial[self._seat]
        self._others: dict[int, int] = {}
        self._blocking, self._patience = (IDLE, 0), WallLimit(HUNG_S, HUNG_LONGEST_S, os.getpid(), 0.0)
        self._stated_us = NEVER_US
        self._paced_us, self._paced_s, self._paced_speed = self.now_us, time.monotonic(), self.speed

    @property
    def woken(self) -> int:
        """The descriptor that becomes readable when this participant should look; to be read empty."""
        return self._woken

    @property
    def epoch_s(self) -> float:
        """The Unix time at which the clock began, in whole seconds."""
        return float(self.memory.epoch_s[0])

    @property
    def now_us(self) -> int:
        """The present time since the epoch."""
        return int(self.memory.now_us[0])

    @property
    def speed(self) -> float:
        """How many times as fast as the wall's the clock runs, at most; settable."""
        return float(self.memory.speed[0])

    @speed.setter
    def speed(self, speed: float) -> None:
        self.memory.speed[0] = speed

    @property
    def waits_us(self) -> int:
        """The time of the event that is stated."""
        return self._stated_us

    def state(self, event_us: int) -> None:
        """State the time of the next event: everything before it is done. `NEVER_US` if there is none."""
        event_us = min(max(event_us, self.now_us), NEVER_US)
        if self._stated_us == NEVER_US:  # it has not followed the time
            self._paced_us, self._paced_s = self.now_us, time.monotonic()
        self._stated_us = event_us
        self.memory.event[self._seat] = event_us << SEAT_BITS | self._seat
        first = self._first()
        if first is not None and first != self._seat:
            self._wake(first)

    def note_wait(self) -> None:
        """State that this participant does not hang, but waits for something before its event."""
        self.memory.waits[self._seat] += 1

    def turn(self) -> float:
        """Return 0 if the stated event happens now, and set the time; else wall seconds after which to look again."""
        wall_s = time.monotonic()
        if self.memory.hung[self._seat] == self.memory.event[self._seat]:  # the others have gone on meanwhile
            self.memory.hung[self._seat] = -1
            self.state(max(self._stated_us, self.now_us))
        first = self._first()
        if first != self._seat:
            if first is not None:
                self._watch(first, wall_s)
            return LOOK_S
        due_s = self._due_s(self._stated_us, wall_s)
        if due_s > wall_s:
            return due_s - wall_s
        self._paced_us, self._paced_s = self._stated_us, max(due_s, wall_s - LATE_MAX_S)
        self.memory.now_us[0] = max(self._stated_us, self.now_us)
        return 0.0

    def wait_until(self, event_us: int) -> bool:
        """Block until a time has come, which then stands still until the next call or `leave`; return True.

        Return False if it has not come within `HUNG_S` of wall time and the program that made the clock has ended: the
        time may never come then.
        """
        self.state(event_us)
        abandoned_s = time.monotonic() + HUNG_S
        while (wait_s := self.turn()) > 0.0:
            if select.select([self._woken], [], [], wait_s)[0]:
                os.read(self._woken, 4096)
            if time.monotonic() > abandoned_s and not self._is_owned:
                return False
        return True

    def leave(self) -> None:
        """Leave the clock, which goes on without this participant."""
        self.memory.serial[self._seat] = 0
        self.memory.event[self._seat] = IDLE
        first = self._first()
        if first is not None:
            self._wake(first)
        with suppress(OSError):
            self._pipe(self._serial).unlink()
        for descriptor in (self._woken, *self._others.values()):
            os.close(descriptor)
        self.memory.close()

    @property
    def _is_owned(self) -> bool:
        """Whether the program that made the clock still runs."""
        with suppress(OSError):  # another program has removed the clock that it left
            return is_locked(self._folder / _OWNER)
        return False

    def _take(self, rank: Rank) -> tuple[int, int]:
        """Return the descriptor of this participant's pipe, and its seat."""
        per_rank = SEATS // len(Rank)
        lock = os.open(self._folder / "joining", os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            for seat in range(rank * per_rank, (rank + 1) * per_rank):
                if self.memory.serial[seat] == 0:
                    serial = time.time_ns()
                    os.mkfifo(self._pipe(serial), 0o600)
                    # Also open for writing: without a writer it would be readable, at its end, all the time.
                    woken = os.open(self._pipe(serial), os.O_RDWR | os.O_NONBLOCK)
                    self.memory.event[seat], self.memory.hung[seat] = IDLE, -1
                    self.memory.process[seat] = os.getpid()
                    self.memory.serial[seat] = serial
                    return woken, seat
        finally:
            os.close(lock)
        raise ClockError(f"all {per_rank} seats for {rank.name.lower()} at the clock in {self._folder} are taken")

    def _pipe(self, serial: int) -> Path:
        return self._folder / f"wake-{serial:x}"

    def _first(self) -> int | None:
        """Return the seat that may go on, None if there is no event."""
        memory = self.memory
        first = int(min(memory.event))
        seat = first & SEATS - 1
        if first < IDLE and memory.hung[seat] == first:
            events = (event for event, hung in zip(memory.event, memory.hung, strict=True) if event != hung)
            first = min(events, default=IDLE)
            seat = first & SEATS - 1
        return seat if first < IDLE else None

    def _due_s(self, event_us: int, wall_s: float) -> float:
        """Return when an event is due at the clock's speed [s, monotonic]."""
        if self.speed != self._paced_speed:
            self._paced_us, self._paced_s, self._paced_speed = self.now_us, wall_s, self.speed
        return self._paced_s + max(event_us - self._paced_us, 0) / US_PER_S / self._paced_speed

    def _watch(self, blocking: int, wall_s: float) -> None:
        """Pass over the seat that may go on if it has not done so for too long; remove it if its process has ended."""
        event, waits = int(self.memory.event[blocking]), int(self.memory.waits[blocking])
        if (event, waits) != self._blocking:
            due_s = max(self._due_s(event >> SEAT_BITS, wall_s), wall_s)
            process = int(self.memory.process[blocking])
            self._blocking, self._patience = (event, waits), WallLimit(HUNG_S, HUNG_LONGEST_S, process, due_s)
        if self._patience.is_over(wall_s):
            self.memory.hung[blocking] = event
        self._wake(blocking)

    def _wake(self, seat: int) -> None:
        serial = int(self.memory.serial[seat])
        if serial == 0:
            return
        try:
            if serial not in self._others:
                self._others[serial] = os.open(self._pipe(serial), os.O_WRONLY | os.O_NONBLOCK)
            os.write(self._others[serial], b"\0")
        except BlockingIOError:
            pass  # it has been woken often enough
        except OSError:  # the pipe has no reader: its process has ended
            self.memory.serial[seat] = 0
            self.memory.event[seat] = IDLE

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.leave()
