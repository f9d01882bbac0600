"""The event log of one vehicle: its notes are collected here and drained once a tick."""

from typing import Literal

import msgspec

Kind = Literal["tactic", "command", "failsafe", "guard", "ring"]


class Note(msgspec.Struct, frozen=True):
    """One event: time, kind, text, and the numbers behind it."""

    time_s: float
    kind: Kind
    text: str
    because: str = ""


class Notes:
    """Collects the notes of one vehicle in the order in which its stages add them."""

    def __init__(self) -> None:
        self._notes: list[Note] = []

    def add(self, time_s: float, kind: Kind, text: str, because: str = "") -> None:
        """Append a note."""
        self._notes.append(Note(time_s, kind, text, because))

    def drained(self) -> tuple[Note, ...]:
        """Return and remove the notes since the last call."""
        notes = tuple(self._notes)
        self._notes.clear()
        return notes
