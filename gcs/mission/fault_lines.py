"""The faults of a mission's text: of its syntax, and the line of each; left out if it is not found."""

import re
from collections.abc import Collection, Sequence
from itertools import accumulate
from pathlib import Path

from gcs.errors import KeyFault

_SYNTAX_LINE = re.compile(r"at line (\d+)")
_HEADER = re.compile(r"\s*(\[\[?)\s*([\w.-]+)\s*\]")
_KEY = re.compile(r"\s*([\w.-]+)\s*=")
_PARTS = re.compile(r"[^.\[]+|\[\d+\]")
_SHOWN_MAX = 80
_ADVICE = {
    "Expected newline or end of document after a statement": "write a number as 10.5, without a unit",
    "Expected '='": "write KEY = VALUE",
    "Invalid value": "write text in quotation marks, numbers as 10.5, and true or false in small letters",
    "Illegal character": "close the quotation marks on the same line",
    "Expected ']'": "close the bracket",
    "Unclosed array": "close the bracket",
    "Cannot overwrite a value": "the key occurs twice: leave one of them out",
    "Cannot declare": "the section occurs twice: merge its keys; each vehicle begins with [[vehicles]]",
}
"""Next steps for faults of TOML syntax, by the beginning of the parser's message."""


def syntax_fault(error: ValueError, text: str) -> KeyFault:
    """Return the fault of a text that is not TOML, from the parser's error."""
    message = str(error)
    advice = next((f"; {each}" for start, each in _ADVICE.items() if message.startswith(start)), "")
    match = _SYNTAX_LINE.search(message)
    line = int(match[1]) if match else len(text.rstrip().split("\n"))  # at the end of the document
    return KeyFault("not TOML", f"{message}{advice}", line)


def located(faults: Sequence[KeyFault], path: Path, text: str, changes: Collection[str]) -> list[str]:
    """Return the faults of a mission, each followed by file, line and the line's text as far as they are known.

    A fault at a path of `changes` comes from the command line.
    """
    lines = text.split("\n")
    known = _numbers(lines)
    return [f"{fault}{_source(fault, path, lines, known, changes)}" for fault in faults]


def _source(fault: KeyFault, path: Path, lines: list[str], known: dict[str, int], changes: Collection[str]) -> str:
    """Return the text behind a fault that states its source."""
    around = [*accumulate(_PARTS.findall(fault.place), _below)][::-1]
    if any(each in changes for each in around):
        return " [set, not in the file]"
    number = fault.line or next((known[each] for each in around if each in known), 0)
    if not 0 < number <= len(lines):
        return f" [{path.name}]"
    shown = "".join(letter if letter.isprintable() else " " for letter in lines[number - 1].strip())
    return f" [{path.name}, line {number}: {shown[:_SHOWN_MAX]}]"


def _numbers(lines: Sequence[str]) -> dict[str, int]:
    """Return the line numbers of keys and tables, by their paths such as `vehicles[0].url`."""
    found: dict[str, int] = {}
    table, counts = "", dict[str, int]()
    for number, line in enumerate(lines, start=1):
        if header := _HEADER.match(line):
            brackets, table = header.groups()
            if brackets == "[[":
                counts[table] = counts.get(table, -1) + 1
                found.setdefault(table, number)
                table = f"{table}[{counts[table]}]"
            found.setdefault(table, number)
        elif key := _KEY.match(line):
            found.setdefault(_below(table, key[1]), number)
    return found


def _below(place: str, part: str) -> str:
    return f"{place}{'' if not place or part.startswith('[') else '.'}{part}"
