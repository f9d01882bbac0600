"""The file of a log. Disk errors are stored and never raised, so that they do not affect the flight."""

import os
from pathlib import Path


class Disk:
    """A file for writing that never raises once it is open: after the first error it discards its input.

    `fault` is the first error, empty if there was none; `size_bytes` is the number of bytes written.
    """

    def __init__(self, path: Path) -> None:
        """Create the file; raises OSError when that fails, or when it exists already."""
        self._file = path.open("xb", buffering=0)
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
