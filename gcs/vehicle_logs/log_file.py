"""A log as a file: whether it can be read at all, its hash, and keeping its readers quiet."""

import hashlib
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import TextIOBase
from pathlib import Path

import numpy as np

from estimation.plain_file import open_plain
from gcs.flightlog.log_error import LogError

BYTES_MAX = 1 << 30
"""A larger log is refused: reading goes over every byte, and some of the readers hold it in memory."""
HEAD_BYTES = 4096


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log that is there: where, how many bytes, its first bytes and the hash of all."""

    path: Path
    size_bytes: int
    head: bytes
    sha256: str

    @property
    def name(self) -> str:
        """What faults call it."""
        return str(self.path)


def open_log(path: Path) -> LogFile:
    """Look at a log's file; raises LogError when it is not there, is no file, empty, too large or unreadable."""
    try:
        with open_plain(path) as file:
            size_bytes = os.fstat(file.fileno()).st_size
            if size_bytes == 0:
                raise LogError([f"{path}: is empty"])
            if size_bytes > BYTES_MAX:
                size = f"{size_bytes / 1e9:.1f} GB"
                raise LogError([f"{path}: is {size}; logs are read up to {BYTES_MAX / 1e9:.1f} GB, so cut it first"])
            head = file.read(HEAD_BYTES)
            file.seek(0)
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise LogError([f"{path}: cannot be read: {reason}"]) from None
    return LogFile(path, size_bytes, head, sha256)


class _Nowhere(TextIOBase):
    """Takes what is printed, and keeps none of it."""

    def write(self, text: str) -> int:
        return len(text)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep what libraries print and warn of while they read off the terminal: readers tell by notes and faults."""
    nowhere = _Nowhere()
    with redirect_stdout(nowhere), redirect_stderr(nowhere), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield
