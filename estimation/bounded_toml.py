"""TOML text from outside, with bounded parsing: Python's parser uses memory with the square of a dotted key's parts."""

import re
import tomllib
from typing import Any

TEXT_MAX_LENGTH = 128_000
"""A mission of 254 vehicles has half of this length."""
KEY_PARTS_MAX = 32

_STRINGS_AND_COMMENTS = re.compile(
    r'"""(?:\\[\s\S]|[^\\])*?"""' + r"|'''[\s\S]*?'''" + r'|"(?:\\.|[^"\\\n])*"' + r"|'[^'\n]*'|#[^\n]*"
)
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
