"""Terminals for programs that are started by tests."""

import asyncio
import fcntl
import os
import termios
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def terminal() -> Iterator[tuple[int, int, bytearray]]:
    """Open a terminal; return its user's end, the program's, and what the program has written on it so far."""
    here, there = os.openpty()
    shown = bytearray()
    loop = asyncio.get_running_loop()
    loop.add_reader(here, lambda: shown.extend(os.read(here, 65536)))
    try:
        yield here, there, shown
    finally:
        loop.remove_reader(here)
        os.close(here)
        os.close(there)


def take_terminal() -> None:
    """Make the standard input of a process that begins its controlling terminal."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
