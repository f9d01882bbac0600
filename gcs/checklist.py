"""The checklist of a mission on this computer: who has ticked which item, and when.

The page, `cordon fly` and `cordon start` share the ticks by a file in the user's runtime directory. A start uses them
up: the next flight needs new ones.
"""

import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec.structs import replace

from agents.team.participant import name_from
from gcs.errors import InputError
from gcs.keys import private_files
from gcs.mission.mission import ChecklistItem

VALID_S = 12 * 3600.0
"""A tick that is older is of another day."""


def done_by(name: str) -> str:
    """Return who has done a checklist, as a name; raises InputError for none."""
    if not name.strip():
        raise InputError([f"--checklist-done: give the name of a person (given: {name!r})"])
    return name_from(name)


class Ticked(msgspec.Struct, frozen=True):
    """Who ticked an item, and when in Unix time; `used` once a flight has begun with it."""

    by: str
    wall_s: float
    used: bool = False


class Checklist:
    """The items of a mission and their ticks; every method reads the file again, and raises InputError if it cannot."""

    def __init__(self, team: str, items: Sequence[ChecklistItem]) -> None:
        self._team = team
        self.items = tuple(items)

    def ticks(self) -> list[Ticked | None]:
        """Return the tick of each item, also of one that is used, None where there is none."""
        if not self.items:
            return []
        with private_files.locked_runtime_folder() as runtime:
            known = self._read(runtime)
        return [known.get(item.text) for item in self.items]

    def open(self) -> list[ChecklistItem]:
        """Return the required items that are not ticked."""
        items = zip(self.items, self.ticks(), strict=True)
        return [item for item, tick in items if item.required and not _counts(tick)]

    def tick(self, number: int, by: str, *, ticked: bool) -> None:
        """Ticked the item of this number, or remove its tick."""
        with private_files.locked_runtime_folder() as runtime:
            known, text = self._read(runtime), self.items[number].text
            known.pop(text, None)
            if ticked:
                known[text] = Ticked(by, time.time())
            private_files.write(self._file(runtime), msgspec.json.encode(known))

    def tick_all(self, by: str) -> None:
        """Ticked every item that is not ticked."""
        for number, tick in enumerate(self.ticks()):
            if not _counts(tick):
                self.tick(number, by, ticked=True)

    def use(self) -> list[Ticked | None]:
        """Return the ticks that count, which a start uses up."""
        ticks = self.ticks()
        used = {item.text: replace(tick, used=True) for item, tick in zip(self.items, ticks, strict=True) if tick}
        with private_files.locked_runtime_folder() as runtime:
            private_files.write(self._file(runtime), msgspec.json.encode(used))
        return [tick if _counts(tick) else None for tick in ticks]

    def _file(self, runtime: Path) -> Path:
        return runtime / f"checklist-{self._team}.json"

    def _read(self, runtime: Path) -> dict[str, Ticked]:
        path = self._file(runtime)
        if not path.exists():
            return {}
        try:
            known = msgspec.json.decode(private_files.read_private(path), type=dict[str, Ticked])
        except msgspec.DecodeError as error:
            raise InputError([f"{path}: {error}; next: remove it, and tick the items again"]) from error
        return {text: tick for text, tick in known.items() if 0.0 <= time.time() - tick.wall_s < VALID_S}


def _counts(tick: Ticked | None) -> bool:
    """Return whether an item is ticked for the next flight."""
    return tick is not None and not tick.used
