"""Map tiles under the scene of the operator's page: images in a folder Z/X/Y, or in an MBTiles file.

Both cut the web Mercator map: level z has 2^z columns, counted from 180° west, and 2^z rows, counted from the north. In
an MBTiles file the rows are counted from the south.
"""

import os
import re
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from html import unescape
from itertools import count
from math import asinh, floor, pi, radians, tan
from pathlib import Path
from stat import S_ISREG

from gcs.console.vehicle_view import Pair
from gcs.errors import InputError
from gcs.station.picture import TilesPicture

LEVEL_MAX = 24
TILE_MAX_BYTES = 4_000_000
"""Of one image: those of 1024 x 1024 pixels take less."""
QUERY_STEPS_MAX = 20_000_000
"""Steps of SQLite's machine, about a second: enough for a million tiles without an index."""
_LIMITED_EVERY_STEPS = 10_000
_METADATA_MAX = 100
_SOURCE_CHARACTERS_MAX = 1000
_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
_ROOT = "SELECT rootpage FROM sqlite_master WHERE type IN ('table', 'view') AND lower(name) = ?"
_COMPUTED = "SELECT count(*) FROM pragma_table_xinfo(?) WHERE hidden > 0"
_ENDS = "SELECT zoom_level, CAST(tile_data AS BLOB) FROM tiles ORDER BY zoom_level {} LIMIT 1"
_ONE = "SELECT CAST(tile_data AS BLOB) FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
_MAKE_TABLE = (
    "CREATE TABLE t AS SELECT * FROM tiles; DROP VIEW tiles; ALTER TABLE t RENAME TO tiles; "
    "CREATE UNIQUE INDEX place ON tiles (zoom_level, tile_column, tile_row)"
)


@dataclass(frozen=True, slots=True)
class TileImage:
    """The image of a tile, and its media type."""

    data: bytes
    media_type: str


TileReader = Callable[[int, int, int], TileImage | None]


@dataclass(frozen=True, slots=True)
class MapTiles:
    """Tiles of a folder or a file, for a mission whose origin has this latitude and longitude."""

    picture: TilesPicture
    reader: TileReader
    origin_deg: Pair

    def tile(self, level: int, column: int, row: int) -> TileImage | None:
        """Return the image at a level, a column and a row from the north; None where there is none."""
        is_level = self.picture.level_min <= level <= self.picture.level_max
        return self.reader(level, column, row) if is_level else None

    @property
    def covers_origin(self) -> bool:
        """Whether a tile of any level lies at the mission's origin."""
        levels = range(self.picture.level_min, self.picture.level_max + 1)
        return any(self.tile(level, *tile_at(level, *self.origin_deg)) is not None for level in levels)


def opened_tiles(path: Path, origin_deg: Pair | None) -> MapTiles:
    """Return the tiles at a path, for a mission with this origin; raises InputError if they cannot be drawn."""
    if origin_deg is None:
        raise InputError([f"map tiles {path}: they need an origin, and the mission's [frame] is local"])
    try:
        if path.exists() and not (path.is_dir() or path.is_file()):
            raise InputError([f"map tiles {path}: neither a folder nor a regular file"])
        picture, reader = _folder(path) if path.is_dir() else _mbtiles(path)
    except OSError as error:
        raise InputError([f"map tiles {path}: {error.strerror or error}"]) from error
    except sqlite3.Error as error:
        raise InputError([f"map tiles {path}: it is not an MBTiles file ({error})"]) from error
    return MapTiles(picture, reader, origin_deg)


def _folder(folder: Path) -> tuple[TilesPicture, TileReader]:
    levels = [level for level in range(LEVEL_MAX + 1) if _holds_tile(folder / str(level))]
    if not levels:
        raise InputError([f"map tiles {folder}: the folder holds no tile Z/X/Y.png, .jpg or .webp"])
    return TilesPicture(min(levels), max(levels)), partial(_from_folder, folder)


def _holds_tile(level: Path) -> bool:
    return any(each.suffix in _SUFFIXES and each.stem.isdecimal() and each.is_file() for each in level.glob("*/*"))


def _from_folder(folder: Path, level: int, column: int, row: int) -> TileImage | None:
    for suffix in _SUFFIXES:
        path = folder / str(level) / str(column) / f"{row}{suffix}"
        with suppress(OSError), open(path, "rb", opener=_without_waiting) as file:
            if (
                S_ISREG(os.fstat(file.fileno()).st_mode)
                and len(data := file.read(TILE_MAX_BYTES + 1)) <= TILE_MAX_BYTES
            ):
                return image_of(data)
    return None


