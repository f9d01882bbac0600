"""This computer: whether it is short of memory, of disk for the flight log or of descriptors, and its clock's error."""

import ctypes
import resource
import shutil
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from agents.safety.failsafe import DESCRIPTORS_SHARE_MAX, DISK_MIN_BYTES, MEMORY_SHARE_MIN

_UNSYNCHRONISED = 0x0040
"""STA_UNSYNC of Linux's timex.h, in the status of its clock."""


class _Timex(ctypes.Structure):
    """The beginning of Linux's `struct timex`, and room for the rest of it."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    )


@dataclass(frozen=True, slots=True)
class ComputerClock:
    """The clock of a computer: the kernel's bound of its error [s], None if no program synchronises it."""

    error_s: float | None


def computer_clock() -> ComputerClock | None:
    """Return the state of this computer's clock, None if the system does not report it.

    chrony, systemd-timesyncd, ntpd and linuxptp set it in Linux.
    """
    if sys.platform != "linux":
        return None
    clock = _Timex()  # modes 0: it is only read
    if ctypes.CDLL(None).adjtimex(ctypes.byref(clock)) < 0 or clock.status & _UNSYNCHRONISED:
        return ComputerClock(None)
    return ComputerClock(float(clock.maxerror) * 1e-6)


def allow_descriptors() -> None:
    """Let this process open as many files and sockets as its hard limit permits.

    The usual soft limit of 1024 is for programs that use `select`; connections of strangers would exhaust it.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with suppress(ValueError, OSError):  # macOS states no limit, and permits less
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _descriptors() -> tuple[int, int]:
    """Return how many descriptors this process uses, and how many it may."""
    allowed, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if allowed == resource.RLIM_INFINITY:
        allowed = sys.maxsize
    try:
        return sum(1 for _ in Path("/dev/fd").iterdir()), allowed
    except OSError:  # none is left for this
        return allowed, allowed


def short_of(log: Path | None) -> str:
    """Return what this computer is short of, with values; empty if nothing. Without a log no disk is needed."""
    short = []
    used, allowed = _descriptors()
    if used > DESCRIPTORS_SHARE_MAX * allowed:
        short.append(f"{used} of {allowed} descriptors of files and connections in use")
    with suppress(OSError):  # no descriptor is left to read it
        memory = psutil.virtual_memory()
        if memory.available < MEMORY_SHARE_MIN * memory.total:
            short.append(f"{memory.available / 1e6:.0f} of {memory.total / 1e6:.0f} MB of memory available")
    if log is not None:
        try:
            free_bytes = shutil.disk_usage(log.parent).free
        except OSError:  # the log reports a missing folder
            free_bytes = int(DISK_MIN_BYTES)
        if free_bytes < DISK_MIN_BYTES:
            short.append(f"{free_bytes / 1e6:.0f} MB of disk left for the log")
    return ", ".join(short)
