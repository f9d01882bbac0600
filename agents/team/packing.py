"""Compact forms of messages, generated from the annotations of their fields.

A message is packed into an array with a column for each field, in their order; a tuple of numbers with units has one
for each of them. A field without an annotation is a column as it is. A part of a message whose own fields have
annotations is an array in one column.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import GenericAlias, NoneType, UnionType
from typing import Annotated, Any, Generic, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta, structs
from msgspec.structs import FieldInfo

MessageT = TypeVar("MessageT", bound=msgspec.Struct)
MarkT = TypeVar("MarkT")


@dataclass(frozen=True, slots=True)
class Unit:
    """A number that is sent as an integer multiple of a unit, `per_one` of which are one; its bounds are the same."""

    per_one: float
    rounding: Literal["nearest", "above", "towards_zero"] = "nearest"


@dataclass(frozen=True, slots=True)
class Within:
    """A number that has these bounds on the bus alone; those of `msgspec.Meta` hold wherever it is decoded."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class AheadOf:
    """A tuple that is sent relative to an earlier field of the same form, which takes fewer bytes."""

    name: str


@dataclass(frozen=True, slots=True)
class Age:
    """A time that is sent in ms as its age at the time of the whole message, of at most `limit_s` either way."""

    limit_s: float


@dataclass(frozen=True, slots=True)
class OneOf:
    """A word that is sent as its place among these."""

    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Added:
    """The field that was added to a message as number n: it is sent after all others, and may be missing.

    It is missing where it and all after it have their defaults.
    """

    number: int


@dataclass(frozen=True, slots=True)
class Mark:
    """An annotation without a value."""

    name: str


SHARED = Mark("shared")
"""A field that is not sent: a part of a message has it from the whole."""
PAIRED = Mark("paired")
"""A field that is sent in the column of the field before; both are null where that has its default."""
FLAT = Mark("flat")
"""A part of a message whose columns are columns of the whole."""


_BOUNDS = ("gt", "ge", "lt", "le")


class Packing(Generic[MessageT]):
    """The compact form of one type of message: `wire` is the struct to decode into, which has the bounds.

    `packed` returns what is to be encoded, `unpacked` the message. Both are compiled from text, as the methods of
    dataclasses are, because they run for every message.
    """

    def __init__(self, kind: type[MessageT], tag: str | None = None) -> None:
        """Take a type of message and its tag on the bus, None for a part of another message."""
        fields = _MessageColumns()
        restored = fields.add(kind, "m")
        columns = sorted(fields.columns, key=lambda each: each.added)
        packed = "".join(f"{each}, " for each in [*[repr(tag)] * (tag is not None), *(each.packed for each in columns)])
        packed = f"({packed})"
        if defaults := [each.default for each in columns if each.added]:
            fields.names |= {"without_defaults": _without_defaults, "defaults": defaults}
            packed = f"without_defaults({packed}, defaults)"
        text = f"def packed(m, whole=None): return {packed}\ndef unpacked(w, whole=None): return {restored}"
        exec(text, fields.names)  # the text holds names of fields and numbers of annotations
        self.packed: Callable[..., tuple[object, ...]] = fields.names["packed"]
        self.unpacked: Callable[..., MessageT] = fields.names["unpacked"]
        members = [(each.name, each.kind, *[each.default] * bool(each.added)) for each in columns]
        self.wire = msgspec.defstruct(f"Packed{kind.__name__}", members, frozen=True, array_like=True, tag=tag)


class _Form(NamedTuple):
    """How a value is sent in a column: its type there, and expressions that pack and restore it, `{0}` for it."""

    kind: Any
    packed: str = "{0}"
    restored: str = "{0}"


class _Column(NamedTuple):
    """A column: its name and type, the expression of its value, and its number and default if it was added."""

    name: str
    kind: Any
    packed: str
    added: int = 0
    default: object = None


