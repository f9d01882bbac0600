"""The keyboard of the live view: single keys read from the terminal, their bindings, and their commands."""

import asyncio
import atexit
import os
import signal
import sys
import termios
import tty
from collections.abc import Callable, Collection, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from random import randrange
from time import monotonic
from types import TracebackType
from typing import Self, TextIO

from rich.text import Text

from agents.shell.agent import Agent
from agents.shell.clock import MissionClock
from agents.team.messages import OperatorCommand
from agents.team.verbs import VERBS, Verb, VerbRow

ANSWERED_WITHIN_S, TYPED_WITHIN_S = 3.0, 10.0
TYPED_GAP_S = 0.02
"""Keys that follow each other faster are taken as pasted text: only emergency verbs act on them."""
DIGITS_WITHIN_S, SELECTED_FOR_S = 1.5, 10.0
NOTICE_S = 3.0
ESCAPE = "\x1b"
_ROW_OF_KEY = {row.key: row for row in VERBS.values() if row.key}
_KEYS = " · ".join(f"{key} {row.label}" for key, row in _ROW_OF_KEY.items() if not row.is_for_landed)
_KEYS_LANDED = " · ".join(f"{key} {row.label}" for key, row in _ROW_OF_KEY.items() if row.is_for_landed)
_TOO_FAST = ": keys too fast, taken as pasted text"
_CANCELS = f"y within {ANSWERED_WITHIN_S:g} s; any other key cancels"


@dataclass(frozen=True, slots=True)
class KeyedCommand:
    """A command from the keyboard, to one vehicle or to all (None)."""

    verb: Verb
    vehicle: int | None


@dataclass(frozen=True, slots=True)
class _Question:
    """A command that waits for its confirmation: `rest` of a word is to be typed until `until_s` [wall s]."""

    command: KeyedCommand
    text: str
    rest: str
    until_s: float
    typed: str = ""


