"""An MBTiles file that is filled tile by tile, and continued after a break."""

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from gcs.errors import InputError
from gcs.station.tile_area import TileArea, TilePlace
from gcs.station.tile_server import TileServerError
from gcs.station.tiles import TileImage

ReadTile = Callable[[TilePlace], TileImage | None]
_COMMIT_EVERY = 50
_SOURCE = "cordon_source"
_TABLES = (
    "CREATE TABLE metadata (name TEXT PRIMARY KEY, value TEXT)",
    "CREATE TABLE tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB, "
    "PRIMARY KEY (zoom_level, tile_column, tile_row))",
)


class TileStore:
    """A file of tiles of one source; made if it is not there. A context, which leaves no file without a tile.

    Raises InputError for a file of another source, and where none can be written.
    """

    def __init__(self, path: Path, source: str) -> None:
        self._path = path
        self._unsaved = 0
        is_new = not path.exists()
        try:
            self._database = sqlite3.connect(path)
            if is_new:
                for table in _TABLES:
                    self._database.execute(table)
                self._database.execute("INSERT INTO metadata VALUES (?, ?)", (_SOURCE, source))
                self._database.commit()
            found = self._database.execute("SELECT value FROM metadata WHERE name = ?", (_SOURCE,)).fetchone()
        except sqlite3.Error as error:
            raise InputError([f"--out: {path}: {error}; name another file"]) from error
        if found != (source,):
            self._database.close()
            was = f"of {found[0]}" if found else "of another program"
            raise InputError([f"--out: {path} exists already, with tiles {was}; name another file"])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._database.commit()
        is_empty = self._database.execute("SELECT 1 FROM tiles LIMIT 1").fetchone() is None
        self._database.close()
        if is_empty:
            self._path.unlink(missing_ok=True)

    def has(self, place: TilePlace) -> bool:
        """Return whether a tile is stored."""
        query = "SELECT 1 FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        return self._database.execute(query, _key(place)).fetchone() is not None

    def put(self, place: TilePlace, image: TileImage) -> None:
        """Store a tile; raises InputError if it cannot be written."""
        try:
            self._database.execute("INSERT OR REPLACE INTO tiles VALUES (?, ?, ?, ?)", (*_key(place), image.data))
            self._unsaved += 1
            if self._unsaved >= _COMMIT_EVERY:
                self._database.commit()
                self._unsaved = 0
        except sqlite3.Error as error:
            raise InputError([f"--out: {self._path}: {error}"]) from error

    def describe(self, area: TileArea, image: TileImage, name: str, attribution: str) -> None:
        """Write the metadata of MBTiles 1.3: name, format, bounds, levels, and whose tiles they are."""
        values = {
            "name": name,
            "format": {"image/png": "png", "image/jpeg": "jpg"}.get(image.media_type, "webp"),
            "type": "baselayer",
            "bounds": f"{area.west_deg:.6f},{area.south_deg:.6f},{area.east_deg:.6f},{area.north_deg:.6f}",
            "minzoom": f"{area.level_min}",
            "maxzoom": f"{area.level_max}",
            "attribution": attribution,
        }
        self._database.executemany("INSERT OR REPLACE INTO metadata VALUES (?, ?)", values.items())


@dataclass(frozen=True, slots=True)
class Filled:
    """How many tiles of an area are stored, how many the source does not have, and what ended the filling, if so."""

    stored: int
    missing: int
    problem: str = ""


def fill(
    store: TileStore, area: TileArea, read: ReadTile, label: Callable[[TileImage], None], show: Callable[[int], None]
) -> Filled:
    """Store all tiles of an area that are not stored yet.

    `label` gets the first image, `show` the number of tiles that are done. Raises InputError as the source does.
    """
    stored, missing, is_labelled = 0, 0, False
    for number, place in enumerate(area.tiles(), start=1):
        if not store.has(place):
            try:
                image = read(place)
            except TileServerError as error:
                return Filled(stored, missing, f"{error}")
            if image is not None:
                if not is_labelled:
                    label(image)
                    is_labelled = True
                store.put(place, image)
            missing += image is None
            stored += image is not None
        else:
            stored += 1
        show(number)
    return Filled(stored, missing)


def _key(place: TilePlace) -> TilePlace:
    """Return the key of a tile in MBTiles, whose rows count from the south."""
    level, column, row = place
    return level, column, 2**level - 1 - row
