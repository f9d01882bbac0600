"""Raised priority, one core and locked memory of this process, as far as the system permits. Imports nothing heavy.

All threads are raised, also those that the others start afterwards: the control loops wait for the interpreter lock,
and a thread that holds it may not wait for a processor behind other programs. They run on one core, as
`sitl/server/one_core.py` explains.
"""

import ctypes
import os
import resource
import sys
from contextlib import suppress
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from sitl.server.one_core import OneCore, for_all_threads

REAL_TIME_PRIORITY, NICENESS = 1, -10
SUPERVISOR_PRIORITY = 2
"""Above the flying process: the supervisor can end one that spins."""
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
"""MCL_CURRENT, MCL_FUTURE and MCL_ONFAULT of Linux: pages are locked once they are in use."""
_MAY_LOCK = 1 << 14
"""CAP_IPC_LOCK."""


class Scheduling(Enum):
    """How the system schedules this process."""

    REAL_TIME = f"at real-time priority {REAL_TIME_PRIORITY}"
    RAISED = f"at raised priority (nice {NICENESS})"
    NORMAL = "at normal priority"
    UNAVAILABLE = "at normal priority; raising it is not available on this system"


class Privileges(NamedTuple):
    """What the system permits to the flying process; `core` is the one that it runs on, None for any."""

    scheduling: Scheduling
    memory_locked: bool
    core: int | None = None


class _Saved(NamedTuple):
    policy: int
    priority: int
    niceness: int


class RaisedPriority:
    """Raises the priority of this process, keeps it on one core and locks its memory; a context manager restores all.

    Processes that are started inside it inherit priority and core. `privileges` is what the system permitted.
    """

    def __init__(self) -> None:
        self.privileges = Privileges(Scheduling.NORMAL, memory_locked=False)
        self._saved: _Saved | None = None
        self._one_core = OneCore(priority=True)

    def __enter__(self) -> Self:
        """Raise, keep on a core, and lock."""
        if sys.platform != "linux":
            self.privileges = Privileges(Scheduling.UNAVAILABLE, memory_locked=False)
            return self
        self._saved = _Saved(
            os.sched_getscheduler(0),
            os.sched_getparam(0).sched_priority,
            os.getpriority(os.PRIO_PROCESS, 0),
        )
        core = self._one_core.__enter__().core
        self.privileges = Privileges(_raised(self._saved.niceness), _lock_memory(), core)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Restore the priority of the thread that entered, for all threads."""
        if self._saved is None or sys.platform != "linux":
            return
        policy, priority, niceness = self._saved
        self._one_core.__exit__()
        if self.privileges.memory_locked:
            ctypes.CDLL(None).munlockall()
        if self.privileges.scheduling is Scheduling.REAL_TIME:
            for_all_threads(lambda thread: os.sched_setscheduler(thread, policy, os.sched_param(priority)))
        elif self.privileges.scheduling is Scheduling.RAISED:
            for_all_threads(lambda thread: os.setpriority(os.PRIO_PROCESS, thread, niceness))


def raise_supervisor() -> None:
    """Give this thread a higher real-time priority than the flying process; processes that it starts do not inherit it.

    Does nothing where the system does not permit it.
    """
    if sys.platform == "linux":
        with suppress(PermissionError):
            policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(SUPERVISOR_PRIORITY))


if sys.platform == "linux":

    def _raised(niceness: int) -> Scheduling:
        """Raise all threads as far as permitted."""
        try:
            for_all_threads(
                lambda thread: os.sched_setscheduler(thread, os.SCHED_RR, os.sched_param(REAL_TIME_PRIORITY))
            )
            return Scheduling.REAL_TIME
        except PermissionError:
            pass
        try:
            for_all_threads(lambda thread: os.setpriority(os.PRIO_PROCESS, thread, min(niceness, NICENESS)))
            return Scheduling.RAISED
        except PermissionError:
            return Scheduling.NORMAL if niceness >= 0 else Scheduling.RAISED

    def _lock_memory() -> bool:
        """Lock what is in memory now, and each page once it is used; return whether the system permitted it.

        Not with a finite limit: the flight would run out of memory at it.
        """
        limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        if limit != resource.RLIM_INFINITY and not _capabilities() & _MAY_LOCK:
            return False
        return bool(ctypes.CDLL(None).mlockall(_CURRENT | _FUTURE | _ON_FAULT) == 0)

    def _capabilities() -> int:
        lines = Path("/proc/self/status").read_bytes().splitlines()
        return next((int(line.split()[1], 16) for line in lines if line.startswith(b"CapEff:")), 0)
