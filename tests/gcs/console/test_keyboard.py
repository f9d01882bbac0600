"""The keys of the live view: what they mean, and the terminal they are read from."""

import asyncio
import os
import pty
import select
import subprocess
import sys
import termios
import time
from collections.abc import Collection, Iterator, Sequence
from types import SimpleNamespace
from typing import Any, cast

import pytest

from agents.team.messages import OperatorCommand
from gcs.console.keyboard import (
    ANSWERED_WITHIN_S,
    DIGITS_WITHIN_S,
    SELECTED_FOR_S,
    KeyBindings,
    Keyboard,
    KeyCommands,
    KeyedCommand,
)
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S

TEAM = (1, 2, 3)
BY_HAND_S = 0.15


def commands(
    keys: str,
    *,
    every_s: float = BY_HAND_S,
    team: Sequence[int] = TEAM,
    piloted: Collection[int] = (),
    ended: Collection[int] = (),
) -> list[tuple[str, int | None]]:
    """Return the commands of keys that are pressed one after the other: verbs and vehicles."""
    bindings = KeyBindings(team)
    given: list[tuple[str, int | None]] = []
    for number, key in enumerate(keys):
        command = bindings.press(key, 100.0 + number * every_s, piloted, ended)
        if command is not None:
            given.append((command.verb, command.vehicle))
    return given


def test_keys_and_what_confirms_them(subtests: pytest.Subtests) -> None:
    for keys, given in (
        ("hra", [("hold", None), ("resume", None), ("abort", None)]),
        ("ly", [("land", None)]),
        ("ty", [("rtl", None)]),
        ("ll", []),
        ("lny", []),
        ("lh", [("hold", None)]),
        ("kkill\n", [("kill", None)]),
        ("kkill", []),
        ("kkil\n", []),
        ("kkih", [("hold", None)]),
        ("2kkl", []),
        ("2kkk3l", [("land", 3)]),
        ("kill\n", []),
        ("xyzHKQ\n ", []),
        ("2hh", [("hold", 2), ("hold", None)]),
        ("2l3t", [("land", 2), ("rtl", 3)]),
        ("2kkill\n", [("kill", 2)]),
        ("2\x1bh", [("hold", None)]),
        ("20h", [("hold", None)]),
        ("23h", [("hold", 3)]),
        ("9h", [("hold", None)]),
    ):
        with subtests.test(keys=keys):
            assert commands(keys) == given


def test_digits_select_vehicles_of_two_digits(subtests: pytest.Subtests) -> None:
    many = (1, 2, 10, 12, 31)
    for keys, given in (
        ("12h", [("hold", 12)]),
        ("1h", [("hold", 1)]),
        ("112h", [("hold", 12)]),
        ("3h", []),
    ):
        with subtests.test(keys=keys):
            assert commands(keys, team=many) == given
    assert commands("12h", team=many, every_s=DIGITS_WITHIN_S + 0.1) == [("hold", 2)]


def test_hint_says_what_selects_a_vehicle(subtests: pytest.Subtests) -> None:
    for team, keys, hint in (
        (tuple(range(1, 33)), "", "1-32 select one"),
        (tuple(range(1, 33)), "12", "vehicle 12: "),
        ((1, 30, 31), "3", "vehicle 3…: type its next digit"),
    ):
        with subtests.test(team=team, keys=keys):
            bindings = KeyBindings(team)
            for key in keys:
                bindings.press(key, 10.0)
            assert hint in bindings.hint(10.0)
            assert len(bindings.hint(10.0)) <= 80


def test_vehicles_whose_flight_has_ended_are_not_counted_or_asked() -> None:
    bindings = KeyBindings(TEAM)
    bindings.press("l", 10.0, (), (2,))
    assert "land 2 vehicles (1, 3)?" in bindings.hint(10.0)
    assert commands("2h", ended=(2,)) == []
    assert commands("r", piloted=(2,), ended=(2,)) == [("resume", None)]


