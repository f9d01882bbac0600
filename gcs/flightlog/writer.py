"""Writes records to an MCAP file and to the live viewers of the Foxglove WebSocket."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.mcap import MCAPWriteOptions

from gcs.flightlog.records import PROFILE, RUN_TOPICS, VEHICLE_TOPICS, Run
from gcs.flightlog.schema import Codec, codec_of
from gcs.keys.private_files import create


class Disk:
    """A file for writing that never raises once it is open: after the first error it discards its input.

    `fault` is the first error, empty if there was none; `size_bytes` is the number of bytes written.
    """

    def __init__(self, path: Path) -> None:
        """Create the file; raises OSError when that fails, or when it exists already."""
        self._file = create(path, "xb").detach()
        self._position = self._end = 0
        self.size_bytes = 0
        self.fault = ""

    def write(self, data: bytes) -> int:
        """Write all of it, or store the error."""
        rest = memoryview(data)
        try:
            while rest and not self.fault:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError as error:
            self.fault = error.strerror or str(error)
        self._position += len(data)
        self._end = max(self._end, self._position)
        if len(rest) < len(data):
            self.size_bytes = max(self.size_bytes, self._position - len(rest))
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Set the position, also after an error."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._end}[whence]
        self._position = base + offset
        if not self.fault:
            try:
                self._file.seek(self._position)
            except OSError as error:
                self.fault = error.strerror or str(error)
        return self._position

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def close(self) -> None:
        """Close the file."""
        try:
            self._file.close()
        except OSError as error:
            self.fault = self.fault or error.strerror or str(error)


SIZE_MAX_BYTES = 2_000_000_000
"""The size at which a log ends: eight hours of three vehicles at 20 Hz."""

CHUNK_BYTES = 1 << 17
"""The most that one flipped bit destroys, before compression."""
REPEAT_BYTES = 1_000_000
"""How often the record of the run is repeated: without it a log can be neither replayed nor reported."""

Picture = Callable[[int, int, Any], None]
"""Draws a record for viewers: the vehicle, the time [ns], and the record."""


class LogWriter:
    """Writes records; once open it never raises: `fault` is the first error, empty if there was none."""

    def __init__(
        self,
        path: Path | None,
        context: Context,
        picture: Picture | None = None,
        size_max_bytes: int = SIZE_MAX_BYTES,
    ) -> None:
        """Open the file, or for None write only to the context's other sinks; raises OSError when that fails."""
        self.path = path
        self._context = context
        self._picture = picture
        self._disk = None if path is None else Disk(path)
        self._size_max_bytes = size_max_bytes
        self._channels: dict[tuple[type, int], tuple[Channel, Codec]] = {}
        options = MCAPWriteOptions(profile=PROFILE, chunk_size=CHUNK_BYTES, compression_threads=0)
        self._mcap = None
        if self._disk is not None:
            self._mcap = foxglove.open_mcap(self._disk, context=context, writer_options=options)  # type: ignore[arg-type]  # it is BinaryIO enough
        self._failure = ""
        self._run: Run | None = None
        self._run_at_bytes = 0
        self._log_time_ns = 0

    @property
    def fault(self) -> str:
        """The reason why the file does not hold the whole flight."""
        return self._failure or ("" if self._disk is None else self._disk.fault)

    def fail(self, reason: str) -> None:
        """Store the reason why the file will not hold the whole flight; the first one is kept."""
        self._failure = self._failure or reason

    @property
    def size_bytes(self) -> int:
        """The bytes written to the file."""
        return 0 if self._disk is None else self._disk.size_bytes

    def write(self, vehicle_id: int, number: int, log_time_ns: int, record: object) -> None:
        """Write a vehicle's record, or one of the whole run with vehicle 0."""
        self._log(vehicle_id, number, log_time_ns, record)
        self._draw(vehicle_id, log_time_ns, record)
        self._log_time_ns = max(log_time_ns, self._log_time_ns)
        if isinstance(record, Run):
            self._run, self._run_at_bytes = record, self.size_bytes
        elif self.size_bytes - self._run_at_bytes > REPEAT_BYTES:
            self._repeat_run()
        if self._mcap is not None and self.size_bytes > self._size_max_bytes:
            self.close()
            self.fail(f"it has reached {self._size_max_bytes / 1e6:g} MB and ends there")

    def flush(self) -> None:
        """Pass all that has been written to the operating system."""
        if self._mcap is not None:
            self._mcap.flush()

    def close(self) -> None:
        """Complete the file and close it."""
        if self._mcap is not None and self._disk is not None:
            self.flush()  # a chunk of its own, in case the one before is damaged
            self._repeat_run()
            self._mcap.close()
            self._mcap = None
            self._disk.close()

    def _draw(self, vehicle_id: int, log_time_ns: int, record: object) -> None:
        if self._picture is None:
            return
        try:
            self._picture(vehicle_id, log_time_ns, record)
        except Exception as error:  # a bug in the viewers' messages must not end the log
            self._picture = None
            self.fail(f"the messages for viewers ended: {type(error).__name__}: {error}")

    def _repeat_run(self) -> None:
        self._run_at_bytes = self.size_bytes
        if self._run is not None:
            self._log(0, 0, self._log_time_ns, self._run)

    def _log(self, vehicle_id: int, number: int, log_time_ns: int, record: object) -> None:
        kind: type[Any] = type(record)
        channel, codec = self._channels.get((kind, vehicle_id)) or self._open_channel(kind, vehicle_id)
        channel.log(codec.encode(record, number), log_time=log_time_ns)

    def _open_channel(self, kind: type[Any], vehicle_id: int) -> tuple[Channel, Codec]:
        topic = f"/vehicle/{vehicle_id}/{VEHICLE_TOPICS[kind]}" if vehicle_id else f"/{RUN_TOPICS[kind]}"
        codec = codec_of(kind)  # type: ignore[arg-type]  # mypy holds that type[Any] has no hash
        schema = Schema(name=codec.name, encoding="protobuf", data=codec.schema)
        channel = Channel(topic, schema=schema, message_encoding="protobuf", context=self._context)
        self._channels[kind, vehicle_id] = channel, codec
        return channel, codec
