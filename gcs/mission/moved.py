"""Keys of earlier versions' mission files, and their present places, if they have one.

A file of an earlier version is converted before it is read. Each moved key is a warning; a fault in it is reported at
its place in the file.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from agents.ring.transition import ACCELERATION_MAX_M_S2, JERK_MAX_M_S3
from agents.team.clock_watch import STEP_S
from estimation.settings import TargetBehaviour
from gcs.errors import Fault
from gcs.mission.sections import TUNING

Content = dict[str, Any]
CONSTANTS = {
    ("encirclement", "spacing_acceleration_max_m_s2"): ACCELERATION_MAX_M_S2,
    ("encirclement", "spacing_jerk_max_m_s3"): JERK_MAX_M_S3,
    ("tuning", "failsafe", "clock_step_s"): STEP_S,
    ("failsafe", "clock_step_s"): STEP_S,
}
"""Keys that are none any more, by their paths, and the values that are flown instead."""


@dataclass(slots=True)
class MovedKeys:
    """The moved keys: warnings, faults of keys given at both places, and the places in the file."""

    warnings: list[str] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    read_at: dict[str, str] = field(default_factory=dict)

    def as_written(self, fault: Fault) -> Fault:
        """Return a fault with its key's place in the original file."""
        return fault._replace(place=self.read_at.get(fault.place, fault.place))

    def key(self, source: Content, old: tuple[str, str], target: Content, new: tuple[str, str]) -> None:
        """Move a key between tables; `old` and `new` are (place of the table, name of the key)."""
        before, after = ".".join(old), ".".join(new)
        value = source.pop(old[1])
        if new[1] in target:
            self.faults.append(Fault(before, f"moved to {after}, which is given too: leave this one out"))
            return
        target[new[1]] = value
        self.read_at[after] = before
        self.warnings.append(f"{before}: moved to {after}")


def modernised(content: Content) -> tuple[Content, MovedKeys]:
    """Return a mission file's content in the present form, and what was moved.

    The section `own_filter` is not moved: it belongs to the profiles, and overrides each of them.
    """
    content, moves = deepcopy(content), MovedKeys()
    for move in _MOVES:
        move(content, moves)
    return content, moves


def _plants(content: Content, moves: MovedKeys) -> None:
    vehicles = content.get("vehicles")
    for index, vehicle in enumerate(vehicles if isinstance(vehicles, list) else []):
        if isinstance(vehicle, dict) and "plant" in vehicle:
            place = f"vehicles[{index}]"
            moves.key(vehicle, (place, "plant"), vehicle, (place, "profile"))


def _own_filter(content: Content, moves: MovedKeys) -> None:
    section = content.get("own_filter")
    for key in section if isinstance(section, dict) else ():
        moves.warnings.append(
            f"own_filter.{key}: moved to the profile of each vehicle ([own_filter] there); "
            "here it overrides every vehicle's profile"
        )


def _target_filter(content: Content, moves: MovedKeys) -> None:
    """Move keys that describe the target to `[target]`, the others to `[tuning]`; keep anything but a table."""
    section = content.get("target_filter")
    if not isinstance(section, dict):
        return
    for key in list(section):
        name = "target" if key in TargetBehaviour.model_fields else "tuning.target_filter"
        _move(content, moves, ("target_filter", key), name)
    del content["target_filter"]


def _tuning(content: Content, moves: MovedKeys) -> None:
    for name, model in TUNING.items():
        section = content.get(name)
        for key in list(section) if isinstance(section, dict) else ():
            if key in model.model_fields:
                _move(content, moves, (name, key), f"tuning.{name}")


def _constants(content: Content, moves: MovedKeys) -> None:
    """Leave out keys that became constants; another value than the constant is a fault, as it would not be flown."""
    for (*tables, key), constant in CONSTANTS.items():
        section: Any = content
        for name in tables:
            section = section.get(name) if isinstance(section, dict) else None
        if isinstance(section, dict) and key in section:
            place, value = ".".join((*tables, key)), section.pop(key)
            if value == constant:
                moves.warnings.append(f"{place}: no longer a key, its value is always {constant:g}: leave it out")
            else:
                moves.faults.append(Fault(place, f"no longer a key, its value is always {constant:g}, not {value!r}"))


def _move(content: Content, moves: MovedKeys, old: tuple[str, str], new: str) -> None:
    """Move a key of a section to another table of the same name, which is created if it is missing."""
    target: Any = content
    for part in new.split("."):
        target = target.setdefault(part, {})
        if not isinstance(target, dict):
            moves.faults.append(Fault(".".join(old), f"moved to {new}.{old[1]}, but {new} is not a table"))
            content[old[0]].pop(old[1])
            return
    moves.key(content[old[0]], old, target, (new, old[1]))


_MOVES: tuple[Callable[[Content, MovedKeys], None], ...] = (_plants, _own_filter, _target_filter, _tuning, _constants)