@dataclass(slots=True)
class _MessageColumns:
    """The columns of a message, and the names in their expressions, in which `m` is packed and `w` is restored."""

    names: dict[str, Any] = field(default_factory=lambda: {"above": _above, "towards_zero": _towards_zero})
    columns: list[_Column] = field(default_factory=list)

    def add(self, kind: type[msgspec.Struct], message: str) -> str:
        """Add the fields of a type, `message` being the expression of it; return the expression that restores it."""
        self.names[kind.__name__] = kind
        hints, fields, restored = get_type_hints(kind, include_extras=True), structs.fields(kind), list[str]()
        for each, following in zip(fields, [*fields[1:], None], strict=True):
            hint, value = hints[each.name], f"{message}.{each.name}"
            if SHARED in _marks(hint):
                restored.append(f"whole.{each.name}")
            elif FLAT in _marks(hint):
                restored.append(self.add(_bare(hint), value))
            elif following is not None and PAIRED in _marks(hints[following.name]):
                restored += self._pair(each, following, message, hints)
            elif PAIRED not in _marks(hint):
                is_numbers = get_origin(_bare(hint)) is tuple and _mark(get_args(_bare(hint))[0], Unit) is not None
                restored.append(self._numbers(each.name, message, hint) if is_numbers else self._one(each, value, hint))
        return f"{kind.__name__}({', '.join(restored)})"

    def _one(self, each: FieldInfo, value: str, hint: Any) -> str:
        added, form = _mark(hint, Added), self._form(hint)
        number, default = (0, None) if added is None else (added.number, each.default)
        self.columns.append(_Column(each.name, form.kind, form.packed.format(value), number, default))
        return form.restored.format(f"w.{each.name}")

    def _numbers(self, name: str, message: str, hint: Any) -> str:
        restored, ahead_of = "", _mark(hint, AheadOf)
        for index, part in enumerate(get_args(_bare(hint))):
            form, column = _number(part, 1 if ahead_of is None else 2), f"w.{name}_{index}"
            packed = form.packed.format(f"{message}.{name}[{index}]")
            if ahead_of is not None:
                packed += f" - {form.packed.format(f'{message}.{ahead_of.name}[{index}]')}"
                column = f"(w.{ahead_of.name}_{index} + {column})"
            self.columns.append(_Column(f"{name}_{index}", form.kind, packed))
            restored += f"{form.restored.format(column)}, "
        return f"({restored})"

    def _pair(self, one: FieldInfo, other: FieldInfo, message: str, hints: Mapping[str, Any]) -> list[str]:
        pair, column = [(each, self._form(_some(hints[each.name]))) for each in (one, other)], f"w.{one.name}"
        packed = ", ".join(form.packed.format(f"{message}.{each.name}") for each, form in pair)
        nothing = f"{message}.{one.name} == {one.default!r}"
        kind = GenericAlias(tuple, tuple(form.kind for _, form in pair)) | None
        self.columns.append(_Column(one.name, kind, f"None if {nothing} else ({packed})"))
        return [
            f"{each.default!r} if {column} is None else {form.restored.format(f'{column}[{index}]')}"
            for index, (each, form) in enumerate(pair)
        ]

    def _form(self, hint: Any) -> _Form:
        bare, words, age = _bare(hint), _mark(hint, OneOf), _mark(hint, Age)
        if _some(bare) is not bare:
            kind, *both = self._form(_some(bare))
            return _Form(kind | None, *(f"None if {{0}} is None else {each}" for each in both))
        if words is not None:
            places = f"places_{len(self.names)}"
            self.names[places] = {word: place for place, word in enumerate(words.words)}
            return _Form(Annotated[int, Meta(ge=0, lt=len(words.words))], f"{places}[{{0}}]", f"{words.words}[{{0}}]")
        if age is not None:
            limit = round(age.limit_s * 1e3)
            kind = Annotated[int, Meta(ge=-limit, le=limit)]
            return _Form(kind, "round((whole.time_s - {0}) * 1e3)", "whole.time_s - {0} / 1e3")
        if get_origin(bare) is tuple and _is_packed(get_args(bare)[0]):
            kind, *both = self._form(get_args(bare)[0])
            return _Form(
                GenericAlias(tuple, (kind, ...)),
                *(f"tuple([{each.format('each')} for each in {{0}}])" for each in both),
            )
        if _is_packed(bare):
            part, name = Packing(bare), bare.__name__
            self.names |= {f"pack_{name}": part.packed, f"unpack_{name}": part.unpacked}
            return _Form(part.wire, f"pack_{name}({{0}}, whole or m)", f"unpack_{name}({{0}}, whole or w)")
        return _Form(hint) if _mark(hint, Unit) is None and _mark(hint, Within) is None else _number(hint)


def _number(hint: Any, times: int = 1) -> _Form:
    """Return the form of a number; its bounds are multiplied by `times`."""
    unit, meta, within = _mark(hint, Unit) or Unit(1.0), _mark(hint, Meta), _mark(hint, Within)
    bounds = {"ge": within.low, "le": within.high} if within else {each: getattr(meta, each) for each in _BOUNDS}
    units: dict[str, Any] = {
        each: round(times * value * unit.per_one) for each, value in bounds.items() if value is not None
    }
    kind, per_one = Annotated[int, Meta(**units)], unit.per_one
    if _bare(hint) is int:
        return _Form(kind)
    if per_one == 1.0:
        return _Form(kind, "round({0})")
    packed = f"round({{0}} * {per_one})" if unit.rounding == "nearest" else f"{unit.rounding}({{0}}, {per_one})"
    return _Form(kind, packed, f"{{0}} / {per_one}")


def _marks(hint: Any) -> tuple[Any, ...]:
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


def _mark(hint: Any, kind: type[MarkT]) -> MarkT | None:
    return next((each for each in _marks(hint) if isinstance(each, kind)), None)


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def _some(hint: Any) -> Any:
    """Return the type of what is not None in a union of two."""
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else ()
    return parts[0] if parts[1:] == (NoneType,) else hint


def _is_packed(kind: Any) -> bool:
    """Return whether a type is a struct with annotations of this module, or with a part that has them."""
    if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        return False
    hints = get_type_hints(kind, include_extras=True).values()
    marked = any(not isinstance(mark, Meta) for hint in hints for mark in _marks(hint))
    return marked or any(_is_packed(_some(_bare(hint))) for hint in hints)


def _without_defaults(values: tuple[object, ...], defaults: Sequence[object]) -> tuple[object, ...]:
    """Return packed values without those at the end that are the `defaults` of the last columns."""
    kept = len(values)
    for default in reversed(defaults):
        if values[kept - 1] != default:
            break
        kept -= 1
    return values[:kept]


def _above(value: float, units: float) -> int:
    """Return the value in units, rounded up; a whole number of units is not changed by rounding errors."""
    count = round(value * units)
    return count if count / units >= value else count + 1


def _towards_zero(value: float, units: float) -> int:
    """Return the value in units, rounded towards zero."""
    return -_above(-value, units) if value > 0.0 else _above(value, units)
