"""Protobuf schemas made from the frozen types of the records, which are their only definition.

Field 1 of every record is its `number`. The others keep their names, with field numbers by their place in the type: new
fields go to the end. Enums are encoded as their values, optional fields with presence.
"""

from collections.abc import Collection, Iterator, Mapping
from functools import cache
from typing import Any

import msgspec
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass
from msgspec import inspect

PACKAGE = "cordon"
_FORMER_FIELDS: Mapping[str, str] = {"lacks": "start_blockers"}
"""Earlier names of fields, and the present ones; a schema is read with the present ones, bytes hold numbers only."""
_SCALARS: dict[type[inspect.Type], FieldDescriptorProto.Type.ValueType] = {
    inspect.FloatType: FieldDescriptorProto.TYPE_DOUBLE,
    inspect.IntType: FieldDescriptorProto.TYPE_INT64,
    inspect.BoolType: FieldDescriptorProto.TYPE_BOOL,
    inspect.StrType: FieldDescriptorProto.TYPE_STRING,
    inspect.BytesType: FieldDescriptorProto.TYPE_BYTES,
    inspect.EnumType: FieldDescriptorProto.TYPE_STRING,
    inspect.LiteralType: FieldDescriptorProto.TYPE_STRING,
}
_NOTHING: Mapping[str, inspect.Type] = {}


class Codec:
    """Encodes one type of record, and provides its schema."""

    def __init__(self, kind: type[Any]) -> None:
        """Take a msgspec struct of numbers, words, bytes, enums, tuples and structs of such."""
        known = inspect.type_info(kind)
        file = FileDescriptorProto(name=f"{PACKAGE}/{kind.__name__}.proto", package=PACKAGE, syntax="proto3")
        _add_message(file, known, {"number": inspect.IntType()})
        pool = DescriptorPool()
        pool.Add(file)
        self.dispensable = frozenset(_with_defaults(known))
        self.name = f"{PACKAGE}.{kind.__name__}"
        self.schema = FileDescriptorSet(file=[file]).SerializeToString()
        self._message = GetMessageClass(pool.FindMessageTypeByName(self.name))

    @property
    def descriptor(self) -> Any:
        """The Protobuf descriptor of the type."""
        return self._message.DESCRIPTOR

    def encode(self, record: object, number: int) -> bytes:
        """Return the bytes of a record and its number; equal records have equal bytes."""
        return self._message(number=number, **plain(record)).SerializeToString(deterministic=True)


def plain(record: object) -> dict[str, Any]:
    """Return a record as dicts, lists, numbers, words and bytes."""
    return msgspec.to_builtins(record, builtin_types=(bytes,))  # type: ignore[no-any-return]  # a struct becomes a dict


class Decoder:
    """Decodes records of a file by the schema that the file holds, whichever version wrote it."""

    def __init__(self, name: str, schema: bytes, where: str = "") -> None:
        """Take a schema's name and its serialised FileDescriptorSet; raises ValueError when it is damaged.

        `where` is the place that errors about damaged records name.
        """
        self.where = where
        pool = DescriptorPool()
        try:
            for file in FileDescriptorSet.FromString(schema).file:
                if any(each.options.map_entry for message in file.message_type for each in message.nested_type):
                    raise TypeError("it has maps, which cordon does not write")
                for each in (field for message in file.message_type for field in message.field):
                    each.name = _FORMER_FIELDS.get(each.name, each.name)
                pool.Add(file)
            self._message = GetMessageClass(pool.FindMessageTypeByName(name))
        except (DecodeError, KeyError, TypeError) as error:
            raise ValueError(f"the schema of {name} is damaged: {error}") from error

    def require(self, kind: type[Any]) -> None:
        """Raise ValueError unless the file's records have all fields of a type here, in the same form.

        A field with a default may be missing: versions without the field behaved as with its default.
        """
        ours = codec_of(kind)  # type: ignore[arg-type]  # mypy holds that type[Any] has no hash
        if lacking := next(_lacking(self._message.DESCRIPTOR, ours.descriptor, ours.dispensable), ""):
            raise ValueError(f"another version of cordon wrote it: {lacking}")

    def decode(self, payload: bytes) -> dict[str, Any]:
        """Return a record as plain data, None for missing fields; raises ValueError when it is damaged."""
        return plain_message(self.message(payload))

    def message(self, payload: bytes) -> Any:
        """Return a record as a Protobuf message: quicker than `decode` for a few fields; the same errors."""
        try:
            return self._message.FromString(payload)
        except (DecodeError, UnicodeDecodeError) as error:
            raise ValueError(str(error)) from error


