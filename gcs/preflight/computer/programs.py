"""The programs that use the processors of this computer."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import NamedTuple

import psutil

NAMED = 3
NAMED_FROM = 0.05
"""A program that uses a smaller share of a processor is not named."""


@dataclass(frozen=True, slots=True)
class Program:
    """A process and the share of one processor that it used: 1.8 are nearly two processors."""

    name: str
    pid: int
    share: float

    def __str__(self) -> str:
        """Return its name, process id and share, such as `chrome (4312) 180 %`."""
        own = ", this program" if self.pid == os.getpid() else ""
        return f"{self.name} ({self.pid}{own}) {100.0 * self.share:.0f} %"


class Processes(NamedTuple):
    """All processes at one time [s, monotonic]: name and processor seconds by process id and time of start."""

    time_s: float
    used: Mapping[tuple[int, float], tuple[str, float]]


def processes() -> Processes:
    """Return the processes that this user can see. Takes some 10 ms, with the interpreter lock."""
    used = {}
    for process in psutil.process_iter(["name", "create_time", "cpu_times"]):
        times = process.info["cpu_times"]
        if times is not None:  # None where access is denied
            key = process.pid, process.info["create_time"]
            used[key] = process.info["name"] or "?", times.user + times.system
    return Processes(monotonic(), used)


def busiest(before: Processes, after: Processes) -> Sequence[Program]:
    """Return the processes that used the most processor time between two looks, at most three, the busiest first.

    A process that began between them counts from its start; one that ended is not known any more.
    """
    elapsed_s = after.time_s - before.time_s
    programs = [
        Program(name, key[0], (used_s - before.used.get(key, (name, 0.0))[1]) / elapsed_s)
        for key, (name, used_s) in after.used.items()
    ]
    programs.sort(key=lambda program: -program.share)
    return [program for program in programs[:NAMED] if program.share >= NAMED_FROM]
