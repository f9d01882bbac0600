"""The tables `[[targets]]` and `[[rings]]` of a mission file, each completed from `[target]` and `[encirclement]`."""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from agents.settings.sections import EncirclementSection
from agents.team.messages import RINGS_MAX, TARGETS_MAX
from agents.team.verbs import AUTO
from estimation.settings import Settings, TargetBehaviour
from gcs.errors import KeyFault
from gcs.mission.mission import RingSection, TargetSection
from gcs.mission.validation import shown, unknown_keys, validated

_PARTS = re.compile(r"[^.\[\]]+|\[\d+\]")
_S = TypeVar("_S", bound=Settings)
_Content = Mapping[str, Any]
_Targets = tuple[TargetSection | None, ...]


class ReadRing(NamedTuple):
    """A valid table of a ring: its number in the file, its name, and its target's number, None if that has faults."""

    number: int
    section: RingSection
    name: str
    target: int | None


def read_targets(content: _Content, faults: list[KeyFault]) -> _Targets | None:
    """Return the targets of a file's content, None for each that is not valid; None if the file has one `[target]`."""
    if "targets" not in content:
        return None
    entries = _entries(content["targets"], "targets", TARGETS_MAX, faults)
    common = _common(content.get("target", {}), "target", TargetSection, "name", faults)
    for number, entry in enumerate(entries):
        if isinstance(entry, dict):
            keys = [key for key in TargetBehaviour.model_fields if key in entry]
            reason = "all targets have it in common: use [target]"
            faults += [KeyFault(f"targets[{number}].{key}", reason) for key in keys]
            entries[number] = {key: value for key, value in entry.items() if key not in keys}
    targets = tuple(_completed(entries, common, ("targets", "target"), TargetSection, faults))
    faults += [
        KeyFault(f"targets[{number}].name", "this key is missing: rings and sightings name their target")
        for number, target in enumerate(targets)
        if target is not None and not target.name
    ]
    faults += _repeated([None if each is None else each.name for each in targets], "targets")
    faults += _of_one_only(targets)
    return targets


def _of_one_only(targets: _Targets) -> Iterator[KeyFault]:
    """Yield the faults of keys that a mission of several targets may not have."""
    seen = [(number, target) for number, target in enumerate(targets) if target is not None and len(targets) > 1]
    for number, target in seen:
        if target.evades is not None:
            yield KeyFault(f"targets[{number}].evades", "only the one target of a mission can evade: leave it out")
    vehicles = [number for number, target in seen if target.source == "mavlink"]
    for number in vehicles[1:]:
        yield KeyFault(
            f"targets[{number}].source",
            f"cordon receives one MAVLink vehicle as a target, and targets[{vehicles[0]}] is one: "
            'report others by programs, source = "external"',
        )


def read_rings(content: _Content, targets: _Targets | None, faults: list[KeyFault]) -> tuple[ReadRing, ...] | None:
    """Return the valid rings of a file's content; None if the file has one `[encirclement]`."""
    if "rings" not in content:
        if targets is not None:
            step = (
                "write a [[rings]] table with target and places for each; [encirclement] has what rings have in common"
            )
            faults.append(KeyFault("rings", f"[[targets]] need rings: {step}"))
        return None
    entries = _entries(content["rings"], "rings", RINGS_MAX, faults)
    common = _common(content.get("encirclement", {}), "encirclement", EncirclementSection, "", faults)
    sections = _completed(entries, common, ("rings", "encirclement"), RingSection, faults)
    known = [_only_name(content)] if targets is None else _known_names(targets)
    rings = [_ring(number, section, known, faults) for number, section in enumerate(sections) if section is not None]
    faults += _repeated(_by_number(rings, len(sections)), "rings")
    faults += [
        KeyFault(f"rings[{ring.number}].altitude", "only the one ring of a mission can follow its target's altitude")
        for ring in rings
        if len(entries) > 1 and ring.section.altitude == "target"
    ]
    if rings and len(rings) == len(entries) and targets is not None and all(ring.target is not None for ring in rings):
        for number in sorted({*range(len(targets))} - {ring.target for ring in rings if ring.target is not None}):
            if known[number] is None:
                continue
            step = f'add a [[rings]] table with target = "{known[number]}", or leave the target out'
            faults.append(KeyFault(f"targets[{number}]", f"no ring is about this target: {step}"))
    return tuple(rings)


def _known_names(targets: _Targets) -> list[str | None]:
    """Return the names of targets, None for one with faults, which may be that of its name."""
    names = [(each.name or None) if each is not None else None for each in targets]
    return [None if name in names[:number] else name for number, name in enumerate(names)]


def _only_name(content: _Content) -> str:
    """Return the name of the only target, empty if it has none."""
    target = content.get("target", {})
    name = target.get("name", "") if isinstance(target, dict) else ""
    return name if isinstance(name, str) else ""


