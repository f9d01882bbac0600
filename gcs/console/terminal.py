"""Standard error, for text to people; standard output is for results only."""

import os
import sys
from contextlib import suppress
from typing import TextIO

from rich.console import Console

from gcs.console.printable import PrintableOutput


class _StderrConsole(Console):
    """A console that survives a closed pipe: a flight continues when its output is no longer read."""

    def on_broken_pipe(self) -> None:
        """Discard all further output."""
        self.quiet = True
        discard(sys.stderr)


STDERR = _StderrConsole(stderr=True)
STDERR.push_render_hook(PrintableOutput())


def print_line(text: str, style: str = "") -> None:
    """Print a line as it is: without markup, highlighting or wrapping."""
    STDERR.print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def print_problem(reason: str, next_step: str = "") -> None:
    """Print a problem and, on a separate line, the next step."""
    print_line(reason, "red")
    if next_step:
        print_line(f"next: {next_step}")


def discard(stream: TextIO) -> None:
    """Redirect a stream whose reader is gone to the null device: Python flushes it once more at exit."""
    with suppress(OSError, ValueError):  # the stream may have no file
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)
