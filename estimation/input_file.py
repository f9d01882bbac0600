"""TOML text from outside, with bounded parsing: Python's parser uses memory with the square of a dotted key's parts."""

import errno
import re
import stat
import tomllib
from io import BufferedReader
from pathlib import Path
from typing import Any


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


TEXT_MAX_LENGTH = 128_000
"""A mission of 254 vehicles has half of this length."""
KEY_PARTS_MAX = 32

_STRINGS_AND_COMMENTS = re.compile(
    r'"""(?:\\[\s\S]|[^\\])*?"""' + r"|'''[\s\S]*?'''" + r'|"(?:\\.|[^"\\\n])*"' + r"|'[^'\n]*'|#[^\n]*"
)
_LONG_NUMBER = re.compile(r"\d[\d_]{4000}")
_BETWEEN_KEYS = re.compile(r"[,\[\]{}=\n]")


def toml_content(text: str) -> dict[str, Any]:
    """Return the content of a TOML text; raises ValueError if it is invalid, too large or too deeply nested."""
    if len(text) > TEXT_MAX_LENGTH:
        raise ValueError(f"it is longer than {TEXT_MAX_LENGTH} characters")
    parts = max(piece.count(".") for piece in _BETWEEN_KEYS.split(_STRINGS_AND_COMMENTS.sub("", text)))
    if parts >= KEY_PARTS_MAX:
        raise ValueError(f"a key has more than {KEY_PARTS_MAX} parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # of Python's integers, without a place
        long = _LONG_NUMBER.search(text)
        at = f" (at line {text.count(chr(10), 0, long.start()) + 1})" if long else ""
        raise ValueError(f"a number has more digits than are read{at}") from error
