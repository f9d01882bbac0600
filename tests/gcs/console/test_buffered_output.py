"""A terminal that takes no output, as after Ctrl-S: a real one that is not read."""

import os
import pty
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.slow

WRITER = """
import time
from gcs.console.buffered_output import unblocked
from gcs.console.terminal import STDERR, print_line
worst = 0.0
with unblocked(STDERR):
    for number in range(400):
        began = time.monotonic()
        print_line(f"line {number} " + "x" * 1000)
        worst = max(worst, time.monotonic() - began)
        time.sleep(0.005)
    time.sleep(0.2)
    print("done", worst, flush=True)
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
    word, worst_s = process.stdout.readline().split()
    assert (word, float(worst_s) < 0.5) == ("done", True)
    time.sleep(1.0)
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()
    text = rest(reader)
    assert process.wait(10.0) == 0
    assert "line 0 " in text
    assert "line 399 " not in text, "more than the buffer holds"
    assert "took no output for" in text
    os.close(reader)


def test_a_process_ends_although_its_terminal_takes_no_output() -> None:
    process, reader = start()
    output, _ = process.communicate("\n", 15.0)
    assert output.endswith("left\n")
    assert process.returncode == 0
    os.close(reader)
