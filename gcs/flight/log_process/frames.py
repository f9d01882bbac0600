"""The frames from the flying process to the log process: batches of records in MessagePack, and two words."""

from typing import Any, NamedTuple

from msgspec import Raw, msgpack

from gcs.flightlog.records import RUN_TOPICS, VEHICLE_TOPICS

FLUSH, CLOSE = b"flush", b"close"
"""No batch begins like these: a batch is a MessagePack array."""
_KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in (*RUN_TOPICS, *VEHICLE_TOPICS)}


class EncodedRecord(NamedTuple):
    """An encoded record, with its vehicle's id (0: the run's), its number and the time stamp of the log [ns]."""

    vehicle_id: int
    number: int
    log_time_ns: int
    kind: str
    record: Raw


class Batch:
    """Records that are sent together."""

    def __init__(self) -> None:
        self._encoder = msgpack.Encoder()
        self._rows: list[Raw] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, vehicle_id: int, number: int, log_time_ns: int, record: object) -> None:
        """Add a record; raises TypeError for one that cannot be encoded."""
        row = (vehicle_id, number, log_time_ns, type(record).__name__, record)
        self._rows.append(Raw(self._encoder.encode(row)))

    def take(self) -> bytes:
        """Return the frame of all records, and empty the batch."""
        frame = self._encoder.encode(self._rows)
        self._rows.clear()
        return frame


class BatchReader:
    """Reads the frames of batches."""

    def __init__(self) -> None:
        self._rows = msgpack.Decoder(list[EncodedRecord])
        self._records = {name: msgpack.Decoder(kind) for name, kind in _KINDS.items()}

    def rows(self, frame: bytes) -> list[EncodedRecord]:
        """Return the encoded records of a frame."""
        return self._rows.decode(frame)

    def record(self, row: EncodedRecord) -> object:
        """Return a record; raises ValidationError for one that does not fit its type."""
        return self._records[row.kind].decode(row.record)
