"""The keys of the live view: read from the terminal as they are pressed, and what they mean."""

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
"""More keys at once were not pressed but pasted, or are an arrow's: they mean nothing."""
VERB_OF_KEY: dict[str, Verb] = {"h": "hold", "r": "resume", "l": "land", "t": "rtl", "a": "abort", "k": "kill"}
HINT = "h hold · r resume · l land · t return and land · a abort · k kill"
_ESCAPE = "\x1b"


class KeyMeaning:
    """What keys mean, one after the other: a verb each, and a kill only once it has been confirmed."""

    def __init__(self) -> None:
        self._asked_s: float | None = None

    def press(self, key: str, now_s: float) -> Verb | None:
        """Return what is to be done about a key that was pressed at `now_s` [wall s]."""
        asked = self.asks(now_s)
        self._asked_s = None
        if asked and key in "ky":
            return "kill"
        if key == "k":
            self._asked_s = now_s
            return None
        return VERB_OF_KEY.get(key)

    def asks(self, now_s: float) -> bool:
        """Return whether a kill waits to be confirmed."""
        return self._asked_s is not None and now_s - self._asked_s <= KILL_CONFIRMED_WITHIN_S

    def hint(self, now_s: float) -> str:
        """Return what to show below the table."""
        if self.asks(now_s):
            return f"cut all motors? k or y within {KILL_CONFIRMED_WITHIN_S:g} s does, any other key does not"
        return HINT


class Keys:
    """The keys of the terminal on standard input, one by one, while this context lasts; none where it is no terminal.

    The terminal is as it was before however the program ends, but by a signal that nobody can catch. A job in the
    background reads no keys, and is not stopped for having tried.
    """

    def __init__(self, on_key: Callable[[str], object], stream: TextIO | None = None) -> None:
        """Take what is to be called on the event loop with each key."""
        self._on_key = on_key
        self._stream = sys.stdin if stream is None else stream
        self._fd = -1
        self._before: list[object] = []

    @property
    def active(self) -> bool:
        """Whether keys are read."""
        return self._fd >= 0

    def __enter__(self) -> Self:
        """Let keys through one by one, unseen."""
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
        """Leave the terminal as it was."""
        if self.active:
            asyncio.get_running_loop().remove_reader(self._fd)
        self._restore()

    def _restore(self) -> None:
        atexit.unregister(self._restore)
        fd, self._fd = self._fd, -1
        if fd >= 0:
            with suppress(termios.error, ValueError):  # the terminal is gone: there is nothing to leave as it was
                termios.tcsetattr(fd, termios.TCSANOW, self._before)  # type: ignore[arg-type]

    def _read(self) -> None:
        try:
            pressed = os.read(self._fd, 256).decode("ascii", "ignore")
        except OSError:
            pressed = ""
        if not pressed:  # it hung up, or it is another job's by now
            asyncio.get_running_loop().remove_reader(self._fd)
        elif len(pressed) <= AT_ONCE_MAX and _ESCAPE not in pressed:
            for key in pressed:
                self._on_key(key)


def _in_foreground(stream: TextIO) -> bool:
    try:
        return stream.isatty() and os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError):
        return False