def test_a_selection_is_for_the_next_command_and_does_not_last() -> None:
    bindings = KeyBindings(TEAM)
    bindings.press("2", 10.0)
    assert "vehicle 2" in bindings.hint(10.0)
    assert "vehicle 2" not in bindings.hint(10.0 + SELECTED_FOR_S)
    assert bindings.press("h", 10.0 + SELECTED_FOR_S) == KeyedCommand("hold", None)


def test_neither_a_key_that_is_held_down_nor_a_paste_confirms_anything(subtests: pytest.Subtests) -> None:
    """Also text that arrives key by key."""
    held = [(key * 1000, every_s) for key in "kltr" for every_s in (0.01, 0.5)]
    pasted = [(text, every_s) for text in ("kkkkyyyy", "kkill\nkkill\n", "lyly", "ryry") for every_s in (0.0, 0.002)]
    for keys, every_s in held + pasted:
        with subtests.test(keys=keys[:12], every_s=every_s):
            assert commands(keys, every_s=every_s, piloted=(2,)) == []


def test_a_paste_ends_an_open_question() -> None:
    bindings = KeyBindings(TEAM)
    bindings.press("l", 10.0)
    bindings.ignore_paste(10.5)
    assert "pasted" in bindings.hint(10.5)
    assert bindings.press("y", 11.0) is None


def test_a_vehicle_that_its_pilot_has_is_taken_back_only_when_that_is_confirmed(subtests: pytest.Subtests) -> None:
    for keys, given in (
        ("rr", []),
        ("ry", [("resume", None)]),
        ("2r", []),
        ("2ry", [("resume", 2)]),
        ("1r", [("resume", 1)]),
    ):
        with subtests.test(keys=keys):
            assert commands(keys, piloted=(2,)) == given


def test_questions_name_what_they_are_about(subtests: pytest.Subtests) -> None:
    for keys, words in (
        ("t", ("return", "3 vehicles", "y within 3 s")),
        ("kki", ("type kill", "motors", "3 vehicles", ": ki")),
        ("2k", ("type kill", "vehicle 2")),
        ("2r", ("vehicle 2", "pilot", "y within 3 s")),
    ):
        with subtests.test(keys=keys):
            bindings = KeyBindings(TEAM)
            for number, key in enumerate(keys):
                bindings.press(key, 10.0 + number * BY_HAND_S, (2,))
            hint = bindings.hint(11.0)
            assert bindings.asks(11.0)
            assert all(word in hint for word in words), hint
            assert len(hint) <= 80


@pytest.mark.parametrize(("after_s", "confirms"), [(ANSWERED_WITHIN_S, True), (ANSWERED_WITHIN_S + 0.01, False)])
def test_a_confirmation_comes_in_time_or_not_at_all(after_s: float, confirms: bool) -> None:
    bindings = KeyBindings(TEAM)
    bindings.press("t", 10.0)
    assert bindings.asks(10.0 + after_s) == confirms
    assert bindings.press("y", 10.0 + after_s) == (KeyedCommand("rtl", None) if confirms else None)


class Agent:
    """What a vehicle's agent takes from the keyboard."""

    def __init__(self) -> None:
        self.numbered: list[tuple[str, int | None, int]] = []

    @property
    def taken(self) -> list[tuple[str, int | None]]:
        return [(verb, vehicle) for verb, vehicle, _ in self.numbered]

    def obey(self, command: OperatorCommand) -> None:
        self.numbered.append((command.verb, command.vehicle, command.number))


