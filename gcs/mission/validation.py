"""Validation of a TOML section against its model: the settings, or every fault with its path in plain words."""

import difflib
import re
from collections.abc import Mapping, Sequence
from math import radians
from typing import TypeVar, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from agents.settings.sections import NAME_PATTERN
from agents.team.clock_watch import STEP_S
from estimation.settings import Settings
from gcs.errors import KeyFault
from gcs.mission.mission import TEAM_PATTERN
from gcs.mission.sections import TUNING

FORMER_KEYS: Mapping[str, str] = {
    "own_filter": "moved to [own_filter] of the vehicles' profiles",
    "target_filter": "moved to [target] and [tuning.target_filter]",
    "vehicles.plant": "moved to profile",
    **{
        f"{name}.{key}": f"moved to tuning.{name}.{key}" for name, model in TUNING.items() for key in model.model_fields
    },
    **dict.fromkeys(
        ("tuning.encirclement.lag_weight", "tuning.encirclement.lead_weight"),
        "their sum is tuning.encirclement.spacing_weight",
    ),
    "encirclement.spacing_jerk_max_m_s3": (
        "its value follows from encirclement.spacing_acceleration_max_m_s2, or else from encirclement.radius_m"
    ),
    "tuning.failsafe.clock_step_s": f"its value is always {STEP_S:g}",
}
"""Keys of earlier versions, by their paths without indexes, and where their values are now."""
_PLAIN_WORDS = {
    "missing": "this key is missing",
    "model_type": "it must be a table",
    "tuple_type": "it must be a list of numbers",
    "float_type": "it must be a number, without unit and quotation marks",
    "int_type": "it must be a whole number, without unit and quotation marks",
}
_PATTERNS = {
    NAME_PATTERN: "it must consist of letters, digits, - and _",
    TEAM_PATTERN: "it must consist of 1 to 32 letters, digits, - and _",
}
"""What a text of each pattern may hold."""

_FOLLOWS = "default_factory_not_called"
"""Error type of a default that depends on an invalid key, which has its own fault."""
_OUT_OF_RANGE = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
KEY_LENGTH_MAX = 60
FAULTS_MAX = 20
"""Maximum number of faults shown for one section; the others are counted."""

_S = TypeVar("_S", bound=Settings)


def validated(model: type[_S], content: object, path: str, faults: list[KeyFault]) -> _S | None:
    """Return the settings of a section, or None and append its faults."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        errors = [each for each in error.errors(include_url=False) if each["type"] != _FOLLOWS]
        faults += [_plain(model, path, fault) for fault in errors[:FAULTS_MAX]]
        faults += _and_more(path, len(errors))
        return None


def _plain(model: type[Settings], path: str, fault: ErrorDetails) -> KeyFault:
    """Return a fault of a section in plain words."""
    *parents, last = fault["loc"] or ("",)
    if fault["type"] == "extra_forbidden":
        return unknown_key(_place(path, parents), str(last), _known_keys(model, parents))
    if fault["type"] == "too_long":
        reason = f"it holds too many numbers, more than {fault['ctx']['max_length']}"
        return KeyFault(_place(path, fault["loc"]), reason)
    pattern = fault.get("ctx", {}).get("pattern", "")
    if fault["type"] == "tuple_type" and _holds_tables(model, fault["loc"]):
        reason = f"it must be a list of tables, each under [[{_place(path, fault['loc'])}]]"
    else:
        reason = _PATTERNS.get(pattern) or _PLAIN_WORDS.get(fault["type"]) or _pydantic_reason(fault["msg"])
    given = "" if fault["type"] == "missing" else f" (given: {shown(fault['input'])}{_as_degrees(last, fault)})"
    return KeyFault(_place(path, fault["loc"]), f"{reason}{given}")


def _pydantic_reason(message: str) -> str:
    """Return a message of pydantic in the words of the others."""
    plain = message.removeprefix("Value error, ").replace("Input should be", "it must be")
    return plain.replace("String should have", "it must have")


def _as_degrees(key: int | str, fault: ErrorDetails) -> str:
    """Return an out-of-range angle converted from degrees to radians, as a hint."""
    if fault["type"] not in _OUT_OF_RANGE or not str(key).endswith(("_rad", "_rad_s")):
        return ""
    return f"; {fault['input']:g} degrees are {radians(fault['input']):.3g} radians"


def _place(path: str, below: Sequence[int | str]) -> str:
    return path + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in below)


def _known_keys(model: type[Settings], parents: Sequence[int | str]) -> list[str]:
    """Return the keys of a table below a section."""
    return list(_model_of(model, parents).model_fields)


def _holds_tables(model: type[Settings], place: Sequence[int | str]) -> bool:
    """Return whether the value of a key below a section is a list of tables."""
    *parents, key = place
    field = _model_of(model, parents).model_fields.get(str(key))
    return field is not None and any(
        isinstance(kind, type) and issubclass(kind, Settings) for kind in get_args(field.annotation)
    )


def _model_of(model: type[Settings], parents: Sequence[int | str]) -> type[Settings]:
    """Return the model of a table below a section."""
    for key in filter(lambda part: isinstance(part, str), parents):
        annotation = model.model_fields[str(key)].annotation
        kinds = (annotation, *get_args(annotation))
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Settings))
    return model


def shown(value: object) -> str:
    """Return a value in at most 60 characters."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def unknown_keys(parent: str, keys: Sequence[str], known: list[str]) -> list[KeyFault]:
    """Return the faults of unknown keys."""
    return [*(unknown_key(parent, key, known) for key in keys[:FAULTS_MAX]), *_and_more(parent, len(keys))]


def _and_more(path: str, count: int) -> list[KeyFault]:
    return [KeyFault(path or "the mission", f"and {count - FAULTS_MAX} more faults")] if count > FAULTS_MAX else []


def unknown_key(parent: str, key: str, known: list[str]) -> KeyFault:
    """Return the fault of an unknown key."""
    name = shown(key).strip("'\"")
    place = f"{parent}.{name}" if parent else name
    if former := FORMER_KEYS.get(re.sub(r"\[\d+\]", "", place)):
        return KeyFault(place, f"no longer a key: {former}")
    near = difflib.get_close_matches(key, known, n=1) if len(key) <= KEY_LENGTH_MAX else []
    hint = f"; did you mean '{near[0]}'?" if near else f"; known keys: {', '.join(sorted(known))}"
    return KeyFault(place, f"unknown key{hint}")
