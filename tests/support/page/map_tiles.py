"""Synthetic map tiles: images of one colour, as a folder or an MBTiles file, and the positions of their corners."""

import math
import sqlite3
import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path

from pyproj import Transformer

Colour = tuple[int, int, int]
TILE_PX = 256


def png(colour: Colour, size_px: int = TILE_PX) -> bytes:
    """Return a PNG image of one colour."""
    rows = (b"\0" + bytes(colour) * size_px) * size_px
    header = struct.pack(">IIBBBBB", size_px, size_px, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def tile_folder(folder: Path, tiles: Mapping[tuple[int, int, int], bytes], suffix: str = ".png") -> Path:
    """Write images, by level, column and row from the north, as a folder Z/X/Y."""
    for (level, column, row), image in tiles.items():
        file = folder / str(level) / str(column) / f"{row}{suffix}"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(image)
    return folder


def mbtiles(path: Path, rows: Iterable[tuple[object, int, int, bytes]], **metadata: str) -> Path:
    """Write an MBTiles file: level, column, row from the south and data of each tile."""
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE metadata (name text, value text)")
        database.execute(
            "CREATE TABLE tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)"
        )
        database.executemany("INSERT INTO metadata VALUES (?, ?)", metadata.items())
        database.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)
        database.commit()
    return path


def corner_deg(level: int, column: int, row: int) -> tuple[float, float]:
    """Return latitude and longitude of a tile's north-western corner: the inverse of the spherical Mercator map."""
    latitude_rad = math.atan(math.sinh(math.pi * (1.0 - 2.0 * row / 2**level)))
    return math.degrees(latitude_rad), 360.0 * column / 2**level - 180.0


def east_north_m(place_deg: tuple[float, float], origin_deg: tuple[float, float]) -> tuple[float, float]:
    """Return the metres east and north of an origin, on the plane that touches the ellipsoid there."""
    (latitude, longitude), (latitude_0, longitude_0) = place_deg, origin_deg
    plane = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={longitude_0!r} +lat_0={latitude_0!r} +h_0=0"
    )
    east_m, north_m, _ = plane.transform(longitude, latitude, 0.0)
    return float(east_m), float(north_m)
