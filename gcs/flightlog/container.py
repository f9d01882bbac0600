"""Reading the records of an MCAP file that may be unclosed or damaged, with bounded memory and time.

A damaged part is reported and skipped; reading continues at the next chunk. cordon writes all its records in chunks,
each compressed by zstd and with a checksum. mcap parses the records and unpacks the chunks. The walk from record to
record is own code: mcap's `StreamReader` (1.6) ends at the first damage, does not check lengths (a chunk with a stated
length of 100 GB is allocated) and takes 2.9 us a message, this code 1.2 us.
"""

import struct
import zlib
from collections.abc import Callable, Iterator, Set
from io import BytesIO
from typing import BinaryIO, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Metadata, Schema, Statistics
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from gcs.errors import InputError


class LogError(InputError):
    """A log cannot be read, or lacks what is needed; its faults name the file, the place in it, and the reason."""


MAGIC = b"\x89MCAP0\r\n"
RECORD_MAX_BYTES = 64_000_000
"""Bound of a record's size, packed or unpacked: a greater length is damage."""
WORK_MIN_BYTES, WORK_SHARE = 64_000_000, 32
"""Bound of the bytes read and unpacked: this many, or for a large file this multiple of its size."""
SCAN_MAX_BYTES = 2 * RECORD_MAX_BYTES
"""Bound of the search for the next chunk."""
FAULTS_MAX = 20

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHANNEL_ID = struct.Struct("<H")
_CHUNK = struct.Struct("<QQQII")
_FOOTER_BYTES = 20
_COMPRESSION = "zstd"
_CHUNK_SIGN = struct.pack("<I", len(_COMPRESSION)) + _COMPRESSION.encode()
_SIGN_OFFSET = _HEAD.size + _CHUNK.size - 4
_WINDOW_BYTES = 1 << 16
_CUT = "it ends within a record"
_LENGTH_OF_OPEN = 2**64 - 1
"""The length field of a chunk while it is written."""
PADDING_MIN_BYTES = 128
"""The end of a record may be as many equal bytes, as an empty text is."""
PADDING_MAX_BYTES = 256_000_000
"""More of it is damage: searching through it would take minutes."""


class EncodedMessage(NamedTuple):
    """A message, still encoded."""

    channel_id: int
    sequence: int
    time_ns: int
    published_ns: int
    payload: bytes


RecordT = TypeVar("RecordT")
Entry = Schema | Channel | EncodedMessage | Metadata


def unpadded_bytes(stream: BinaryIO, size_bytes: int) -> int:
    """Return the size of a log without padding at its end, as of a file that was made larger before it was filled."""
    end, value = size_bytes, b""
    while end > 0 and size_bytes - end <= PADDING_MAX_BYTES:
        begin = max(end - _WINDOW_BYTES, 0)
        stream.seek(begin)
        window = stream.read(end - begin)
        value = value or window[-1:]
        end = begin + (len(window.rstrip(value)) if value in (b"\0", b"\xff") else len(window))
        if end > begin:
            break
    return end if PADDING_MIN_BYTES <= size_bytes - end <= PADDING_MAX_BYTES else size_bytes


class NoContainerError(ValueError):
    """The file is not an MCAP file."""


class DamageError(ValueError):
    """A part of the file is damaged."""


