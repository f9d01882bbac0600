"""The options of a sweep: a varied key of the mission with its values, `encirclement.radius_m=8:16:2`, and seeds."""

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from math import ceil, isfinite
from typing import Any

import msgspec

from estimation.input_file import toml_content
from gcs.errors import InputError
from gcs.mission.overrides import override

VALUES_MAX = 100_000
INTEGER_MAX = 2**63 - 1
_VARY = "write KEY=START:STOP:STEP or KEY=VALUE,VALUE, as in encirclement.radius_m=8:16:2 or formation.shape=line,wedge"
_RANGE = "a range is START:STOP or START:STOP:STEP, such as 8:16:2"


class Variation(msgspec.Struct, frozen=True):
    """A key by its path in the mission, and its values."""

    place: str
    values: tuple[Any, ...]


def variation(given: str) -> Variation:
    """Parse `KEY=VALUES`; raises InputError.

    A range includes START and excludes STOP, as Python's; STEP is 1 by default. The values of a list are TOML; text
    that is not a TOML value is a string.
    """
    place, equals, text = (part.strip() for part in given.partition("="))
    try:
        if not (place and equals and text):
            raise ValueError(_VARY)
        values = _range(text) or _listed(place, text)
        _require_usable(values)
    except ValueError as error:
        raise InputError([f"--vary {given}: {error}"]) from error
    return Variation(place, values)


def seed_range(given: str) -> tuple[int, ...]:
    """Return the seeds of START:STOP (STOP is excluded), START:STOP:STEP, or a list; raises InputError."""
    try:
        seeds = _range(given) or tuple(map(_number, given.split(",")))
        _require_usable(seeds)
        for seed in seeds:
            if not isinstance(seed, int) or seed < 0:
                raise ValueError(f"{seed} is not a seed; seeds are whole numbers from 0, such as 0:50")
    except ValueError as error:
        raise InputError([f"--seeds {given}: {error}"]) from error
    return tuple(map(int, seeds))


def _range(text: str) -> tuple[int | float, ...]:
    """Return the numbers of START:STOP:STEP, empty if the text is not a range; raises ValueError for a wrong range."""
    parts = text.split(":")
    if len(parts) not in (2, 3) or not _is_number(parts[0]):
        return ()
    start, stop, step = (Decimal(str(_number(part))) for part in (*parts, "1")[:3])
    if not step:
        raise ValueError("the step is 0")
    count = ceil((stop - start) / step)
    if count <= 0:
        raise ValueError(f"the range is empty: from {start} to {stop} (excluded) in steps of {step}")
    if count > VALUES_MAX:
        raise ValueError(f"{count} values, at most {VALUES_MAX}")
    return tuple(_plain(start + index * step) for index in range(count))


def _listed(place: str, text: str) -> tuple[Any, ...]:
    """Return the values of a list: TOML values, or words separated by commas."""
    try:
        return tuple(toml_content(f"value = [{text}]")["value"])
    except ValueError:
        return tuple(override(f"{place}={part}")[1] for part in text.split(","))


def _require_usable(values: Sequence[Any]) -> None:
    """Raise ValueError for a number that no table holds, and for a value given twice: 8 and 8.0 are the same number."""
    seen = set()
    for value in values:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if isinstance(value, float) and not isfinite(value):
            raise ValueError(f"{value} is not finite")
        if isinstance(value, int) and abs(value) > INTEGER_MAX:
            raise ValueError(f"{value} is too large")
        key = value if is_number else repr(value)
        if key in seen:
            raise ValueError(f"{value} is given twice")
        seen.add(key)


def _number(text: str) -> int | float:
    if not _is_number(text):
        raise ValueError(f"{text.strip()!r} is not a number; {_RANGE}")
    return _plain(Decimal(text.strip()))


def _is_number(text: str) -> bool:
    try:
        return isfinite(float(Decimal(text.strip())))
    except InvalidOperation:
        return False


def _plain(number: Decimal) -> int | float:
    """Return a number as int if it is written as a whole number."""
    return int(number) if number.as_tuple().exponent == 0 else float(number)
