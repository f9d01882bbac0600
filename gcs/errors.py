"""The exit codes that users and scripts rely on, and the error for bad input."""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple


class Exit(IntEnum):
    """How a command ended."""

    HOLDS = 0
    """Success; all verdicts pass."""
    VERDICT_FAILED = 1
    """Flown, but a verdict fails or could not be judged; or a log is damaged."""
    BAD_INPUT = 2
    """Bad input; every fault is listed."""
    REFUSED = 3
    """Refused before take-off."""
    ENDED_IN_FLIGHT = 4
    """Ended in flight by a failsafe or the operator."""


class KeyFault(NamedTuple):
    """A fault of the input: the path of its key or the name of its source, the reason, and the line if it is known.

    The place is empty for a text that names it itself; lines count from 1.
    """

    place: str
    reason: str
    line: int = 0

    def __str__(self) -> str:
        return f"{self.place}: {self.reason}" if self.place else self.reason


class InputError(Exception):
    """The user's input is invalid; `faults` holds one line for each fault."""

    def __init__(self, faults: Sequence[KeyFault | str]) -> None:
        self.placed = tuple(fault if isinstance(fault, KeyFault) else KeyFault("", fault) for fault in faults)
        """The faults as values."""
        self.faults = tuple(" ".join(str(fault).splitlines()) for fault in faults)
        super().__init__("\n".join(self.faults))

    def __reduce__(self) -> "tuple[type[InputError], tuple[tuple[KeyFault, ...]]]":
        """Return how it is made again in another process: of its faults, not of its text."""
        return type(self), (self.placed,)
