"""Files from outside: regular files only, with a size limit. Pipes and devices are refused without waiting."""

import errno
import stat
from io import BufferedReader
from pathlib import Path


def open_plain(path: Path) -> BufferedReader:
    """Open a regular file for reading; raises OSError, also for a pipe, a device or a folder, without waiting."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "it is not a file", str(path))
    return path.open("rb")


def read_plain(path: Path, bytes_max: int) -> bytes:
    """Return the content of a regular file; raises OSError, also if it is larger than `bytes_max`."""
    with open_plain(path) as file:
        content = file.read(bytes_max + 1)
    if len(content) > bytes_max:
        raise OSError(errno.EFBIG, f"it is larger than {bytes_max / 1000:g} kB", str(path))
    return content