class KeyBindings:
    """Maps keys to commands for the vehicles that they can reach; times are wall seconds from any origin.

    Digits select one vehicle for the next command. A kill is confirmed by a typed word; landing or returning all, and a
    resume that takes vehicles back from their pilots, by `y`. A key held down and pasted text confirm nothing.
    """

    def __init__(self, vehicles: Sequence[int]) -> None:
        self._vehicles = vehicles
        self._digits, self._digits_s = "", 0.0
        self._question: _Question | None = None
        self._notice, self._notice_s = "", 0.0
        self._pressed_s: float | None = None
        self._ended: Collection[int] = ()

    def press(
        self, key: str, now_s: float, piloted: Collection[int] = (), ended: Collection[int] = ()
    ) -> KeyedCommand | None:
        """Return the command of a key that was pressed at `now_s`, None without one.

        `piloted` are the vehicles that pilots fly, `ended` those whose flight has ended.
        """
        self._ended = ended
        by_hand = self._pressed_s is None or now_s - self._pressed_s >= TYPED_GAP_S
        self._pressed_s = now_s
        question, self._question = self._open_question(now_s), None
        row = _ROW_OF_KEY.get(key)
        at_once = row is not None and row.confirmation == "at once"
        if question is not None and not at_once:
            return self._answered(question, key, now_s, by_hand)
        if key.isdecimal():
            self._select(key, now_s)
        elif key == ESCAPE:
            self._digits = ""
        elif row is not None and (by_hand or at_once):
            return self._asked(row, now_s, piloted, ended)
        elif row is not None:
            self._note(f"{row.name} is ignored{_TOO_FAST}", now_s)
        return None

    def ignore_paste(self, now_s: float) -> None:
        """Ignore pasted text, and cancel an open question."""
        self._question, self._pressed_s = None, now_s
        self._note("pasted text is ignored", now_s)

    def asks(self, now_s: float) -> bool:
        """Return whether a command waits for its confirmation."""
        return self._open_question(now_s) is not None

    def hint(self, now_s: float) -> str:
        """Return the line to show below the table."""
        question = self._open_question(now_s)
        if question is not None:
            return f"{question.text}{question.typed}"
        if self._notice and now_s - self._notice_s < NOTICE_S:
            return self._notice
        selection = self._selection(now_s)
        if not selection:
            return f"all: {_KEYS} · {min(self._vehicles)}-{max(self._vehicles)} select one"
        if int(selection) not in self._vehicles:
            return f"vehicle {selection}…: type its next digit · Esc all"
        return f"vehicle {selection}: {_KEYS_LANDED if int(selection) in self._ended else _KEYS} · Esc all"

    def _open_question(self, now_s: float) -> _Question | None:
        return self._question if self._question is not None and now_s <= self._question.until_s else None

    def _answered(self, question: _Question, key: str, now_s: float, by_hand: bool) -> KeyedCommand | None:
        """Process the next key of a confirmation; return the command once the word is complete."""
        if not by_hand or not question.rest.startswith(key):
            self._digits = ""
            self._note(f"{question.command.verb} is cancelled{'' if by_hand else _TOO_FAST}", now_s)
            return None
        if question.rest != key:
            self._question = replace(question, rest=question.rest.removeprefix(key), typed=question.typed + key)
            return None
        self._digits = ""
        return question.command

    def _asked(
        self, row: VerbRow, now_s: float, piloted: Collection[int], ended: Collection[int]
    ) -> KeyedCommand | None:
        """Return the command of a verb, or ask for its confirmation."""
        selection = self._selection(now_s)
        if selection and int(selection) not in self._vehicles:
            self._note(f"there is no vehicle {selection}", now_s)
            return None
        if row.is_for_landed and not selection:
            self._note(f"{row.name}: select a vehicle that has landed first", now_s)
            return None
        if selection and (int(selection) in ended) is not row.is_for_landed:
            state = "not ended" if row.is_for_landed else "ended"
            self._note(f"the flight of vehicle {selection} has {state}", now_s)
            return None
        command = KeyedCommand(row.name, int(selection) if selection else None)
        self._question = self._question_about(command, now_s, piloted, ended)
        if self._question is not None:
            return None
        self._digits = ""
        return command

    def _question_about(
        self, command: KeyedCommand, now_s: float, piloted: Collection[int], ended: Collection[int]
    ) -> _Question | None:
        """Return the question that confirms a command, None if it needs none."""
        flying = [each for each in self._vehicles if each not in ended]
        asked = flying if command.vehicle is None else [command.vehicle]
        of_pilots = [each for each in asked if each in piloted]
        whom = _named(asked)
        row = VERBS[command.verb]
        match row.confirmation:
            case "word":
                text = f"type {row.name} and Enter to {row.does} {whom}: "
                return _Question(command, text, f"{row.name}\n", now_s + TYPED_WITHIN_S)
            case "take-off":
                text = f"{row.does} {whom}"
            case "all" if command.vehicle is None:
                text = f"{row.does} {whom}"
            case "pilots" if of_pilots:
                text = f"take {_named(of_pilots)} from pilot or autopilot"
            case _:
                return None
        return _Question(command, f"{text}? {_CANCELS}", "y", now_s + ANSWERED_WITHIN_S)

    def _selection(self, now_s: float) -> str:
        """Return the digits of the vehicle that the next command is for, empty for all."""
        return self._digits if now_s - self._digits_s < SELECTED_FOR_S else ""

    def _select(self, digit: str, now_s: float) -> None:
        """Add a digit to the selection, or begin another one if no vehicle's id continues with it; 0 selects all."""
        before = self._digits if now_s - self._digits_s < DIGITS_WITHIN_S else ""
        ids = [str(each) for each in self._vehicles]
        fitting = [text for text in (before + digit, digit) if any(each.startswith(text) for each in ids)]
        self._digits, self._digits_s = fitting[0] if fitting else "", now_s
        if not fitting and digit != "0":
            self._note(f"there is no vehicle {before + digit}", now_s)

    def _note(self, text: str, now_s: float) -> None:
        self._notice, self._notice_s = text, now_s


def _named(vehicles: Sequence[int]) -> str:
    """Return vehicles as text, up to three by their ids."""
    match len(vehicles):
        case 0:
            return "no vehicle"
        case 1:
            return f"vehicle {vehicles[0]}"
        case few if few <= 3:
            return f"{few} vehicles ({', '.join(map(str, vehicles))})"
        case many:
            return f"{many} vehicles"


Elsewhere = Callable[[KeyedCommand, int], Coroutine[object, object, None]]
"""Sends a command of this number to the vehicles of other processes."""
_QUESTION = "bold white on red"


