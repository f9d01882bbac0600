"""Standard error, for text to people; standard output is for results only."""

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from textwrap import TextWrapper
from typing import TextIO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from agents.team.text import printable


def printable_lines(text: str) -> str:
    """Return a text with '?' for each control character but line ends."""
    return "\n".join(map(printable, text.split("\n")))


class PrintableConsole(Console):
    """A console that prints text as printable; styles and rich's own control codes stay."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Yield the segments of a renderable, also those of a live view."""
        for segment in super().render(renderable, options):
            text, style, control = segment
            yield segment if control else Segment(printable_lines(text), style)


class _StderrConsole(PrintableConsole):
    """A console that survives a closed pipe: a flight continues when its output is no longer read."""

    def on_broken_pipe(self) -> None:
        """Discard all further output."""
        self.quiet = True
        discard(sys.stderr)


STDERR = _StderrConsole(stderr=True)


def whole_words(text: str, console: Console) -> str:
    """Return a text in lines that a terminal does not break inside a word; elsewhere as it is."""
    if not console.is_terminal or console.is_dumb_terminal:
        return text
    wrapper = TextWrapper(console.width, break_long_words=False, break_on_hyphens=False, subsequent_indent="  ")
    return "\n".join(wrapper.fill(line) for line in text.split("\n"))


def print_line(text: str, style: str = "") -> None:
    """Print a line as it is, without markup or highlighting."""
    STDERR.print(whole_words(text, STDERR), style=style, markup=False, highlight=False, soft_wrap=True)


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
