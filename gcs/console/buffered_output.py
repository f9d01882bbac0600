"""Non-blocking output to a terminal: a terminal stopped by Ctrl-S cannot stop a flight."""

import os
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, TextIO, cast

from rich.console import Console

BUFFER_MAX = 200_000
"""Characters, about a minute of the live table; further ones are discarded."""
CLOSING_S = 2.0
REPORTED_S = 1.0


class BufferedOutput:
    """A text file that buffers writes to another one; a separate thread writes them.

    A terminal that accepts no output blocks only that thread. Text beyond BUFFER_MAX is discarded until the terminal
    accepts output again; the thread then writes how long it was blocked. Raises BrokenPipeError once the other file's
    reader is gone.
    """

    def __init__(self, file: IO[str]) -> None:
        self._file = file
        self._texts: deque[str] = deque()
        self._size = 0
        self._changed = threading.Condition()
        self._failed = self._closing = False
        self._discarded = 0
        self._thread = threading.Thread(target=self._run, name="terminal", daemon=True)
        self._thread.start()

    @property
    def encoding(self) -> str:
        """The other file's encoding."""
        return getattr(self._file, "encoding", "utf-8")

    def fileno(self) -> int:
        """Return the other file's descriptor."""
        return self._file.fileno()

    def isatty(self) -> bool:
        """Return whether the other file is a terminal."""
        return self._file.isatty()

    def write(self, text: str) -> int:
        """Buffer a text; return its length."""
        with self._changed:
            if self._failed:
                raise BrokenPipeError
            if self._size > BUFFER_MAX:
                self._discarded += len(text)
            else:
                self._texts.append(text)
                self._size += len(text)
                self._changed.notify()
        return len(text)

    def flush(self) -> None:
        """Do nothing: the thread writes as soon as it can."""

    def close(self) -> None:
        """Wait until the rest is written, for CLOSING_S at most."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(CLOSING_S)

    def _run(self) -> None:
        while (text := self._next()) is not None:
            began_s = time.monotonic()
            try:
                # Not through the file object: a thread blocked in it would block the exit of the process.
                data = text.encode(self.encoding, "replace")
                while data:
                    data = data[os.write(self.fileno(), data) :]
            except (OSError, ValueError):
                with self._changed:
                    self._failed = True
                return
            self._report(time.monotonic() - began_s)

    def _next(self) -> str | None:
        with self._changed:
            while not self._texts and not self._closing:
                self._changed.wait()
            if not self._texts:
                return None
            text = self._texts.popleft()
            self._size -= len(text)
            return text

    def _report(self, blocked_s: float) -> None:
        if blocked_s < REPORTED_S:
            return
        with self._changed:
            discarded, self._discarded = self._discarded, 0
            lost = f", {discarded} characters were discarded" if discarded else ""
            self._texts.append(f"\nthe terminal took no output for {blocked_s:.1f} s{lost}; the flight continued\n")


@contextmanager
def unblocked(console: Console) -> Iterator[None]:
    """Make a console's output to a standard stream non-blocking inside this context."""
    try:
        console.file.fileno()
    except OSError:  # a file in memory
        yield
        return
    output = BufferedOutput(console.file)
    try:
        console.file = cast(TextIO, output)
        yield
    finally:
        output.close()
        console.file = cast(TextIO, None)  # the standard stream again
