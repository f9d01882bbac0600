"""Recovery of an unclosed or damaged log: a closed, indexed copy of all that can be read of it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from gcs.errors import InputError
from gcs.flightlog.container import Container, EncodedMessage, Entry, LogError
from gcs.flightlog.reader import RecordCounter, faults_of, open_container, topic_of
from gcs.flightlog.records import PROFILE
from gcs.keys.private_files import create

_CHUNK_BYTES = 1 << 20
_PROGRESS_STEP_BYTES = 1_000_000
Progress = Callable[[float], None]
"""Called with the share of the log that has been processed."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """The number of records recovered, their duration, and in `faults` what was not recovered.

    It `is_damaged` if records between others are lost, not only the end.
    """

    records: int
    seconds: float
    faults: tuple[str, ...]
    is_damaged: bool


def examine(path: Path, progress: Progress) -> Recovery:
    """Check a log without a copy; raises LogError when it holds no readable cordon record."""
    with open_container(path) as container:
        return _gone_through(path, container, lambda _entry: None, progress)


def recover(path: Path, target: Path, progress: Progress) -> Recovery:
    """Copy all undamaged records of a log into another, which is closed and indexed.

    Raises LogError when it holds no readable cordon record, InputError when the target exists or cannot be
    written; an incomplete target is removed.
    """
    with open_container(path) as container, _new_file(target) as stream:
        copy = _Copy(stream)
        recovery = _gone_through(path, container, copy.take, progress)
        copy.finish()
        return recovery


def recovered_path(path: Path) -> Path:
    """Return the default path of the recovered log."""
    return path.with_name(f"{path.stem}-recovered.mcap")


def _gone_through(path: Path, container: Container, take: Callable[[Entry], None], progress: Progress) -> Recovery:
    counter, undescribed, reported_bytes = RecordCounter(), 0, 0
    vehicles: dict[int, int | None] = {}
    for entry in container.entries():
        take(entry)
        if isinstance(entry, Channel):
            topic = topic_of(entry.topic)
            vehicles.setdefault(entry.id, None if topic is None else topic[1])
        elif isinstance(entry, EncodedMessage):
            vehicle_id = vehicles.get(entry.channel_id)
            undescribed += entry.channel_id not in vehicles
            if vehicle_id is not None:
                counter.note(vehicle_id, entry.time_ns, entry.payload)
        if container.offset - reported_bytes > _PROGRESS_STEP_BYTES:
            reported_bytes = container.offset
            progress(reported_bytes / container.size_bytes)
    faults = faults_of(container, counter)
    if not counter.total:
        raise LogError([f"{path}: it holds no cordon record", *(f"{path}: {fault}" for fault in container.faults)])
    if undescribed:
        faults.append(f"{undescribed} records are lost because the description of their channel is")
    is_damaged = container.is_damaged or bool(counter.faults) or undescribed > 0
    return Recovery(counter.total, counter.seconds, tuple(faults), is_damaged)


@contextmanager
def _new_file(path: Path) -> Iterator[BinaryIO]:
    """Create a file, and remove it again after an exception; raises InputError."""
    try:
        with create(path, "xb") as stream:
            try:
                yield stream
                stream.flush()
            except BaseException:
                path.unlink()
                raise
    except FileExistsError as error:
        raise InputError([f"--output: {str(path)!r} exists already, and is not overwritten; name another"]) from error
    except OSError as error:
        raise InputError([f"--output: {str(path)!r}: {error.strerror or error}"]) from error


class _Copy:
    """The copy: the same schemas, channels, records and metadata, with new ids."""

    def __init__(self, stream: BinaryIO) -> None:
        self._writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, "cordon log recover")
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}

    def take(self, entry: Entry) -> None:
        """Write the next entry; leave out entries whose schema or channel is lost."""
        match entry:
            case EncodedMessage():
                if entry.channel_id in self._channels:
                    self._writer.add_message(
                        self._channels[entry.channel_id],
                        log_time=entry.time_ns,
                        data=entry.payload,
                        publish_time=entry.published_ns,
                        sequence=entry.sequence,
                    )
            case Schema() if entry.id not in self._schemas:
                self._schemas[entry.id] = self._writer.register_schema(entry.name, entry.encoding, entry.data)
            case Channel() if entry.id not in self._channels and entry.schema_id in self._schemas:
                self._channels[entry.id] = self._writer.register_channel(
                    entry.topic, entry.message_encoding, self._schemas[entry.schema_id], entry.metadata
                )
            case Metadata():
                self._writer.add_metadata(entry.name, entry.metadata)

    def finish(self) -> None:
        """Write the index and close the log."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # it takes and returns nothing
