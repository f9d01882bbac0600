"""Text from other computers, without control characters, which a terminal would execute."""

import re

CONTROL = r"\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
"""Control characters of ASCII, Latin-1 and Unicode: escape sequences, line ends, and writing direction controls.

And what stands for a byte of a file's name that is no text.
"""
PRINTABLE = rf"\A[^{CONTROL}]*\Z"
_CONTROL = re.compile(f"[{CONTROL}]")


def printable(text: str) -> str:
    """Return a text with '?' in place of each control character."""
    return _CONTROL.sub("?", text)