def _by_number(rings: Sequence[ReadRing], count: int) -> list[str | None]:
    names = {ring.number: ring.name for ring in rings}
    return [names.get(number) for number in range(count)]


def _ring(number: int, section: RingSection, known: Sequence[str | None], faults: list[KeyFault]) -> ReadRing:
    target = _target_of(section, f"rings[{number}].target", known, faults)
    name = section.name or (None if target is None else known[target])
    if not name and target is not None and known[target] is not None:
        faults.append(KeyFault(f"rings[{number}].name", "this key is missing: commands and logs name the ring"))
    if name == AUTO:
        faults.append(KeyFault(f"rings[{number}].name", f"'{AUTO}' stands for no ring in commands: use another name"))
    return ReadRing(number, section, name or "", target)


def _target_of(section: RingSection, place: str, known: Sequence[str | None], faults: list[KeyFault]) -> int | None:
    """Return the number of a ring's target among those of these names, None for one with faults."""
    name, names = section.target, [each for each in known if each]
    if name is None and len(known) == 1:
        return 0
    if name and name in known:
        return known.index(name)
    if name is None:
        faults.append(KeyFault(place, f"this key is missing: name one of the targets {', '.join(names)}"))
    elif None not in known and known:  # a target that has faults may have this name
        near = difflib.get_close_matches(name, names, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(names) or 'one without a name'}"
        faults.append(KeyFault(place, f"no target has the name {shown(name)}; {hint}"))
    return None


def _repeated(names: Sequence[str | None], table: str) -> list[KeyFault]:
    return [
        KeyFault(f"{table}[{number}].name", f"'{name}' is {table}[{names.index(name)}]'s already: each needs its own")
        for number, name in enumerate(names)
        if name and name in names[:number]
    ]


# Completion of tables


def _entries(content: object, table: str, most: int, faults: list[KeyFault]) -> list[object]:
    """Return the tables of an array, none if there are none or too many."""
    if isinstance(content, list) and 0 < len(content) <= most:
        return [*content]
    if isinstance(content, dict):
        reason = f"[{table}] is a single table: write [[{table}]] above each"
    elif isinstance(content, list):
        reason = f"a mission has 1 to {most} (given: {len(content)})"
    else:
        reason = f"write [[{table}]] above each (given: {shown(content)})"
    faults.append(KeyFault(table, reason))
    return []


def _common(
    content: object, section: str, model: type[Settings], of_entries: str, faults: list[KeyFault]
) -> dict[str, Any]:
    """Return the table that entries are completed from, without its unknown keys and the key that each entry has."""
    if not isinstance(content, dict):
        faults.append(KeyFault(section, f"it must be a table (given: {shown(content)})"))
        return {}
    if of_entries in content:
        faults.append(KeyFault(f"{section}.{of_entries}", f"each [[{section}s]] table has its own: leave it out here"))
    known = [key for key in model.model_fields if key != of_entries]
    faults += unknown_keys(section, [key for key in content if key not in model.model_fields], known)
    return {key: value for key, value in content.items() if key in known}


def _completed(
    entries: Sequence[object], common: _Content, names: tuple[str, str], model: type[_S], faults: list[KeyFault]
) -> list[_S | None]:
    """Return the settings of each entry over the common table, None for one with faults.

    `names` are those of the entries and of the common table. A fault of the latter is reported once, with its place,
    also that of a value which every entry replaces.
    """
    found: list[_S | None] = []
    placed: dict[KeyFault, None] = {}
    table, section = names
    for number, entry in enumerate(entries):
        place, own = f"{table}[{number}]", list[KeyFault]()
        found.append(validated(model, _over(common, entry) if isinstance(entry, dict) else entry, place, own))
        for fault in own:
            below = fault.place.removeprefix(place)
            is_common = below and not _has(entry, below) and _has(common, below)
            placed[fault._replace(place=f"{section}{below}") if is_common else fault] = None
    replaced = list[KeyFault]()
    validated(model, common, section, replaced)
    # It lacks keys that each entry has of its own: what counts is what it holds.
    places = ((each, each.place.removeprefix(section)) for each in replaced)
    placed |= dict.fromkeys(each for each, below in places if below and _has(common, below))
    faults += placed
    return found


def _over(common: _Content, entry: _Content) -> dict[str, Any]:
    """Return the values of an entry, completed from the common table, tables key by key."""
    both = {key for key in common if isinstance(common[key], dict) and isinstance(entry.get(key), dict)}
    return {**common, **entry, **{key: _over(common[key], entry[key]) for key in both}}


def _has(content: object, path: str) -> bool:
    """Return whether a table holds a value at a path below it."""
    for part in _PARTS.findall(path):
        if isinstance(content, list) and part.startswith("[") and int(part[1:-1]) < len(content):
            content = content[int(part[1:-1])]
        elif isinstance(content, dict) and part in content:
            content = content[part]
        else:
            return False
    return True
