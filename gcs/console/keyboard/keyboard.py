"""Keyboard input of the live view: single keys read from the terminal, separated from pasted text."""

import asyncio
import atexit
import os
import signal
import sys
import termios
import tty
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self, TextIO

from gcs.console.keyboard.bindings import ESCAPE

AT_ONCE_MAX = 3
"""More characters in one read are pasted text or an escape sequence, and ignored."""
PASTE_BEGINS, PASTE_ENDS = "\x1b[200~", "\x1b[201~"
"""Markers of a terminal around pasted text in bracketed paste mode (`gcs.console.live`)."""


class Keyboard:
    """Context manager that reads single keys from the terminal on standard input; inactive without a terminal.

    The terminal settings are restored when the program ends, except after SIGKILL. A background job reads no keys and
    is not stopped by SIGTTIN.
    """

    def __init__(
        self, on_key: Callable[[str], object], on_paste: Callable[[], object], stream: TextIO | None = None
    ) -> None:
        """Call `on_key` on the event loop with each key, `on_paste` for pasted text; `stream` is standard input."""
        self._on_key = on_key
        self._on_paste = on_paste
        self._pasted: str | None = None
        self._stream = sys.stdin if stream is None else stream
        self._fd = -1
        self._before: list[object] = []

    @property
    def active(self) -> bool:
        """Whether keys are read."""
        return self._fd >= 0

    def __enter__(self) -> Self:
        """Switch the terminal to unbuffered input without echo."""
        if not _in_foreground(self._stream):
            return self
        fd = self._stream.fileno()
        for number in (signal.SIGTTIN, signal.SIGTTOU):
            signal.signal(number, signal.SIG_IGN)
        self._before = termios.tcgetattr(fd)
        atexit.register(self._restore)
        self._fd = fd
        tty.setcbreak(fd, termios.TCSANOW)
        asyncio.get_running_loop().add_reader(fd, self._read)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Restore the terminal."""
        if self.active:
            asyncio.get_running_loop().remove_reader(self._fd)
        self._restore()

    def _restore(self) -> None:
        atexit.unregister(self._restore)
        fd, self._fd = self._fd, -1
        if fd >= 0:
            with suppress(termios.error, ValueError):  # the terminal is gone: nothing to restore
                termios.tcsetattr(fd, termios.TCSANOW, self._before)  # type: ignore[arg-type]

    def _read(self) -> None:
        try:
            pressed = os.read(self._fd, 256).decode("ascii", "ignore")
        except OSError:
            pressed = ""
        if not pressed:  # the terminal hung up, or another job owns it
            asyncio.get_running_loop().remove_reader(self._fd)
        else:
            self._take(pressed)

    def _take(self, pressed: str) -> None:
        """Process the characters of one read: single keys, or pasted text from its begin to its end."""
        if self._pasted is None and PASTE_BEGINS in pressed:
            self._pasted = ""
        if self._pasted is not None:
            # The end marker may be split over two reads.
            text = self._pasted + pressed
            self._pasted = None if PASTE_ENDS in text else text[-len(PASTE_ENDS) :]
            self._on_paste()
        elif ESCAPE in pressed and pressed != ESCAPE:
            pass  # an arrow or a function key
        elif len(pressed) > AT_ONCE_MAX:
            self._on_paste()
        else:
            for key in pressed:
                self._on_key(key)


def _in_foreground(stream: TextIO) -> bool:
    try:
        return stream.isatty() and os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError):
        return False
