"""A walk-through in Markdown that a program executes: the meaning of its lines, and its terminals.

Commands are in code blocks. Numbered lines are actions, lines with a dash the expected results, with words `like these`
and `...` for variable parts. Pictures are taken where the document shows them.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Literal, NamedTuple

ENVIRONMENT = {**os.environ, "COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"}
BETWEEN_INTERRUPTS_S = 1.0
Kind = Literal["command", "action", "promise", "picture"]
KINDS: dict[Kind, str] = {
    "command": r"(cordon .+)",
    "action": r"\d+\. (.+)",
    "promise": r"- (.+)",
    "picture": r"!\[.*\]\((.+)\)",
}


class Line(NamedTuple):
    """A line of the document to execute: the title of its step, its kind, and its words."""

    step: str
    kind: Kind
    words: str


def lines_of(document: str) -> Iterator[Line]:
    """Yield the lines to execute, in order."""
    step = ""
    for text in document.splitlines():
        if text.startswith("## "):
            step = text.removeprefix("## ")
        for kind, form in KINDS.items():
            if step and (found := re.fullmatch(form, text)):
                yield Line(step, kind, found[1])


def pattern(words: str) -> str:
    """Return the pattern of words in which `...` matches any text."""
    return r".{0,80}?".join(re.escape(each) for each in words.split("..."))


@dataclass
class Terminal:
    """A command in its own terminal, with its output so far."""

    process: "subprocess.Popen[str]"
    printed: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, command: str, folder: Path) -> "Terminal":
        """Start a command `cordon ...` in a folder."""
        terminal = cls(
            subprocess.Popen(
                [sys.executable, "-m", "gcs", *shlex.split(command)[1:]],
                cwd=folder,
                env=ENVIRONMENT,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        )
        Thread(target=terminal._read, daemon=True).start()
        return terminal

    def _read(self) -> None:
        assert self.process.stdout is not None
        self.printed.extend(self.process.stdout)

    def text(self) -> str:
        """Return the output."""
        return "".join(tuple(self.printed))

    def exit_code(self) -> str:
        """Return the exit code, empty while the command runs."""
        code = self.process.poll()
        return "" if code is None else str(code)

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        self.process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End the command if it is still running; a flight lands at once."""
        for _ in range(2):
            if self.process.poll() is None:
                self.interrupt()
                time.sleep(BETWEEN_INTERRUPTS_S)
        self.process.wait()