async def test_a_command_is_sent_elsewhere_until_a_newer_one_to_the_same_vehicle() -> None:
    agent, sending = Agent(), list[tuple[str, int | None]]()

    async def elsewhere(keyed: KeyedCommand, number: int) -> None:
        sending.append((keyed.verb, keyed.vehicle))
        assert (keyed.verb, keyed.vehicle, number) == agent.numbered[-1], "vehicles here may receive both"
        try:
            await asyncio.Event().wait()
        finally:
            sending.remove((keyed.verb, keyed.vehicle))

    agents, clock = cast(Any, [agent]), cast(Any, SimpleNamespace(now_s=lambda: 5.0))
    keys = KeyCommands(agents, clock, "pat", elsewhere, KeyBindings(TEAM), set, set)
    for pressed, sent in (
        ("2h", [("hold", 2)]),
        ("3h", [("hold", 2), ("hold", 3)]),
        ("2a", [("hold", 3), ("abort", 2)]),
        ("h", [("hold", None)]),
    ):
        for key in pressed:
            keys.press(key)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert sending == sent
    assert agent.taken == [("hold", 2), ("hold", 3), ("abort", 2), ("hold", None)]


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
    with (ROOT / "README.md").open(encoding="utf-8") as stream, Keyboard(print, print, stream) as keys:
        assert not keys.active


def test_a_terminal_that_is_another_jobs_is_left_alone(terminal: tuple[int, int]) -> None:
    async def look() -> bool:
        with os.fdopen(os.dup(terminal[1])) as stream, Keyboard(print, print, stream) as keys:
            return keys.active

    before = settings(terminal[1])
    assert not asyncio.run(look()), "it is not this process's own terminal"
    assert settings(terminal[1]) == before


PROGRAM = """
import asyncio, fcntl, sys, termios
from gcs.console.keyboard import Keyboard

async def main():
    def press(key):
        print("pressed", key, flush=True)
        if key == "e":
            loop.call_soon(task.cancel)
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    with Keyboard(press, lambda: print("pasted", flush=True)) as keys:
        print("active", keys.active, flush=True)
        await asyncio.Event().wait()

fcntl.ioctl(0, termios.TIOCSCTTY, 0)
asyncio.run(main())
"""


@pytest.mark.wire
def test_keys_arrive_one_by_one_and_the_terminal_is_restored(terminal: tuple[int, int]) -> None:
    person, program = terminal
    before = settings(person)
    command = [sys.executable, "-c", PROGRAM]
    with subprocess.Popen(  # its own session, with this terminal as its own
        command, stdin=program, stdout=program, stderr=program, start_new_session=True
    ) as child:
        try:
            heard = _read_until(person, "active True")
            assert settings(person) != before, "keys would come line by line"
            os.write(person, b"h")
            heard += _read_until(person, "pressed h")
            os.write(person, b"kkkkyyyy")
            heard += _read_until(person, "pasted")
            os.write(person, b"\x1b[A")  # an arrow
            time.sleep(0.1)
            for part in (b"\x1b[200~k", b"ki", b"ll", b"\n\x1b[2", b"01~"):  # as a terminal sends a paste slowly
                os.write(person, part)
                heard += _read_until(person, "pasted")
            os.write(person, b"\x1b")
            heard += _read_until(person, "pressed \x1b")
            heard += _press_until(person, "e", "pressed e")
            assert child.wait(PATIENCE_S) == 1, "it was cancelled"
        finally:
            child.kill()
    assert settings(person) == before
    assert "pressed k" not in heard
    assert "pressed A" not in heard


def _press_until(fd: int, key: str, text: str) -> str:
    """Press a key again and again: read together with what was pasted before it, it would count as pasted too."""
    heard = ""
    end_s = time.monotonic() + PATIENCE_S
    while text not in heard:
        assert time.monotonic() < end_s, heard
        os.write(fd, key.encode())
        heard += _heard(fd, 0.2)
    return heard


def _read_until(fd: int, text: str) -> str:
    heard = ""
    end_s = time.monotonic() + PATIENCE_S
    while text not in heard:
        assert time.monotonic() < end_s, heard
        heard += _heard(fd, 0.2)
    return heard


def _heard(fd: int, within_s: float) -> str:
    return os.read(fd, 4096).decode(errors="replace") if select.select([fd], [], [], within_s)[0] else ""
