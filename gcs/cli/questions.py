"""Questions on the terminal for options that were not given."""

import sys
from collections.abc import Callable
from math import isfinite
from typing import TypeVar

from gcs.errors import InputError

T = TypeVar("T")


class Questions:
    """Asks for missing options on a terminal (`asks`); without a terminal it collects their names."""

    def __init__(self) -> None:
        from gcs.console.terminal import STDERR

        self.asks = sys.stdin.isatty() and STDERR.is_terminal
        self._missing: list[str] = []

    def answer(self, given: object, option: str, question: str, proposal: str, parse: Callable[[str], T]) -> T:
        """Return the value of the option, or the answer if it is None; Enter accepts the proposal.

        Without a terminal it returns the proposal; `require_all` then fails. Raises InputError, also at end of input.
        """
        if given is not None:
            return parsed(option, f"{given}", parse)
        if not self.asks:
            self._missing.append(f"{option}: missing, and there is no terminal to ask on ({question})")
            return parse(proposal)
        return self._asked(option, question, proposal, parse)

    def require_all(self) -> None:
        """Raise InputError with all options that are missing."""
        if self._missing:
            raise InputError(self._missing)

    @staticmethod
    def _asked(option: str, question: str, proposal: str, parse: Callable[[str], T]) -> T:
        from rich.prompt import Prompt
        from rich.text import Text

        from gcs.console.terminal import STDERR, print_line

        while True:
            try:
                return parse(Prompt.ask(Text(question), console=STDERR, default=proposal).strip())
            except EOFError as error:
                raise InputError([f"{option}: the input ended; nothing was written"]) from error
            except ValueError as error:
                print_line(f"{option}: {error}", "yellow")


def parsed(option: str, text: str, parse: Callable[[str], T]) -> T:
    """Return the value of an option; raises InputError."""
    try:
        return parse(text)
    except ValueError as error:
        raise InputError([f"{option}: {error}"]) from error


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of whole numbers from `low` to `high`; it raises ValueError."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise ValueError(f"a whole number between {low} and {high} (given: {text!r})")
        return int(text)

    return read


def number(low: float, high: float, reason: str = "") -> Callable[[str], float]:
    """Return a parser of numbers from `low` to `high`; its ValueError states the reason for the limits."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value) or not low <= value <= high:
            raise ValueError(f"a number between {low:g} and {high:g}{reason}, without unit (given: {text!r})")
        return value

    return read


def one_of(choices: tuple[T, ...]) -> Callable[[str], T]:
    """Return a parser of one of several words; it raises ValueError."""

    def read(text: str) -> T:
        for choice in choices:
            if choice == text:
                return choice
        raise ValueError(f"one of {', '.join(map(str, choices))} (given: {text!r})")

    return read