class Container:
    """An MCAP file; `faults` lists its damage once all `entries` have been read.

    It `is_damaged` if more is wrong than a missing end, such as a file that was never closed and ends within a record.
    """

    def __init__(self, stream: BinaryIO, size_bytes: int) -> None:
        """Open a file; raises NoContainerError when it is not an MCAP file, OSError when it cannot be read."""
        self._stream = stream
        self._work_bytes = max(WORK_MIN_BYTES, WORK_SHARE * size_bytes)
        self._crc = 0
        self._messages_written: int | None = None
        self._more_faults = 0
        self._faults: list[str] = []
        self.size_bytes = size_bytes
        self.offset = 0
        self.messages = 0
        self.is_closed = False
        self.is_damaged = False
        if self._bytes(0, len(MAGIC)) != MAGIC:
            raise NoContainerError("it is empty" if not size_bytes else "it is not an MCAP file")

    @property
    def faults(self) -> list[str]:
        """The damaged places of the file."""
        more = [f"and {self._more_faults} more damaged places"] if self._more_faults else []
        return [*self._faults, *more]

    def entries(self) -> Iterator[Entry]:
        """Return all undamaged entries in order; schemas and channels may repeat. `offset` is the position reached."""
        yield from self._summary()
        self.offset = len(MAGIC)
        self._crc = zlib.crc32(MAGIC)
        while self.offset < self.size_bytes:
            begin = self.offset
            try:
                opcode, body = self._record()
                if opcode == Opcode.DATA_END:
                    self._end_of_data(body)
                    break
                for entry in self._entries_of(opcode, body):
                    if type(entry) is EncodedMessage:
                        self.messages += 1
                    yield entry
            except DamageError as damage:
                if not self._recovered_from(str(damage), begin):
                    break
        lost = (self._messages_written or 0) - self.messages
        if lost > 0:
            self._report(f"{lost} of the {self._messages_written} records written are lost")

    def indexed(self, is_wanted: Callable[[str], bool]) -> Iterator[Entry]:
        """Return the entries of wanted topics of a closed file, whose index is read first.

        Chunks without such messages are not read, and only what is read is checked. Raises DamageError where that is
        damaged, and without an index.
        """
        summary, wanted = self._index(), set[int]()
        if not summary:
            raise DamageError("it has no index, or a damaged one")
        for entry in _inner(summary):
            if isinstance(entry, Channel):
                if not is_wanted(entry.topic):
                    continue
                wanted.add(entry.id)
            yield entry
        for opcode, first, last in _records(summary):
            if opcode == Opcode.CHUNK_INDEX:
                index = _parsed(ChunkIndex.read, summary[first:last])
                if not wanted.isdisjoint(index.message_index_offsets):
                    self.offset = index.chunk_start_offset
                    yield from self._chosen(wanted)

    def _chosen(self, wanted: Set[int]) -> Iterator[Entry]:
        """Return the messages of some channels in the chunk that is next."""
        opcode, body = self._record()
        if opcode != Opcode.CHUNK:
            raise DamageError("its index names a chunk where none is")
        data = _unpacked(body)
        self._work(len(data))
        for kind, first, last in _records(data):
            is_message = kind == Opcode.MESSAGE and last - first >= _MESSAGE.size
            if is_message and _CHANNEL_ID.unpack_from(data, first)[0] in wanted:
                yield from _inner(data[first - _HEAD.size : last])

    def _record(self) -> tuple[int, bytes]:
        """Return the kind and body of the next record of the file, and advance behind it."""
        begin, head = self.offset, self._bytes(self.offset, _HEAD.size)
        if len(head) < _HEAD.size:
            raise DamageError(_CUT)
        opcode, length = _HEAD.unpack(head)
        if length == _LENGTH_OF_OPEN:
            raise DamageError(_CUT)
        if opcode == 0 or length > RECORD_MAX_BYTES:
            raise DamageError(f"a record of kind {opcode} states a length of {length} bytes")
        if begin + _HEAD.size + length > self.size_bytes:
            raise DamageError(_CUT)
        body = self._bytes(begin + _HEAD.size, length)
        if opcode != Opcode.DATA_END:
            self._crc = zlib.crc32(body, zlib.crc32(head, self._crc))
        self.offset = begin + _HEAD.size + length
        return opcode, body

    def _entries_of(self, opcode: int, body: bytes) -> Iterator[Entry]:
        """Return the entries of a record of the data section."""
        match opcode:
            case Opcode.CHUNK:
                data = _unpacked(body)
                self._work(len(data))
                yield from _inner(data)
            case Opcode.HEADER:
                pass
            case Opcode.METADATA:
                yield _parsed(Metadata.read, body)
            case Opcode.SCHEMA | Opcode.CHANNEL | Opcode.MESSAGE:
                yield from _inner(_HEAD.pack(opcode, len(body)) + body)
            case Opcode.MESSAGE_INDEX:
                if len(body) < 6 or int.from_bytes(body[2:6], "little") != len(body) - 6:
                    raise DamageError("a message index is damaged")
            case _:
                self._report(
                    f"at byte {self.offset - len(body)}: {len(body)} bytes of unknown kind {opcode} are left out"
                )

    def _recovered_from(self, reason: str, begin: int) -> bool:
        """Advance to the next chunk after damage, and report what is skipped; return whether there is one."""
        self._crc = -1
        try:
            found = self._next_chunk(begin + 1)
        except DamageError as damage:
            self._report(f"not readable from byte {begin} on: {damage}")
            return False
        end = self.size_bytes if found is None else found
        at_end = reason == _CUT and found is None and not self.is_closed
        self._report(f"at byte {begin}: {reason}; {end - begin} bytes are left out", is_damage=not at_end)
        self.offset = end
        return found is not None

    def _next_chunk(self, begin: int) -> int | None:
        """Return the offset of the next record that has the form of a chunk."""
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
        """Return whether a chunk's two lengths agree and lie within the file."""
        fixed = _SIGN_OFFSET - _HEAD.size + len(_CHUNK_SIGN)
        head = self._bytes(begin, _HEAD.size + fixed + 8)
        if len(head) < _HEAD.size + fixed + 8:
            return False
        opcode, length = _HEAD.unpack_from(head)
        packed = int.from_bytes(head[-8:], "little")
        fits = begin + _HEAD.size + length <= self.size_bytes
        return bool(opcode == Opcode.CHUNK and length == fixed + 8 + packed and length <= RECORD_MAX_BYTES and fits)

    def _summary(self) -> Iterator[Entry]:
        """Return the channels and schemas of a closed file's summary, needed if its beginning is damaged."""
        summary = self._index()
        try:
            for opcode, first, last in _records(summary):
                if opcode == Opcode.STATISTICS:
                    self._messages_written = _parsed(Statistics.read, summary[first:last]).message_count
            yield from (entry for entry in _inner(summary) if type(entry) is not EncodedMessage)
        except DamageError:
            self._report("its index is damaged")

    def _index(self) -> bytes:
        """Return the records of a closed file's summary; empty without one, or if it is damaged, which is reported."""
        end = self.size_bytes - len(MAGIC) - _FOOTER_BYTES - _HEAD.size
        foot = self._bytes(max(end, 0), _HEAD.size + _FOOTER_BYTES + len(MAGIC))
        if end < len(MAGIC) or not foot.endswith(MAGIC) or _HEAD.unpack_from(foot) != (Opcode.FOOTER, _FOOTER_BYTES):
            return b""
        self.is_closed = True
        footer = _parsed(Footer.read, foot[_HEAD.size : -len(MAGIC)])
        begin, crc = footer.summary_start, footer.summary_crc
        if begin == 0:
            return b""
        summary = self._bytes(begin, end - begin) if 0 <= end - begin <= RECORD_MAX_BYTES else b""
        if not summary or (crc and zlib.crc32(foot[: -len(MAGIC) - 4], zlib.crc32(summary)) != crc):
            self._report(f"at byte {end}: its index is damaged")
            return b""
        return summary

    def _end_of_data(self, body: bytes) -> None:
        if len(body) != 4:
            raise DamageError("the end of the data is damaged")
        crc = _parsed(DataEnd.read, body).data_section_crc
        if crc and self._crc >= 0 and crc != self._crc:
            self._report("the checksum of the file does not match: bytes outside its records are damaged")

    def _bytes(self, begin: int, count: int) -> bytes:
        self._work(min(count, self.size_bytes))
        self._stream.seek(begin)
        return self._stream.read(count)

    def _work(self, count: int) -> None:
        self._work_bytes -= count
        if self._work_bytes < 0:
            raise DamageError("it unpacks to more than a file of its size can hold")

    def _report(self, fault: str, *, is_damage: bool = True) -> None:
        self.is_damaged |= is_damage
        if len(self._faults) < FAULTS_MAX:
            self._faults.append(fault)
        else:
            self._more_faults += 1