@cache
def codec_of(kind: type[Any]) -> Codec:
    """Return the codec of a type of record: building one takes a millisecond."""
    return Codec(kind)


def _with_defaults(kind: inspect.Type) -> Iterator[tuple[str, str]]:
    """Return the fields with defaults of a struct and the structs within it, each with its struct's name."""
    if not isinstance(kind, inspect.StructType | inspect.DataclassType):
        return
    for member in kind.fields:
        if not member.required:
            yield kind.cls.__name__, member.encode_name
        yield from _with_defaults(_taken_apart(member.type)[0])


def _lacking(theirs: Any, ours: Any, dispensable: Collection[tuple[str, str]]) -> Iterator[str]:
    """Return the fields of `ours` that `theirs` lacks, or has in another form."""
    for wanted in ours.fields:
        found = theirs.fields_by_name.get(wanted.name)
        if found is None:
            if (ours.name, wanted.name) not in dispensable:
                yield f"{theirs.name} has no {wanted.name}"
        elif _form(found) != _form(wanted):
            yield f"{wanted.name} of {theirs.name} has another form"
        elif wanted.message_type:
            yield from _lacking(found.message_type, wanted.message_type, dispensable)


def _form(field: Any) -> tuple[Any, ...]:
    return field.type, field.is_repeated, field.has_presence


def _add_message(file: FileDescriptorProto, kind: inspect.Type, before: Mapping[str, inspect.Type] = _NOTHING) -> str:
    """Add a struct's message and those within it, each once; return its full name. Fields `before` precede its own."""
    assert isinstance(kind, inspect.StructType | inspect.DataclassType)
    full_name = f".{PACKAGE}.{kind.cls.__name__}"
    if any(message.name == kind.cls.__name__ for message in file.message_type):
        return full_name
    message = file.message_type.add(name=kind.cls.__name__)
    fields = {**before, **{member.encode_name: member.type for member in kind.fields}}
    for number, (name, each) in enumerate(fields.items(), start=1):
        _add_field(file, message, name, number, each)
    return full_name


def _add_field(file: FileDescriptorProto, message: DescriptorProto, name: str, number: int, kind: inspect.Type) -> None:
    single, repeated, optional = _taken_apart(kind)
    added = message.field.add(
        name=name,
        number=number,
        label=FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL,
    )
    if isinstance(single, inspect.StructType | inspect.DataclassType):
        added.type = FieldDescriptorProto.TYPE_MESSAGE
        added.type_name = _add_message(file, single)
        return
    added.type = _SCALARS[type(single)]
    if optional:
        added.proto3_optional = True
        added.oneof_index = len(message.oneof_decl)
        message.oneof_decl.add(name=f"_{name}")


def _taken_apart(kind: inspect.Type) -> tuple[inspect.Type, bool, bool]:
    """Return a field's type, whether it is repeated, and whether it is optional."""
    if isinstance(kind, inspect.UnionType):
        (some,) = (each for each in kind.types if not isinstance(each, inspect.NoneType))
        single, repeated, _ = _taken_apart(some)
        return single, repeated, True
    if isinstance(kind, inspect.VarTupleType):
        return kind.item_type, True, False
    if isinstance(kind, inspect.TupleType):
        return kind.item_types[0], True, False
    return kind, False, False


def plain_message(message: Message) -> dict[str, Any]:
    """Return a Protobuf message as plain data, None for missing fields."""
    return {field.name: _plain_field(message, field) for field in message.DESCRIPTOR.fields}


def _plain_field(message: Message, field: Any) -> Any:
    value = getattr(message, field.name)
    if field.is_repeated:
        return [plain_message(each) for each in value] if field.message_type else list(value)
    if field.has_presence and not message.HasField(field.name):
        return None
    return plain_message(value) if field.message_type else value
