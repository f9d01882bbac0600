"""A terminal that takes no output, as after Ctrl-S: a real one that is not read."""

import os
import pty
import subprocess
import sys

import pytest

from tests.support.wire import PATIENCE_S

pytestmark = pytest.mark.slow

WRITER = """
import time
from gcs.console.buffered_output import unblocked
from gcs.console.terminal import STDERR, print_line
with unblocked(STDERR):
    for number in range(400):
        print_line(f"line {number} " + "x" * 1000)
        time.sleep(0.005)  # the terminal takes no output for longer than is reported
    time.sleep(0.2)
    print("done", flush=True)
    input()
print("left", flush=True)
"""


def start() -> tuple[subprocess.Popen[str], int]:
    """Start a process that prints 400 lines to a terminal which holds a few of them; return it and the reader's end."""
    reader, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=terminal, text=True
    )
    os.close(terminal)
    return process, reader


def rest(reader: int) -> str:
    """Read all that comes, until the terminal's other end is closed."""
    text = b""
    try:
        while data := os.read(reader, 65536):
            text += data
    except OSError:
        pass
    return text.decode()


def test_nothing_waits_for_a_terminal_that_takes_no_output_and_it_says_so_afterwards() -> None:
    process, reader = start()
    assert process.stdout is not None
    assert process.stdout.readline() == "done\n", "before anybody reads what it printed"
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()
    text = rest(reader)
    assert process.wait(PATIENCE_S) == 0
    assert "line 0" in text
    assert "line 399 " not in text, "more than the buffer holds"
    assert "took no output for" in text
    os.close(reader)


def test_a_process_ends_although_its_terminal_takes_no_output() -> None:
    process, reader = start()
    output, _ = process.communicate("\n", PATIENCE_S)
    assert output.endswith("left\n")
    assert process.returncode == 0
    os.close(reader)
