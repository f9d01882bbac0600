"""The channels of a flight log and the fields of their records, with units, from the schemas that a log holds."""

import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from itertools import groupby
from operator import itemgetter
from typing import Any, get_args, get_type_hints

import msgspec

from gcs.flightlog.records import RUN_TOPICS, VEHICLE_TOPICS
from gcs.flightlog.schema import codec_of
from tests.support.units import unit

_TYPES = {1: "number", 3: "integer", 8: "true or false", 9: "text", 12: "bytes"}
"""Names of types by their Protobuf numbers."""
CHANNELS: dict[str, type[Any]] = {
    **{f"/{name}": kind for kind, name in RUN_TOPICS.items()},
    **{f"/vehicle/N/{name}": kind for kind, name in VEHICLE_TOPICS.items()},
}
"""The content of each channel by topic."""
_TOPIC_OF = {codec_of(kind).descriptor.name: topic for topic, kind in CHANNELS.items()}  # type: ignore[arg-type]


def field_tables() -> str:
    """Return the channels with their content, and the fields of their records, as Markdown."""
    return "\n\n".join(_channel(topic, kind) for topic, kind in CHANNELS.items())


def _channel(topic: str, kind: type[Any]) -> str:
    """Return a channel's heading, content and fields."""
    fields = groupby(_fields(kind, codec_of(kind).descriptor), itemgetter(1))  # type: ignore[arg-type]  # as in the schema
    rows = [f"- {', '.join(f'`{name}`' for name, _ in each)}: {holds}" for holds, each in fields]
    table = ["", *rows] if rows else []
    return "\n".join([f"### `{topic}`", "", _purpose(kind), *table])


def _fields(kind: type[Any], message: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the fields of a record with what each holds."""
    structs = dict(_structs(kind))
    for field in message.fields:
        name = f"{prefix}{field.name}"
        if name == "number":  # of every record
            continue
        if field.message_type is None:
            symbol = unit(name)
            yield name, f"{_type(field)}{f' [{symbol}]' if symbol else ''}"
        elif field.message_type.name in _TOPIC_OF:
            yield name, f"the fields of `{_TOPIC_OF[field.message_type.name]}`"
        else:
            place, struct = f"{name}{'[]' if field.is_repeated else ''}", structs[field.name]
            yield place, _purpose(struct)
            yield from _fields(struct, field.message_type, f"{place}.")


def _structs(kind: type[Any]) -> Iterator[tuple[str, type[Any]]]:
    """Return the fields that hold structs, alone, in a tuple or perhaps none, each with the type of the struct."""
    for name, hint in get_type_hints(kind).items():
        for each in (hint, *get_args(hint)):
            if isinstance(each, type) and (issubclass(each, msgspec.Struct) or is_dataclass(each)):
                yield name, each


def _type(field: Any) -> str:
    text = f"list: {_TYPES[field.type]}" if field.is_repeated else _TYPES[field.type]
    return f"{text}, or missing" if field.has_presence else text


def _purpose(kind: type[Any]) -> str:
    """Return the docstring of a record without the call that takes it, and without errors."""
    text = re.sub(r"^`\w+`: ", "", " ".join((kind.__doc__ or "").split()))
    text = re.sub(r"Raises [^.]*\.", "", text).strip().replace("|", "\\|")
    return f"{text[:1].upper()}{text[1:]}"
