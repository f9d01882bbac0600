"""Walking an MCAP file as far as it is whole, whatever has become of it: no length and no count in it is believed.

What is damaged is told and left out, and reading goes on at the next chunk. Everything that cordon writes is in chunks,
each compressed by zstd and with a checksum of its own.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

MAGIC = b"\x89MCAP0\r\n"
RECORD_MAX_BYTES = 64_000_000
"""No record of a log is larger, as it stands in the file or unpacked: a length beyond it is a damaged one's."""
WORK_MIN_BYTES, WORK_SHARE = 64_000_000, 32
"""A file is read no further than until that much, or that many times its size, has been read and unpacked of it."""
SCAN_MAX_BYTES = 2 * RECORD_MAX_BYTES
"""Where nothing can be read for that long, nothing more is looked for."""
FAULTS_MAX = 20

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<QQI")
_COMPRESSION = b"zstd"
_CHUNK_SIGN = struct.pack("<I", len(_COMPRESSION)) + _COMPRESSION
_SIGN_OFFSET = _HEAD.size + _CHUNK.size - 4
_WINDOW_BYTES = 1 << 16


class Message(NamedTuple):
    """A message, still encoded."""

    channel_id: int
    sequence: int
    time_ns: int
    published_ns: int
    payload: bytes


Entry = Schema | Channel | Message | Metadata


class NoContainerError(ValueError):
    """The file is no MCAP file at all."""


class DamageError(ValueError):
    """Something in the file is not as it was written."""


