"""Heights of the ground from an SRTM file (.hgt): a degree square of big-endian integers, rows from the north.

The name is that of the south-western corner, such as N47E008.hgt. Heights are metres above the EGM96 geoid, voids are
-32768.
https://dds.cr.usgs.gov/srtm/version2_1/Documentation/SRTM_Topo.pdf
"""

import re
from math import floor, isqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.input_file import read_plain
from gcs.errors import InputError, KeyFault

BYTES_MAX = 2 * 3601 * 3601
_SIDES = (1201, 3601)
_VOID = -32768
_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)


class Elevation:
    """The ground of a degree square, by the file's name and its heights (rows from the north)."""

    def __init__(self, south_deg: int, west_deg: int, heights_m: NDArray[np.float64]) -> None:
        self._south_deg = south_deg
        self._west_deg = west_deg
        self._heights_m = heights_m

    def ground_m(self, latitude_deg: float, longitude_deg: float) -> float | None:
        """Return the height of the ground between four samples, bilinearly; None outside of the square and in voids."""
        steps = len(self._heights_m) - 1
        row = (self._south_deg + 1 - latitude_deg) * steps
        column = (longitude_deg - self._west_deg) * steps
        if not (0.0 <= row <= steps and 0.0 <= column <= steps):
            return None
        north, west = min(floor(row), steps - 1), min(floor(column), steps - 1)
        (a, b), (c, d) = self._heights_m[north : north + 2, west : west + 2].tolist()
        down, right = row - north, column - west
        height_m = (a * (1.0 - right) + b * right) * (1.0 - down) + (c * (1.0 - right) + d * right) * down
        return None if np.isnan(height_m) else float(height_m)


def read_elevation(path: Path) -> Elevation:
    """Return the ground of a file; raises InputError for a file that is none."""
    named = _NAME.fullmatch(path.stem)
    if named is None or path.suffix.lower() != ".hgt":
        reason = f"{path.name!r} is not named for its south-western corner, such as N47E008.hgt"
        raise InputError([KeyFault("safety.elevation", reason)])
    try:
        content = read_plain(path, BYTES_MAX)
    except OSError as error:
        raise InputError([KeyFault("safety.elevation", f"{path}: {error.strerror or error}")]) from error
    side = isqrt(len(content) // 2)
    if side not in _SIDES or 2 * side * side != len(content):
        sizes = " or ".join(f"{2 * each * each}" for each in _SIDES)
        raise InputError([KeyFault("safety.elevation", f"{path}: {len(content)} bytes are no square of {sizes}")])
    heights_m = np.frombuffer(content, ">i2").astype(np.float64).reshape(side, side)
    heights_m[heights_m == _VOID] = np.nan
    south, west = int(named[2]), int(named[4])
    return Elevation(south if named[1] in "Nn" else -south, west if named[3] in "Ee" else -west, heights_m)
