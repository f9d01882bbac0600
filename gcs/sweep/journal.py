"""The journal of a sweep: one line for each finished run, flushed to disk before the next one is written.

A killed process leaves at most its last line incomplete. Runs whose lines cannot be read are flown again.
"""

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from gcs.errors import InputError
from gcs.sweep.columns import Row


class _Line(msgspec.Struct):
    run: int
    row: Row


_DECODER = msgspec.json.Decoder(_Line)


def read_rows(path: Path) -> dict[int, Row]:
    """Return the rows of a journal by run index; raises OSError."""
    rows: dict[int, Row] = {}
    for line in path.read_bytes().splitlines():
        try:
            read = _DECODER.decode(line)
        except msgspec.MsgspecError:
            continue
        rows[read.run] = read.row
    return rows


class SweepJournal:
    """A journal to append to, as a context manager, locked by one process at a time. `rows` are its present rows.

    Raises InputError if another process has locked it, OSError if it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("ab")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._file.close()
            raise InputError([f"{path}: another sweep writes to it; end that sweep, or wait for it"]) from error
        whole = path.read_bytes().rfind(b"\n") + 1
        self._file.truncate(whole)  # removes an incomplete last line
        self.rows = read_rows(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def append(self, run: int, row: Row) -> None:
        """Append a finished run; raises OSError if it cannot be written."""
        self.rows[run] = row
        self._file.write(msgspec.json.encode(_Line(run, row)) + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())
