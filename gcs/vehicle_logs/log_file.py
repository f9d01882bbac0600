"""A log as a file: the check that it can be read, its hash, and the suppression of its readers' output."""

import hashlib
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import TextIOBase
from pathlib import Path

import numpy as np

from estimation.input_file import open_plain
from gcs.flightlog.container import LogError, unpadded_bytes

BYTES_MAX = 1 << 30
"""A larger log is refused: every byte is read, and some readers hold the log in memory."""
HEAD_BYTES = 4096
MAVLINK_MAGICS = (0xFD, 0xFE)
STAMP_BYTES = 8
STAMPS_US = range(946_684_800_000_000, 4_102_444_800_000_000)
"""Microseconds since 1970 from the year 2000 up to 2100: when a ground station may have stamped a packet."""


@dataclass(frozen=True, slots=True)
class LogFile:
    """An existing log: its path, its size without padding at its end, its first bytes and its hash."""

    path: Path
    size_bytes: int
    head: bytes
    sha256: str
    padding_bytes: int = 0

    @property
    def name(self) -> str:
        """Its name in faults."""
        return str(self.path)

    @property
    def notes(self) -> list[str]:
        """What holds for the file as a whole."""
        return [f"{self.padding_bytes} bytes of padding at the end were left out"] if self.padding_bytes else []

    def content(self) -> bytes:
        """Return its bytes without the padding; raises OSError."""
        with open_plain(self.path) as file:
            return file.read(self.size_bytes)


def open_log(path: Path) -> LogFile:
    """Open a log's file; raises LogError when it is missing, not a file, empty, too large or unreadable."""
    try:
        with open_plain(path) as file:
            size_bytes = os.fstat(file.fileno()).st_size
            if size_bytes == 0:
                raise LogError([f"{path}: the file is empty"])
            if size_bytes > BYTES_MAX:
                size = f"{size_bytes / 1e9:.1f} GB"
                raise LogError([f"{path}: the file has {size}; the limit is {BYTES_MAX / 1e9:.1f} GB: cut it first"])
            head = file.read(HEAD_BYTES)
            file.seek(0)
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            content_bytes = unpadded_bytes(file, size_bytes)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise LogError([f"{path}: cannot be read: {reason}"]) from None
    return LogFile(path, content_bytes, head, sha256, size_bytes - content_bytes)


class _Nowhere(TextIOBase):
    """Discards what is printed."""

    def write(self, text: str) -> int:
        return len(text)


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output and warnings of libraries while they read: readers report by notes and faults."""
    nowhere = _Nowhere()
    with redirect_stdout(nowhere), redirect_stderr(nowhere), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield
