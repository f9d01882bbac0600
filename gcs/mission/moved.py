"""Keys of earlier versions' mission files, and where each stands today.

An old file is read as if it were written today. Each key that moved is a warning, and a fault in it is reported at the
place where the file has it.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from estimation.settings import TargetBehaviour
from gcs.mission.sections import TUNING

Content = dict[str, Any]


@dataclass(slots=True)
class Moves:
    """What was moved: warnings for the user, faults of keys that stand in both places, and where keys were read."""

    warnings: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    read_at: dict[str, str] = field(default_factory=dict)

    def as_written(self, fault: str) -> str:
        """Return a fault with the place of its key in the file as it was written."""
        place, colon, reason = fault.partition(": ")
        return f"{self.read_at.get(place, place)}{colon}{reason}"

    def key(self, source: Content, old: tuple[str, str], target: Content, new: tuple[str, str]) -> None:
        """Move a key between tables; `old` and `new` are the places of the tables and the names of the key in them."""
        before, after = ".".join(old), ".".join(new)
        value = source.pop(old[1])
        if new[1] in target:
            self.faults.append(f"{before}: moved to {after}, which is given too: leave this one out")
            return
        target[new[1]] = value
        self.read_at[after] = before
        self.warnings.append(f"{before}: moved to {after}")


def modernised(content: Content) -> tuple[Content, Moves]:
    """Return a mission file's content in today's form, and what was moved.

    The section `own_filter` stays where it is: it belongs to the profiles, and applies over each of them.
    """
    content, moves = deepcopy(content), Moves()
    for move in _MOVES:
        move(content, moves)
    return content, moves


def _plants(content: Content, moves: Moves) -> None:
    vehicles = content.get("vehicles")
    for index, vehicle in enumerate(vehicles if isinstance(vehicles, list) else []):
        if isinstance(vehicle, dict) and "plant" in vehicle:
            place = f"vehicles[{index}]"
            moves.key(vehicle, (place, "plant"), vehicle, (place, "profile"))


def _own_filter(content: Content, moves: Moves) -> None:
    section = content.get("own_filter")
    for key in section if isinstance(section, dict) else ():
        moves.warnings.append(
            f"own_filter.{key}: moved to the profile of each vehicle ([own_filter] there); "
            "here it applies to every vehicle over its profile"
        )


def _target_filter(content: Content, moves: Moves) -> None:
    """Move what describes the target to its section, and the rest to `[tuning]`; no table stays for its fault."""
    section = content.get("target_filter")
    if not isinstance(section, dict):
        return
    for key in list(section):
        name = "target" if key in TargetBehaviour.model_fields else "tuning.target_filter"
        _move(content, moves, ("target_filter", key), name)
    del content["target_filter"]


def _tuning(content: Content, moves: Moves) -> None:
    for name, model in TUNING.items():
        section = content.get(name)
        for key in list(section) if isinstance(section, dict) else ():
            if key in model.model_fields:
                _move(content, moves, (name, key), f"tuning.{name}")


def _move(content: Content, moves: Moves, old: tuple[str, str], new: str) -> None:
    """Move a key of a section to another table of the same name, which is made where it is missing."""
    target: Any = content
    for part in new.split("."):
        target = target.setdefault(part, {})
        if not isinstance(target, dict):
            moves.faults.append(f"{'.'.join(old)}: moved to {new}.{old[1]}, and {new} is no table")
            content[old[0]].pop(old[1])
            return
    moves.key(content[old[0]], old, target, (new, old[1]))


_MOVES: tuple[Callable[[Content, Moves], None], ...] = (_plants, _own_filter, _target_filter, _tuning)
