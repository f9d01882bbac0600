"""Key bindings of the live view: a command for one vehicle or for all, and its confirmation."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from agents.team.verbs import VERBS, Verb, VerbRow

ANSWERED_WITHIN_S, TYPED_WITHIN_S = 3.0, 10.0
TYPED_GAP_S = 0.02
"""Keys that follow each other faster are taken as pasted text: only emergency verbs act on them."""
DIGITS_WITHIN_S, SELECTED_FOR_S = 1.5, 10.0
NOTICE_S = 3.0
ESCAPE = "\x1b"
_ROW_OF_KEY = {row.key: row for row in VERBS.values() if row.key}
_KEYS = " · ".join(f"{key} {row.label}" for key, row in _ROW_OF_KEY.items())
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

    def press(self, key: str, now_s: float, piloted: Collection[int] = ()) -> KeyedCommand | None:
        """Return the command of a key that was pressed at `now_s`, None without one.

        `piloted` are the vehicles that pilots fly.
        """
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
            return self._asked(row, now_s, piloted)
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
        return f"vehicle {selection}: {_KEYS} · Esc all" if selection else f"all: {_KEYS} · 1-9 select one"

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

    def _asked(self, row: VerbRow, now_s: float, piloted: Collection[int]) -> KeyedCommand | None:
        """Return the command of a verb, or ask for its confirmation."""
        selection = self._selection(now_s)
        if selection and int(selection) not in self._vehicles:
            self._note(f"there is no vehicle {selection}", now_s)
            return None
        command = KeyedCommand(row.name, int(selection) if selection else None)
        self._question = self._question_about(command, now_s, piloted)
        if self._question is not None:
            return None
        self._digits = ""
        return command

    def _question_about(self, command: KeyedCommand, now_s: float, piloted: Collection[int]) -> _Question | None:
        """Return the question that confirms a command, None if it needs none."""
        of_pilots = [each for each in self._vehicles if each in piloted and command.vehicle in (None, each)]
        whom = _named(self._vehicles if command.vehicle is None else [command.vehicle])
        row = VERBS[command.verb]
        match row.confirmation:
            case "word":
                text = f"type {row.name} and Enter to {row.does} {whom}: "
                return _Question(command, text, f"{row.name}\n", now_s + TYPED_WITHIN_S)
            case "all" if command.vehicle is None:
                text = f"{row.does} {whom}"
            case "pilots" if of_pilots:
                text = f"take {_named(of_pilots)} from the pilot"
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
        case 1:
            return f"vehicle {vehicles[0]}"
        case few if few <= 3:
            return f"{few} vehicles ({', '.join(map(str, vehicles))})"
        case many:
            return f"{many} vehicles"
