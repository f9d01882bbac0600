"""The keys of the live view: what they mean, and the terminal they are read from."""

import asyncio
import os
import pty
import select
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Sequence

import pytest

from gcs.console.keyboard import HINT, KILL_CONFIRMED_WITHIN_S, KeyBindings, Keyboard
from tests.support.paths import ROOT

WAIT_S = 20.0


def test_a_key_is_a_verb_and_a_kill_takes_two(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[str, list[str]], ...] = (
        ("hrlta", ["hold", "resume", "land", "rtl", "abort"]),
        ("k", []),
        ("kk", ["kill"]),
        ("ky", ["kill"]),
        ("kn", []),
        ("knk", []),
        ("kh", ["hold"]),
        ("y", []),
        ("kkk", ["kill"]),
        ("xyzHKQ\n ", []),
    )
    for pressed, verbs in rows:
        with subtests.test(pressed=pressed, verbs=verbs):
            meaning = KeyBindings()
            assert [verb for key in pressed if (verb := meaning.press(key, 1.0)) is not None] == verbs


@pytest.mark.parametrize(
    ("after_s", "verb"), [(KILL_CONFIRMED_WITHIN_S, "kill"), (KILL_CONFIRMED_WITHIN_S + 0.01, None)]
)
def test_a_kill_is_confirmed_in_time_or_not_at_all(after_s: float, verb: str | None) -> None:
    meaning = KeyBindings()
    meaning.press("k", 10.0)
    assert "motors" in meaning.hint(10.0)
    assert (meaning.hint(10.0 + after_s) == HINT) == (verb is None)
    assert meaning.press("y", 10.0 + after_s) == verb


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Return both ends of a terminal: the person's, and the program's."""
    person, program = pty.openpty()
    yield person, program
    os.close(person)
    os.close(program)


def settings(fd: int) -> Sequence[object]:
    return termios.tcgetattr(fd)


async def test_no_terminal_no_keys() -> None:
    with (ROOT / "README.md").open(encoding="utf-8") as stream, Keyboard(print, stream) as keys:
        assert not keys.active


def test_a_terminal_that_is_another_jobs_is_left_alone(terminal: tuple[int, int]) -> None:
    async def look() -> bool:
        with os.fdopen(os.dup(terminal[1])) as stream, Keyboard(print, stream) as keys:
            return keys.active

    before = settings(terminal[1])
    assert not asyncio.run(look()), "it is not this process's own terminal"
    assert settings(terminal[1]) == before


PROGRAM = """
import asyncio, fcntl, sys, termios
from gcs.console.keyboard import Keyboard

async def main():
    done = asyncio.Event()
    def press(key):
        print("pressed", key, flush=True)
        if key == "q":
            done.set()
        if key == "x":
            raise SystemExit(7)
        if key == "e":
            loop.call_soon(task.cancel)
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    with Keyboard(press) as keys:
        print("active", keys.active, flush=True)
        await done.wait()

fcntl.ioctl(0, termios.TIOCSCTTY, 0)
asyncio.run(main())
"""


@pytest.mark.wire
@pytest.mark.parametrize(("ending", "code"), [("q", 0), ("x", 7), ("e", 1)])
def test_keys_arrive_one_by_one_and_the_terminal_is_restored(ending: str, code: int, terminal: tuple[int, int]) -> None:
    person, program = terminal
    before = settings(person)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PROGRAM]
    with subprocess.Popen(  # its own session, with this terminal as its own
        command, stdin=program, stdout=program, stderr=program, env=environment, start_new_session=True
    ) as child:
        try:
            heard = _read_until(person, "active True")
            assert settings(person) != before, "keys would come line by line"
            os.write(person, b"h")
            heard += _read_until(person, "pressed h")
            os.write(person, b"kkkkkkkk")  # pasted
            os.write(person, b"\x1b[A")  # an arrow
            heard += _press_until(person, ending, f"pressed {ending}")
            assert child.wait(WAIT_S) == code
        finally:
            child.kill()
    assert settings(person) == before
    assert "pressed k" not in heard
    assert "pressed A" not in heard


def _press_until(fd: int, key: str, text: str) -> str:
    """Press a key again and again: read together with what was pasted before it, it would count as pasted too."""
    heard = ""
    end_s = time.monotonic() + WAIT_S
    while text not in heard:
        assert time.monotonic() < end_s, heard
        os.write(fd, key.encode())
        heard += _heard(fd, 0.2)
    return heard


def _read_until(fd: int, text: str) -> str:
    heard = ""
    end_s = time.monotonic() + WAIT_S
    while text not in heard:
        assert time.monotonic() < end_s, heard
        heard += _heard(fd, 0.2)
    return heard


def _heard(fd: int, within_s: float) -> str:
    return os.read(fd, 4096).decode(errors="replace") if select.select([fd], [], [], within_s)[0] else ""