class _Fields(ReadDataStream):
    """The fields of a record; raises DamageError where mcap's own stream returns too few bytes."""

    def __init__(self, body: bytes) -> None:
        super().__init__(BytesIO(body))
        self._size_bytes = len(body)

    def read(self, length: int) -> bytes:
        if length > self._size_bytes - self.count:
            raise DamageError("a record is shorter than its fields")
        return super().read(length)


def _parsed(read: Callable[[ReadDataStream], RecordT], body: bytes) -> RecordT:
    """Return a record parsed by mcap; raises DamageError."""
    try:
        return read(_Fields(body))
    except UnicodeDecodeError as error:
        raise DamageError("a text is damaged") from error


def _unpacked(body: bytes) -> bytes:
    """Return the records of a chunk; the sizes that it states are checked before mcap unpacks it."""
    chunk = _parsed(Chunk.read, body)
    if chunk.uncompressed_size > RECORD_MAX_BYTES or chunk.compression not in (_COMPRESSION, ""):
        raise DamageError(f"a chunk states {chunk.uncompressed_size} bytes of compression {chunk.compression!r}")
    if _CHUNK.size + len(chunk.compression) + 8 + len(chunk.data) != len(body):
        raise DamageError("a chunk's lengths do not agree")
    try:
        if chunk.compression and zstandard.frame_content_size(chunk.data) not in (-1, chunk.uncompressed_size):
            raise DamageError("a chunk's stated size does not match its content")
        stream, size_bytes = get_chunk_data_stream(chunk, validate_crc=True)
    except zstandard.ZstdError as error:
        raise DamageError("a chunk cannot be unpacked") from error
    except CRCValidationError as error:
        raise DamageError("a chunk's checksum does not match") from error
    if size_bytes != chunk.uncompressed_size:
        raise DamageError("a chunk's stated size does not match its content")
    return stream.read(size_bytes)


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Return the kind of each record, and where its body begins and ends."""
    begin, end = 0, len(data)
    while begin < end:
        if begin + _HEAD.size > end:
            raise DamageError("a record is cut off")
        opcode, length = _HEAD.unpack_from(data, begin)
        first = begin + _HEAD.size
        begin = first + length
        if begin > end:
            raise DamageError("a record is longer than its chunk")
        yield opcode, first, begin


def _inner(data: bytes) -> Iterator[Entry]:
    """Return the entries in the data of a chunk."""
    for opcode, first, last in _records(data):
        if opcode == Opcode.MESSAGE:
            if last - first < _MESSAGE.size:
                raise DamageError("a message is damaged")
            channel_id, sequence, time_ns, published_ns = _MESSAGE.unpack_from(data, first)
            yield EncodedMessage(channel_id, sequence, time_ns, published_ns, data[first + _MESSAGE.size : last])
        elif opcode == Opcode.SCHEMA:
            yield _parsed(Schema.read, data[first:last])
        elif opcode == Opcode.CHANNEL:
            yield _parsed(Channel.read, data[first:last])