def _without_waiting(path: str, flags: int) -> int:
    """Open a file at once: a pipe that nobody writes to would be opened when somebody does."""
    return os.open(path, flags | os.O_NONBLOCK)


def _mbtiles(path: Path) -> tuple[TilesPicture, TileReader]:
    with path.open("rb") as file:
        if file.read(7) == b"PMTiles":
            converted = path.with_suffix(".mbtiles").name
            raise InputError([f"map tiles {path}: a PMTiles file; convert it: `pmtiles-convert {path} {converted}`"])
    with closing(_connection(path)) as database:
        for table in ("metadata", "tiles"):
            _require_stored(path, database, table)
        rows = database.execute("SELECT name, value FROM metadata").fetchmany(_METADATA_MAX)
        metadata = {name: str(value) for name, value in rows}
        ends = [database.execute(_ENDS.format(order)).fetchone() for order in ("ASC", "DESC")]
    if None in ends:
        raise InputError([f"map tiles {path}: the file holds no tile"])
    (level_min, first), (level_max, _) = ends
    for level in (level_min, level_max):
        if not (isinstance(level, int) and 0 <= level <= LEVEL_MAX):
            raise InputError([f"map tiles {path}: zoom level {level!r} is not one of 0 to {LEVEL_MAX}"])
    if image_of(first) is None:
        kind = metadata.get("format", "unknown")[:_SOURCE_CHARACTERS_MAX]
        raise InputError([f"map tiles {path}: its tiles, of format {kind!r}, are not PNG, JPEG or WebP images"])
    source = _plain(metadata.get("attribution") or metadata.get("name", ""))
    return TilesPicture(level_min, level_max, source), partial(_from_mbtiles, path)


def _require_stored(path: Path, database: sqlite3.Connection, table: str) -> None:
    """Raise InputError for a table that is computed: a query of it may take for ever, also within one step."""
    found = database.execute(_ROOT, (table,)).fetchone()
    if found is None:
        raise InputError([f"map tiles {path}: it is not an MBTiles file (no table {table})"])
    # Views and virtual tables have no page of their own in the file.
    if not found[0] or database.execute(_COMPUTED, (table,)).fetchone() != (0,):
        convert = f"; for a view next: sqlite3 {path} '{_MAKE_TABLE}'" if table == "tiles" else ""
        raise InputError([f"map tiles {path}: {table} is a view or computed, not a stored table{convert}"])


def _from_mbtiles(path: Path, level: int, column: int, row: int) -> TileImage | None:
    with suppress(sqlite3.Error), closing(_connection(path)) as database:
        found = database.execute(_ONE, (level, column, 2**level - 1 - row)).fetchone()
        return None if found is None else image_of(found[0])
    return None


def _connection(path: Path) -> sqlite3.Connection:
    """Open a file read-only, once per tile, as tiles are read in several threads; what it holds costs little to read.

    Queries that take too many steps and values that are too long raise sqlite3.Error. An immutable database has no
    journal beside it, which might be a pipe.
    """
    if not path.is_file():
        raise sqlite3.OperationalError("not a regular file")
    database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, TILE_MAX_BYTES)
    database.execute("PRAGMA trusted_schema = OFF")
    taken = count(1)
    database.set_progress_handler(lambda: next(taken) * _LIMITED_EVERY_STEPS > QUERY_STEPS_MAX, _LIMITED_EVERY_STEPS)
    return database


def image_of(data: bytes | None) -> TileImage | None:
    """Return an image with the media type of its first bytes; None if it is not PNG, JPEG or WebP."""
    if data is None:
        return None
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return TileImage(data, "image/png")
    if data.startswith(b"\xff\xd8\xff"):
        return TileImage(data, "image/jpeg")
    return TileImage(data, "image/webp") if data[:4] + data[8:12] == b"RIFFWEBP" else None


def _plain(text: str) -> str:
    """Return HTML as plain text in one line: attributions are often links."""
    return " ".join(unescape(re.sub(r"<[^>]*>", "", text[:_SOURCE_CHARACTERS_MAX])).split())


def tile_at(level: int, latitude_deg: float, longitude_deg: float) -> tuple[int, int]:
    """Return the column and the row of the tile in which a place lies."""
    column = (longitude_deg + 180.0) / 360.0
    row = (1.0 - asinh(tan(radians(latitude_deg))) / pi) / 2.0
    return floor(column * 2**level), floor(row * 2**level)
