"""This computer: whether it is short of memory or of disk for the flight log, and the error of its clock."""

import ctypes
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import psutil

from agents.safety.failsafe import DISK_MIN_BYTES, MEMORY_SHARE_MIN

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


def short_of(log: Path | None) -> str:
    """Return what this computer is short of, with values; empty if nothing. Without a log no disk is needed."""
    memory = psutil.virtual_memory()
    short = []
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
