"""Values of a JSON file, each with its place in the file: what is missing or of another kind is an InputError."""

import json
from collections.abc import Iterator
from typing import Any, Final, NoReturn

from gcs.errors import InputError, KeyFault
from gcs.zones.drawing import ranged

_SHOWN_MAX = 60


class JsonNode:
    """A value, and its place such as `f.plan: geoFence.circles[0]`."""

    def __init__(self, file: str, path: str, value: object) -> None:
        self.file: Final = file
        self.path: Final = path
        self.value: Final = value

    @property
    def place(self) -> str:
        """The place in words."""
        return f"{self.file}: {self.path}" if self.path else self.file

    def fault(self, reason: str) -> InputError:
        """Return the error of this value."""
        return InputError([KeyFault(self.place, reason)])

    def get(self, key: str) -> "JsonNode | None":
        """Return the value of a key, None without it; raises InputError if this is no object."""
        if not isinstance(self.value, dict):
            raise self._other("an object")
        inner = self.value.get(key)
        return None if inner is None else JsonNode(self.file, f"{self.path}.{key}" if self.path else key, inner)

    def __getitem__(self, key: str) -> "JsonNode":
        """Return the value of a key; raises InputError without it."""
        found = self.get(key)
        if found is None:
            raise self.fault(f"the key {key!r} is missing")
        return found

    def items(self, least: int = 0) -> "list[JsonNode]":
        """Return the values of an array; raises InputError for anything else, and for fewer than `least`."""
        if not isinstance(self.value, list):
            raise self._other("an array")
        if len(self.value) < least:
            raise self.fault(f"it has at least {least} values (given: {len(self.value)})")
        return [JsonNode(self.file, f"{self.path}[{at}]", each) for at, each in enumerate(self.value)]

    def number(self, what: str, low: float, high: float) -> float:
        """Return a number between two limits; raises InputError."""
        return ranged(self.place, what, self.value, low, high)

    def flag(self) -> bool:
        """Return true or false; raises InputError for anything else."""
        if not isinstance(self.value, bool):
            raise self._other("true or false")
        return self.value

    def text(self) -> str:
        """Return a text; raises InputError for anything else."""
        if not isinstance(self.value, str):
            raise self._other("a text")
        return self.value

    def _other(self, kind: str) -> InputError:
        return self.fault(f"it is {kind} (given: {json.dumps(self.value)[:_SHOWN_MAX]})")


def json_root(file: str, content: bytes) -> JsonNode:
    """Return the value of a JSON text; raises InputError, also for numbers that JSON does not have."""
    try:
        text = content.decode("utf-8-sig")
        value: Any = json.loads(text, parse_int=_whole, parse_constant=_refused)
    except json.JSONDecodeError as error:
        reason = f"it is not JSON: {error.msg} in column {error.colno} of line {error.lineno}"
        raise InputError([KeyFault(file, reason, error.lineno)]) from error
    except UnicodeDecodeError as error:
        raise InputError([KeyFault(file, "it is not JSON: it is no text in UTF-8")]) from error
    except ValueError as error:
        raise InputError([KeyFault(file, f"it is not JSON: {error}")]) from error
    return JsonNode(file, "", value)


def _whole(digits: str) -> int:
    try:
        return int(digits)
    except ValueError as error:  # Python converts up to 4300 digits
        raise ValueError(f"a number has {len(digits)} digits") from error


def _refused(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number")


def each_of(node: JsonNode | None) -> Iterator[JsonNode]:
    """Yield the values of an array that may be missing."""
    if node is not None:
        yield from node.items()
