"""Standard output that is closed or full, and terminals of no size: no verb ends in a traceback."""

import os
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from gcs.console.terminal import whole_words
from tests.conftest import RunHere

pytestmark = pytest.mark.slow
RESULTS = (("missions", "--json"), ("fly", "--help"))


def cordon(*words: str, stdout: int, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command with this standard output: at its end, Python writes what is left."""
    return subprocess.run(
        [sys.executable, "-m", "gcs", *words],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("words", RESULTS, ids=" ".join)
def test_full_output_is_an_error_in_a_line_and_a_closed_one_is_none(words: tuple[str, ...]) -> None:
    with Path("/dev/full").open("wb") as full:
        ran = cordon(*words, stdout=full.fileno(), COLUMNS="0")
    assert (ran.returncode, ran.stderr) == (2, "standard output: No space left on device\n")
    reader, writer = os.pipe()
    os.close(reader)
    ran = cordon(*words, stdout=writer, COLUMNS="0")
    os.close(writer)
    assert ran.stderr == ""


@pytest.mark.parametrize("columns", ["0", "²", "1", "80", "99999999999"])
def test_no_verb_sees_a_size_that_is_none(columns: str, run_here: RunHere, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setenv("LINES", columns)
    assert run_here("--version").code == 0
    assert [os.environ.get(name) for name in ("COLUMNS", "LINES")] == [columns if columns in ("1", "80") else None] * 2


def test_line_on_a_terminal_breaks_between_words() -> None:
    """And nowhere else: what a terminal would break inside a word has begun another line."""
    text = (
        "next: recover the vehicle at 47.397742, 8.545594; altitudes-of-neighbours /a/path/that/is/longer/than/the/line"
    )
    console = Console(file=StringIO(), force_terminal=True, width=30, _environ={"TERM": "xterm"})
    lines = whole_words(text, console).split("\n")
    assert " ".join(line.strip() for line in lines) == text
    assert all(len(line) <= 30 for line in lines[:-1])
    assert whole_words(text, Console(file=StringIO(), width=30)) == text
