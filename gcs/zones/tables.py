"""Fence, zones and rally points as TOML, alone or written into a mission's text, whose comments and order stay."""

import re
from collections.abc import Iterator, Sequence

from estimation.input_file import toml_content
from estimation.vectors import Pair
from gcs.errors import InputError, KeyFault
from gcs.zones.layout import GroundArea, Layout

_SAFETY = re.compile(r"^[ \t]*\[[ \t]*safety[ \t]*\][ \t]*(#.*)?$", re.MULTILINE)
_FENCE = re.compile(r"^[ \t]*fence_m[ \t]*=[ \t]*", re.MULTILINE)
_HEADER = re.compile(r"^[ \t]*\[", re.MULTILINE)
_PIECE = re.compile(r"#[^\n]*|[\[\]]")


def tables_text(layout: Layout) -> str:
    """Return the tables of a mission's TOML, empty if there are none."""
    fence = [] if layout.fence is None else [f"[safety]\n{_fence_line(layout.fence)}\n"]
    return "\n".join([*fence, *_arrays(layout)])


def with_layout(text: str, layout: Layout) -> str:
    """Return a mission's text with another fence, if there is one, and with further zones and rally points.

    Raises InputError if the mission's tables are written in a way that cannot be changed line by line.
    """
    changed = text if layout.fence is None else _with_fence(text, layout.fence)
    added = "\n".join(_arrays(layout))
    changed = f"{changed.rstrip()}\n\n{added}" if added else changed
    _require_only(text, changed, layout)
    return changed


def _arrays(layout: Layout) -> Iterator[str]:
    for zone in layout.zones:
        shape = (
            f"center_m = {_place(zone.corners_m[0])}\nradius_m = {zone.radius_m!r}\n"
            if zone.radius_m
            else f"polygon_m = {_places(zone.corners_m)}\n"
        )
        heights = (("floor_m", zone.floor_m), ("ceiling_m", zone.ceiling_m))
        limits = "".join(f"{key} = {value!r}\n" for key, value in heights if value is not None)
        yield f'[[safety.no_fly]]\nname = "{zone.name}"\n{shape}{limits}'
    for point in layout.points:
        yield f'[[safety.rally]]\nname = "{point.name}"\nplace_m = {_place(point.place_m)}\n'


def _with_fence(text: str, fence: GroundArea) -> str:
    section = _SAFETY.search(text)
    if section is None:
        return f"{text.rstrip()}\n\n[safety]\n{_fence_line(fence)}\n"
    header = _HEADER.search(text, section.end())
    end = len(text) if header is None else header.start()
    key = _FENCE.search(text, section.end(), end)
    if key is None:
        return f"{text[: section.end()]}\n{_fence_line(fence)}{text[section.end() :]}"
    return f"{text[: key.start()]}{_fence_line(fence)}{text[_array_end(text, key.end()) :]}"


def _array_end(text: str, start: int) -> int:
    """Return where the array that begins at a place of a text ends: numbers, brackets and comments."""
    depth = 0
    for piece in _PIECE.finditer(text, start):
        depth += {"[": 1, "]": -1}.get(piece[0], 0)
        if depth == 0 and piece[0] == "]":
            return piece.end()
    return len(text)


def _require_only(before: str, after: str, layout: Layout) -> None:
    """Raise InputError unless the changed text says what the former said, with the layout."""
    try:
        wanted, found = toml_content(before), toml_content(after)
    except ValueError as error:
        reason = f"its [safety] cannot be extended line by line ({error}); next: add the printed tables by hand"
        raise InputError([KeyFault("--mission", reason)]) from error
    added = toml_content("\n".join(_arrays(layout))).get("safety", {})
    safety = {**wanted.get("safety", {})}
    if layout.fence is not None:
        safety["fence_m"] = [list(corner) for corner in layout.fence.corners_m]
    safety |= {key: [*safety.get(key, []), *tables] for key, tables in added.items()}
    if found != {**wanted, **({"safety": safety} if safety else {})}:
        reason = "its [safety] cannot be changed line by line; next: add the printed tables by hand"
        raise InputError([KeyFault("--mission", reason)])


def _fence_line(fence: GroundArea) -> str:
    return f"fence_m = {_places(fence.corners_m)}"


def _places(corners: Sequence[Pair]) -> str:
    return f"[{', '.join(map(_place, corners))}]"


def _place(corner: Pair) -> str:
    return f"[{corner[0]!r}, {corner[1]!r}]"
