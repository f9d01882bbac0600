"""Fence and no-fly zones in the text of a mission file: replaced without a change of anything else."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import tomli_w

from gcs.errors import InputError

_HEADER = re.compile(r"[ \t]*\[")
_ZONE = re.compile(r"[ \t]*\[\[[ \t]*safety[ \t]*\.[ \t]*no_fly[ \t]*\]\]")
_SAFETY = re.compile(r"[ \t]*\[[ \t]*safety[ \t]*\]")
_FENCE = re.compile(r"[ \t]*fence_m[ \t]*=")


def with_areas(text: str, fence_m: Sequence[Sequence[float]], zones: Sequence[Mapping[str, Any]]) -> str:
    """Return a mission's text with this fence of `[safety]` (empty: none) and these `[[safety.no_fly]]`, at its end.

    Comments stay, except those in the tables and lines that are replaced. Raises InputError for a text whose other
    content would change, such as one with `safety = {...}` on a line.
    """
    lines = _without_fence(_without_zones(text.splitlines()))
    if fence_m:
        lines = _with_fence(lines, fence_m)
    made = "\n".join(lines).rstrip("\n") + "\n" + "".join(f"\n{_as_table(zone)}" for zone in zones)
    try:
        is_right = _content(made) == _wanted(text, fence_m, zones)
    except tomllib.TOMLDecodeError:
        is_right = False
    if not is_right:
        raise InputError(["the mission file's [safety] is written so that it cannot be changed here: edit it as text"])
    return made


def _as_table(zone: Mapping[str, Any]) -> str:
    return "[[safety.no_fly]]\n" + tomli_w.dumps(dict(zone))


def _wanted(text: str, fence_m: Sequence[Sequence[float]], zones: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the content that the changed text must have."""
    content = _content(text)
    safety = {key: value for key, value in content.pop("safety", {}).items() if key not in ("fence_m", "no_fly")}
    if fence_m:
        safety["fence_m"] = [list(corner) for corner in fence_m]
    if zones:
        safety["no_fly"] = [dict(zone) for zone in zones]
    return {**content, "safety": safety} if safety else content


def _content(text: str) -> dict[str, Any]:
    content = tomllib.loads(text)
    if content.get("safety") == {}:
        del content["safety"]
    return content


def _without_zones(lines: Sequence[str]) -> list[str]:
    kept: list[str] = []
    inside = False
    for line in lines:
        if _HEADER.match(line) and _is_header(line):
            inside = bool(_ZONE.match(line))
        if not inside:
            kept.append(line)
    return kept


def _is_header(line: str) -> bool:
    """Return whether a line that begins with a bracket is a header, not a row of a list of several lines."""
    return bool(re.match(r"[ \t]*\[\[?[ \t]*[A-Za-z_\"'][^\]]*\]\]?[ \t]*(#.*)?$", line))


def _without_fence(lines: Sequence[str]) -> list[str]:
    kept: list[str] = []
    in_safety, depth = False, 0
    for line in lines:
        if depth > 0:
            depth += _opened(line)
            continue
        if _HEADER.match(line) and _is_header(line):
            in_safety = bool(_SAFETY.match(line))
        if in_safety and _FENCE.match(line):
            depth = _opened(line)
            continue
        kept.append(line)
    return kept


def _opened(line: str) -> int:
    """Return how many brackets a line leaves open."""
    bare = line.partition("#")[0]
    return bare.count("[") - bare.count("]")


def _with_fence(lines: Sequence[str], fence_m: Sequence[Sequence[float]]) -> list[str]:
    fence = "fence_m = [" + ", ".join(f"[{x!r}, {y!r}]" for x, y in fence_m) + "]"
    for number, line in enumerate(lines):
        if _SAFETY.match(line):
            return [*lines[: number + 1], fence, *lines[number + 1 :]]
    return [*lines, "", "[safety]", fence]
