"""Overrides of values in a mission file, by their path: `encirclement.radius_m`, `vehicles[0].id`.

The result is again a mission's text: a log records it, and the flight can be repeated from it.
"""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import tomli_w

from estimation.input_file import KEY_PARTS_MAX, toml_content
from gcs.errors import InputError, KeyFault
from gcs.mission.fault_lines import syntax_fault

_STEP = re.compile(r"([A-Za-z0-9_-]+)((?:\[\d+\])*)")
"""One part of a path: a name, and the indexes behind it."""


def override(given: str) -> tuple[str, object]:
    """Return path and value of `KEY=VALUE`; text that is not a TOML value is a string. Raises InputError."""
    place, equals, text = given.partition("=")
    if not equals:
        raise InputError([f"--set {given}: write KEY=VALUE, such as encirclement.radius_m=12"])
    try:
        return place.strip(), toml_content(f"value = {text.strip()}")["value"]
    except ValueError:
        return place.strip(), text.strip()


def places(sections: Mapping[str, object], vehicle_ids: Sequence[object]) -> dict[str, object]:
    """Return the paths and values of nested tables; `vehicles` is a table by id. Raises InputError.

    `{"encirclement": {"radius_m": 12}}` is `{"encirclement.radius_m": 12}`, which may be given as it is.
    """
    found = dict[str, object]()
    for name, value in sections.items():
        if name == "vehicles" and isinstance(value, Mapping):
            for vehicle_id, keys in value.items():
                if vehicle_id not in vehicle_ids:
                    known = ", ".join(map(str, vehicle_ids))
                    raise InputError([f"vehicles: the mission has no vehicle {vehicle_id!r} (it has {known})"])
                found |= _flat(f"vehicles[{vehicle_ids.index(vehicle_id)}]", keys)
        else:
            found |= _flat(name, value)
    return found


def _flat(place: str, value: object) -> dict[str, object]:
    if not isinstance(value, Mapping):
        return {place: value.tolist() if isinstance(value, np.generic | np.ndarray) else value}
    return {at: each for key, inner in value.items() for at, each in _flat(f"{place}.{key}", inner).items()}


def override_text(place: str, value: object) -> str:
    """Return `KEY=VALUE`, the inverse of `override`."""
    is_plain = isinstance(value, str) and override(f"{place}={value}") == (place, value)
    return f"{place}={value if is_plain else _toml(value)}"


def _toml(value: object) -> str:
    """Return a value as TOML in one line: JSON but for tables."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def overridden(text: str, overrides: Mapping[str, object]) -> str:
    """Return a mission's text with other values at these paths; unchanged without any.

    Values are validated when the mission is read. Raises InputError for impossible paths.
    """
    if not overrides:
        return text
    try:
        content = toml_content(text)
    except ValueError as error:
        raise InputError([syntax_fault(error, text)]) from error
    faults = [
        fault
        for place, value in overrides.items()
        for fault in _unwritable(place, value) or _put(content, place, value)
    ]
    if faults:
        raise InputError(faults)
    return tomli_w.dumps(content)


def _unwritable(place: str, value: object) -> list[KeyFault]:
    """Return the fault of a value that TOML cannot represent."""
    try:
        tomli_w.dumps({"value": value})
    except TypeError:
        return [
            KeyFault(place, f"{value!r} is not a TOML value: give a number, text, true or false, an array or a table")
        ]
    return []


def _put(content: dict[str, Any], place: str, value: object) -> list[KeyFault]:
    """Set a value in the content; return the faults of its path."""
    steps = _steps(place)
    if not steps:
        return [KeyFault(place, "not the path of a key, such as encirclement.radius_m or vehicles[0].profile")]
    table: Any = content
    for step, following in zip(steps, (*steps[1:], None), strict=True):
        if isinstance(step, int):
            if not isinstance(table, list):
                return [KeyFault(place, f"the part before [{step}] is not an array")]
            if step >= len(table):
                return [KeyFault(place, f"there is no [{step}], the last is [{len(table) - 1}]")]
        elif not isinstance(table, dict):
            return [KeyFault(place, f"the part before {step} is not a table")]
        elif step not in table and isinstance(following, str):
            table[step] = {}
        elif step not in table and following is not None:
            return [KeyFault(place, f"there is no {step}")]
        if following is None:
            table[step] = value
        else:
            table = table[step]
    return []


def _steps(place: str) -> list[str | int]:
    """Return the names and indexes of a path, empty if it is invalid."""
    steps: list[str | int] = []
    for part in place.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            return []
        steps += [match[1], *map(int, re.findall(r"\d+", match[2]))]
    return steps if len(steps) < KEY_PARTS_MAX else []