class Container:
    """An MCAP file; `faults` says what is not whole once all its entries have been gone through."""

    def __init__(self, stream: BinaryIO, size_bytes: int) -> None:
        """Take a file; raises NoContainerError when it is no MCAP file, OSError when it cannot be read."""
        self._stream = stream
        self._work_bytes = max(WORK_MIN_BYTES, WORK_SHARE * size_bytes)
        self._crc = 0
        self._messages_written: int | None = None
        self._more_faults = 0
        self._told: list[str] = []
        self.size_bytes = size_bytes
        self.offset = 0
        self.messages = 0
        self.is_closed = False
        if self._bytes(0, len(MAGIC)) != MAGIC:
            raise NoContainerError("it is empty" if not size_bytes else "it is no MCAP file")

    @property
    def faults(self) -> list[str]:
        """What is damaged, where in the file."""
        more = [f"and {self._more_faults} more places are damaged"] if self._more_faults else []
        return [*self._told, *more]

    def entries(self) -> Iterator[Entry]:
        """Return all that is whole, in order; schemas and channels may be told twice. `offset` is how far it is."""
        yield from self._described_at_the_end()
        self.offset = len(MAGIC)
        self._crc = zlib.crc32(MAGIC)
        while self.offset < self.size_bytes:
            begin = self.offset
            try:
                opcode, body = self._record()
                if opcode == Opcode.DATA_END:
                    self._end_of_data(body)
                    break
                for entry in self._opened(opcode, body):
                    if type(entry) is Message:
                        self.messages += 1
                    yield entry
            except DamageError as damage:
                if not self._recovered_from(str(damage), begin):
                    break
        lost = (self._messages_written or 0) - self.messages
        if lost > 0:
            self._tell(f"{lost} of the {self._messages_written} records that were written are lost")

    def _record(self) -> tuple[int, bytes]:
        """Return the next record of the file, and go on behind it."""
        begin, head = self.offset, self._bytes(self.offset, _HEAD.size)
        if len(head) < _HEAD.size:
            raise DamageError("it ends within a record")
        opcode, length = _HEAD.unpack(head)
        if opcode == 0 or length > RECORD_MAX_BYTES:
            raise DamageError(f"a record of kind {opcode} claims {length} bytes")
        if begin + _HEAD.size + length > self.size_bytes:
            raise DamageError("it ends within a record")
        body = self._bytes(begin + _HEAD.size, length)
        if opcode != Opcode.DATA_END:
            self._crc = zlib.crc32(body, zlib.crc32(head, self._crc))
        self.offset = begin + _HEAD.size + length
        return opcode, body

    def _opened(self, opcode: int, body: bytes) -> Iterator[Entry]:
        """Return what is in a record of the data section."""
        match opcode:
            case Opcode.CHUNK:
                data = _unpacked(body)
                self._work(len(data))
                yield from _inner(data)
            case Opcode.HEADER:
                pass
            case Opcode.METADATA:
                fields = _Fields(body)
                yield Metadata(name=fields.text(), metadata=fields.words())
            case Opcode.SCHEMA | Opcode.CHANNEL | Opcode.MESSAGE:
                yield from _inner(_HEAD.pack(opcode, len(body)) + body)
            case Opcode.MESSAGE_INDEX:
                if len(body) < 6 or int.from_bytes(body[2:6], "little") != len(body) - 6:
                    raise DamageError("a message index is damaged")
            case _:
                self._tell(
                    f"at byte {self.offset - len(body)}: {len(body)} bytes of unknown kind {opcode} are left out"
                )

    def _recovered_from(self, reason: str, begin: int) -> bool:
        """Go on at the next chunk behind a damage, if there is one that can be read; say what is left out."""
        self._crc = -1
        try:
            found = self._next_chunk(begin + 1)
        except DamageError as damage:
            self._tell(f"from byte {begin} on nothing is read: {damage}")
            return False
        end = self.size_bytes if found is None else found
        self._tell(f"at byte {begin}: {reason}; {end - begin} bytes are left out")
        self.offset = end
        return found is not None

    def _next_chunk(self, begin: int) -> int | None:
        """Return where the next record is that looks like a chunk."""
        sought, overlap = begin + _SIGN_OFFSET, len(_CHUNK_SIGN) - 1
        while sought < min(begin + SCAN_MAX_BYTES, self.size_bytes):
            window = self._bytes(sought, _WINDOW_BYTES)
            at = window.find(_CHUNK_SIGN)
            while at >= 0:
                if self._is_chunk(sought + at - _SIGN_OFFSET):
                    return sought + at - _SIGN_OFFSET
                at = window.find(_CHUNK_SIGN, at + 1)
            if len(window) < _WINDOW_BYTES:
                return None
            sought += len(window) - overlap
        return None

    def _is_chunk(self, begin: int) -> bool:
        """Return whether the lengths that a chunk tells twice agree, and the file holds as much."""
        fixed = _SIGN_OFFSET - _HEAD.size + len(_CHUNK_SIGN)
        head = self._bytes(begin, _HEAD.size + fixed + 8)
        if len(head) < _HEAD.size + fixed + 8:
            return False
        opcode, length = _HEAD.unpack_from(head)
        packed = int.from_bytes(head[-8:], "little")
        fits = begin + _HEAD.size + length <= self.size_bytes
        return bool(opcode == Opcode.CHUNK and length == fixed + 8 + packed and length <= RECORD_MAX_BYTES and fits)

    def _described_at_the_end(self) -> Iterator[Entry]:
        """Return the channels that a file repeats when it is closed; they outlive a damaged beginning."""
        end = self.size_bytes - len(MAGIC) - _FOOTER.size - _HEAD.size
        foot = self._bytes(max(end, 0), _HEAD.size + _FOOTER.size + len(MAGIC))
        if end < len(MAGIC) or not foot.endswith(MAGIC) or _HEAD.unpack_from(foot) != (Opcode.FOOTER, _FOOTER.size):
            return
        self.is_closed = True
        begin, _, crc = _FOOTER.unpack_from(foot, _HEAD.size)
        if begin == 0:
            return
        summary = self._bytes(begin, end - begin) if 0 <= end - begin <= RECORD_MAX_BYTES else b""
        if not summary or (crc and zlib.crc32(foot[: -len(MAGIC) - 4], zlib.crc32(summary)) != crc):
            self._tell(f"at byte {end}: its index is damaged")
            return
        try:
            for opcode, first, last in _records(summary):
                if opcode == Opcode.STATISTICS and last - first >= 8:
                    self._messages_written = int.from_bytes(summary[first : first + 8], "little")
            yield from (entry for entry in _inner(summary) if type(entry) is not Message)
        except DamageError:
            self._tell(f"at byte {begin}: its index is damaged")

    def _end_of_data(self, body: bytes) -> None:
        if len(body) != 4:
            raise DamageError("the end of the data is damaged")
        crc = int.from_bytes(body, "little")
        if crc and self._crc >= 0 and crc != self._crc:
            self._tell("the checksum of the whole file does not fit: something beside its records is damaged")

    def _bytes(self, begin: int, count: int) -> bytes:
        self._work(min(count, self.size_bytes))
        self._stream.seek(begin)
        return self._stream.read(count)

    def _work(self, count: int) -> None:
        self._work_bytes -= count
        if self._work_bytes < 0:
            raise DamageError("it claims to hold more than a file of its size can")

    def _tell(self, fault: str) -> None:
        if len(self._told) < FAULTS_MAX:
            self._told.append(fault)
        else:
            self._more_faults += 1


