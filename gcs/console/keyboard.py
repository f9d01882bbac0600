"""Keyboard input of the live view: keys read from the terminal one by one, and the commands bound to them."""

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

from agents.team.messages import Verb

KILL_CONFIRMED_WITHIN_S = 3.0
AT_ONCE_MAX = 3
"""More characters in one read are pasted text or an escape sequence: they are ignored."""
VERB_OF_KEY: dict[str, Verb] = {"h": "hold", "r": "resume", "l": "land", "t": "rtl", "a": "abort", "k": "kill"}
HINT = "h hold · r resume · l land · t return and land · a abort · k kill"
_ESCAPE = "\x1b"


class KeyBindings:
    """Maps keys to commands; a kill has to be confirmed by a second key."""

    def __init__(self) -> None:
        self._kill_requested_s: float | None = None

    def press(self, key: str, now_s: float) -> Verb | None:
        """Return the command of a key that was pressed at `now_s` [wall s], None without one."""
        confirming = self.awaits_confirmation(now_s)
        self._kill_requested_s = None
        if confirming and key in "ky":
            return "kill"
        if key == "k":
            self._kill_requested_s = now_s
            return None
        return VERB_OF_KEY.get(key)

    def awaits_confirmation(self, now_s: float) -> bool:
        """Return whether a kill has to be confirmed."""
        return self._kill_requested_s is not None and now_s - self._kill_requested_s <= KILL_CONFIRMED_WITHIN_S

    def hint(self, now_s: float) -> str:
        """Return the line to show below the table."""
        if self.awaits_confirmation(now_s):
            return f"cut all motors? confirm with k or y within {KILL_CONFIRMED_WITHIN_S:g} s, any other key cancels"
        return HINT


class Keyboard:
    """Context manager that reads single keys from the terminal on standard input; inactive without a terminal.

    The terminal settings are restored however the program ends, except after SIGKILL. A background job reads no keys
    and is not stopped by SIGTTIN.
    """

    def __init__(self, on_key: Callable[[str], object], stream: TextIO | None = None) -> None:
        """Call `on_key` on the event loop with each key; `stream` is standard input by default."""
        self._on_key = on_key
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
        if not pressed:  # the terminal hung up, or belongs to another job now
            asyncio.get_running_loop().remove_reader(self._fd)
        elif len(pressed) <= AT_ONCE_MAX and _ESCAPE not in pressed:
            for key in pressed:
                self._on_key(key)


def _in_foreground(stream: TextIO) -> bool:
    try:
        return stream.isatty() and os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError):
        return False
