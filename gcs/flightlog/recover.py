"""Making a log that was never closed, or was damaged since, a whole one again: a copy of all that can be read of it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Metadata, Schema
from mcap.writer import CompressionType, Writer

from gcs.errors import InputError
from gcs.flightlog.census import Census
from gcs.flightlog.container import Container, Entry, Message
from gcs.flightlog.log_error import LogError
from gcs.flightlog.reader import faults_of, open_container, topic_of
from gcs.flightlog.records import PROFILE

_CHUNK_BYTES = 1 << 20
_PROGRESS_STEP_BYTES = 1_000_000
Progress = Callable[[float], None]
"""Is told which share of the log has been gone through."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """What was recovered: how many records, lasting how long; `faults` says what was not, empty when all is whole."""

    records: int
    seconds: float
    faults: tuple[str, ...]


def examine(path: Path, progress: Progress) -> Recovery:
    """Go through a log and change nothing; raises LogError when nothing of cordon's can be read in it."""
    with open_container(path) as container:
        return _gone_through(path, container, lambda _entry: None, progress)


def recover(path: Path, target: Path, progress: Progress) -> Recovery:
    """Write all that is whole of a log into another, which is closed and indexed.

    Raises LogError when nothing of cordon's can be read, InputError when the target cannot be written or exists:
    nothing is left of it then.
    """
    with open_container(path) as container, _new_file(target) as stream:
        copy = _Copy(stream)
        recovery = _gone_through(path, container, copy.take, progress)
        copy.finish()
        return recovery


def recovered_path(path: Path) -> Path:
    """Return where the recovered log goes unless told otherwise."""
    return path.with_name(f"{path.stem}-recovered.mcap")


def _gone_through(path: Path, container: Container, take: Callable[[Entry], None], progress: Progress) -> Recovery:
    census, undescribed, told_bytes = Census(), 0, 0
    vehicles: dict[int, int | None] = {}
    for entry in container.entries():
        take(entry)
        if isinstance(entry, Channel):
            topic = topic_of(entry.topic)
            vehicles.setdefault(entry.id, None if topic is None else topic[1])
        elif isinstance(entry, Message):
            vehicle_id = vehicles.get(entry.channel_id)
            undescribed += entry.channel_id not in vehicles
            if vehicle_id is not None:
                census.note(vehicle_id, entry.time_ns, entry.payload)
        if container.offset - told_bytes > _PROGRESS_STEP_BYTES:
            told_bytes = container.offset
            progress(told_bytes / container.size_bytes)
    faults = faults_of(container, census)
    if not census.total:
        raise LogError([f"{path}: it holds no record of cordon's", *(f"{path}: {fault}" for fault in container.faults)])
    if undescribed:
        faults.append(f"{undescribed} records are lost with the description of their channel")
    return Recovery(census.total, census.seconds, tuple(faults))


@contextmanager
def _new_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that did not exist, and remove it again unless all goes well; raises InputError."""
    try:
        with path.open("xb") as stream:
            try:
                yield stream
                stream.flush()
            except BaseException:
                path.unlink()
                raise
    except FileExistsError as error:
        raise InputError([f"--output: {str(path)!r} exists already: nothing is overwritten"]) from error
    except OSError as error:
        raise InputError([f"--output: {str(path)!r}: {error.strerror or error}"]) from error


class _Copy:
    """A log in the making: the same schemas, channels, records and words about it, numbered anew."""

    def __init__(self, stream: BinaryIO) -> None:
        self._writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, "cordon log recover")
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}

    def take(self, entry: Entry) -> None:
        """Take what comes next; leave out what nobody could read without what is lost."""
        match entry:
            case Message():
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
        """Complete it."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # it takes and returns nothing