class KeyCommands:
    """Sends a command for each key, or once it is confirmed.

    The agents of this process receive it directly, those of other processes by `elsewhere`. `piloted` returns those
    that pilots fly, `ended` those whose flight has ended.
    """

    def __init__(
        self,
        agents: Sequence[Agent],
        clock: MissionClock,
        operator: str,
        elsewhere: Elsewhere,
        bindings: KeyBindings,
        piloted: Callable[[], Collection[int]],
        ended: Callable[[], Collection[int]],
    ) -> None:
        self._agents = agents
        self._clock = clock
        self._operator = operator
        self._elsewhere = elsewhere
        self._bindings = bindings
        self._piloted = piloted
        self._ended = ended
        self._sending: dict[int | None, asyncio.Task[None]] = {}

    @property
    def hint(self) -> Text:
        """The keys and their commands, or the open question."""
        now_s = monotonic()
        return Text(self._bindings.hint(now_s), style=_QUESTION if self._bindings.asks(now_s) else "dim")

    def press(self, key: str) -> None:
        """Handle a key."""
        command = self._bindings.press("\n" if key == "\r" else key, monotonic(), self._piloted(), self._ended())
        if command is not None:
            self._send(command)

    def ignore_paste(self) -> None:
        """Ignore pasted text."""
        self._bindings.ignore_paste(monotonic())

    def _send(self, keyed: KeyedCommand) -> None:
        command = OperatorCommand(self._clock.now_s(), keyed.verb, keyed.vehicle, self._operator, randrange(2**32))
        for agent in self._agents:
            agent.obey(command)
        # A superseded command must not arrive after the command that supersedes it.
        for receiver in [each for each in self._sending if keyed.vehicle in (None, each)]:
            self._sending.pop(receiver).cancel()
        self._sending[keyed.vehicle] = asyncio.create_task(self._elsewhere(keyed, command.number))


AT_ONCE_MAX = 3
"""More characters in one read are pasted text or an escape sequence, and ignored."""
PASTE_BEGINS, PASTE_ENDS = "\x1b[200~", "\x1b[201~"
"""Markers of a terminal around pasted text in bracketed paste mode (`gcs.console.live`)."""


class Keyboard:
    """Context manager that reads single keys from the terminal on standard input; inactive without a terminal.

    The terminal settings are restored when the program ends, except after SIGKILL. A background job reads no keys and
    is not stopped by SIGTTIN.
    """

    def __init__(
        self, on_key: Callable[[str], object], on_paste: Callable[[], object], stream: TextIO | None = None
    ) -> None:
        """Call `on_key` on the event loop with each key, `on_paste` for pasted text; `stream` is standard input."""
        self._on_key = on_key
        self._on_paste = on_paste
        self._pasted: str | None = None
        self._stream = sys.stdin if stream is None else stream
        self._fd = -1
        self._before: list[object] = []

    @property
    def active(self) -> bool:
        """Whether keys are read."""
        return self._fd >= 0

    def __enter__(self) -> Self:
        """Switch the terminal to unbuffered input without echo."""
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
        """Restore the terminal."""
        if self.active:
            asyncio.get_running_loop().remove_reader(self._fd)
        self._restore()

    def _restore(self) -> None:
        atexit.unregister(self._restore)
        fd, self._fd = self._fd, -1
        if fd >= 0:
            with suppress(termios.error, ValueError):  # the terminal is gone: nothing to restore
                termios.tcsetattr(fd, termios.TCSANOW, self._before)  # type: ignore[arg-type]

    def _read(self) -> None:
        try:
            pressed = os.read(self._fd, 256).decode("ascii", "ignore")
        except OSError:
            pressed = ""
        if not pressed:  # the terminal hung up, or another job owns it
            asyncio.get_running_loop().remove_reader(self._fd)
        else:
            self._take(pressed)

    def _take(self, pressed: str) -> None:
        """Process the characters of one read: single keys, or pasted text from its begin to its end."""
        if self._pasted is None and PASTE_BEGINS in pressed:
            self._pasted = ""
        if self._pasted is not None:
            # The end marker may be split over two reads.
            text = self._pasted + pressed
            self._pasted = None if PASTE_ENDS in text else text[-len(PASTE_ENDS) :]
            self._on_paste()
        elif ESCAPE in pressed and pressed != ESCAPE:
            pass  # an arrow or a function key
        elif len(pressed) > AT_ONCE_MAX:
            self._on_paste()
        else:
            for key in pressed:
                self._on_key(key)


def _in_foreground(stream: TextIO) -> bool:
    try:
        return stream.isatty() and os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError):
        return False
