"""One core for a process with many threads, of which one runs at a time. Imports nothing heavy.

Only one thread of a Python process holds the interpreter lock: passing it on to a thread of another core takes longer
than what most threads do with it. On Linux; elsewhere processes run on all cores.
"""

import os
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

_CLAIMS = "cordon"
"""The prefix of the names of claims, which are those of abstract sockets."""
_THREADS = Path("/proc/self/task")
_CORES = Path("/sys/devices/system/cpu")


class OneCore:
    """Keeps all threads of this process on one core that no other one has; a context manager lets them go again.

    It is the fastest such core, of those that this thread may use; `core` is None if there is none. A process that
    simulates leaves the cores to those with `priority`, which do not look at its claim. Processes that are started
    inside the context inherit the core.
    """

    def __init__(self, *, priority: bool = False) -> None:
        self.core: int | None = None
        self._priority = priority
        self._cores: set[int] = set()
        self._claim: socket.socket | None = None

    def __enter__(self) -> Self:
        """Claim a core, and keep all threads on it: those that begin later inherit it."""
        if sys.platform == "linux":
            self._cores = os.sched_getaffinity(0)
            self.core, self._claim = _claimed(self._cores, priority=self._priority)
            if self.core is not None:
                _keep_to({self.core})
        return self

    def __exit__(self, *_: object) -> None:
        """Let all threads use what this one could use before."""
        if self._claim is not None and sys.platform == "linux":
            _keep_to(self._cores)
            self._claim.close()


def for_all_threads(act: Callable[[int], object]) -> None:
    """Act on each thread of this process, also on those that begin meanwhile and inherit from none; on Linux."""
    done: set[int] = set()
    while new := {int(thread.name) for thread in _THREADS.iterdir()} - done:
        for thread in new:
            with suppress(ProcessLookupError):  # it has ended
                act(thread)
        done |= new


if sys.platform == "linux":

    def _claimed(cores: set[int], *, priority: bool) -> tuple[int, socket.socket] | tuple[None, None]:
        """Choose a core, and return it with what claims it; two times None when others have all of them.

        Of equally fast ones it is the last: most systems handle interrupts on the first.
        """
        for core in sorted(cores, key=lambda each: (_frequency_max_khz(each), each), reverse=True):
            first = _claim(f"core-{core}")
            if first is None or priority:
                claim = first
            else:
                first.close()
                claim = _claim(f"simulated-core-{core}")
            if claim is not None:
                return core, claim
        return None, None

    def _claim(name: str) -> socket.socket | None:
        """Return what holds a name until it is closed or the process ends, None if another one holds it."""
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0{_CLAIMS}-{name}")
        except OSError:
            claim.close()
            return None
        return claim

    def _frequency_max_khz(core: int) -> int:
        """Return a core's highest frequency; 0 if the system does not state it, as in a virtual machine."""
        try:
            return int((_CORES / f"cpu{core}/cpufreq/cpuinfo_max_freq").read_bytes())
        except (OSError, ValueError):
            return 0

    def _keep_to(cores: set[int]) -> None:
        """Let all threads run on these cores only; on any, if the system has taken these away meanwhile."""
        with suppress(OSError):
            for_all_threads(lambda thread: os.sched_setaffinity(thread, cores))