class _Fields:
    """The fields of a record, one after the other; raises DamageError where they claim more than there is."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._at = 0

    def number(self, size: int) -> int:
        return int.from_bytes(self._take(size), "little")

    def data(self) -> bytes:
        return self._take(self.number(4))

    def text(self) -> str:
        try:
            return self.data().decode()
        except UnicodeDecodeError as error:
            raise DamageError("a text is damaged") from error

    def words(self) -> dict[str, str]:
        """Return a table of words."""
        length = self.number(4)
        end, words = self._at + length, {}
        while self._at < end:
            key = self.text()
            words[key] = self.text()
        return words

    def _take(self, count: int) -> bytes:
        begin, self._at = self._at, self._at + count
        if self._at > len(self._body):
            raise DamageError("a record claims more than it holds")
        return self._body[begin : self._at]


def _unpacked(body: bytes) -> bytes:
    """Return what is in a chunk."""
    if len(body) < _CHUNK.size + len(_COMPRESSION) + 8:
        raise DamageError("a chunk is damaged")
    _, _, size_bytes, crc, name_length = _CHUNK.unpack_from(body)
    begin = _CHUNK.size + name_length + 8
    compression = body[_CHUNK.size : _CHUNK.size + min(name_length, len(_COMPRESSION) + 1)]
    if size_bytes > RECORD_MAX_BYTES or compression not in (_COMPRESSION, b""):
        raise DamageError(f"a chunk claims {size_bytes} bytes of compression {compression!r}")
    if len(body) < begin or int.from_bytes(body[begin - 8 : begin], "little") != len(body) - begin:
        raise DamageError("a chunk's lengths do not agree")
    data = _decompressed(body[begin:], size_bytes) if compression else body[begin:]
    if len(data) != size_bytes or (crc and zlib.crc32(data) != crc):
        raise DamageError("a chunk's checksum does not fit")
    return data


def _decompressed(packed: bytes, size_bytes: int) -> bytes:
    try:
        if zstandard.frame_content_size(packed) in (-1, size_bytes):
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size_bytes)
    except zstandard.ZstdError as error:
        raise DamageError("a chunk cannot be unpacked") from error
    raise DamageError("a chunk claims another size than it has")


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Return the kind of each record, where it begins and where it ends."""
    begin, end = 0, len(data)
    while begin < end:
        if begin + _HEAD.size > end:
            raise DamageError("a record is cut off")
        opcode, length = _HEAD.unpack_from(data, begin)
        first = begin + _HEAD.size
        begin = first + length
        if begin > end:
            raise DamageError("a record claims more than there is")
        yield opcode, first, begin


def _inner(data: bytes) -> Iterator[Entry]:
    """Return what is in the data of a chunk."""
    for opcode, first, last in _records(data):
        if opcode == Opcode.MESSAGE:
            if last - first < _MESSAGE.size:
                raise DamageError("a message is damaged")
            channel_id, sequence, time_ns, published_ns = _MESSAGE.unpack_from(data, first)
            yield Message(channel_id, sequence, time_ns, published_ns, data[first + _MESSAGE.size : last])
        elif opcode == Opcode.SCHEMA:
            fields = _Fields(data[first:last])
            number, name, encoding = fields.number(2), fields.text(), fields.text()
            yield Schema(id=number, name=name, encoding=encoding, data=fields.data())
        elif opcode == Opcode.CHANNEL:
            fields = _Fields(data[first:last])
            number, schema_id, topic, encoding = fields.number(2), fields.number(2), fields.text(), fields.text()
            yield Channel(
                id=number, schema_id=schema_id, topic=topic, message_encoding=encoding, metadata=fields.words()
            )
