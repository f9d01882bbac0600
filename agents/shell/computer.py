"""Whether this computer runs short of memory, or of disk for the flight log."""

import shutil
from pathlib import Path

import psutil

MEMORY_SHARE_MIN = 0.05
"""Of all memory. Below, Linux begins to swap, and then to kill processes."""
DISK_MIN_BYTES = 200e6
"""A team of three writes that much in half an hour."""


def short_of(log: Path | None) -> str:
    """Return what this computer runs short of, with the numbers; empty if nothing. Without a log no disk is needed."""
    memory = psutil.virtual_memory()
    short = []
    if memory.available < MEMORY_SHARE_MIN * memory.total:
        short.append(f"{memory.available / 1e6:.0f} of {memory.total / 1e6:.0f} MB of memory available")
    if log is not None:
        try:
            free_bytes = shutil.disk_usage(log.parent).free
        except OSError:  # the log itself tells of its folder's end
            free_bytes = int(DISK_MIN_BYTES)
        if free_bytes < DISK_MIN_BYTES:
            short.append(f"{free_bytes / 1e6:.0f} MB of disk left for the log")
    return ", ".join(short)
