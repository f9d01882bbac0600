"""Map tiles: what is read from folders and MBTiles files, what is refused, and who is served what."""

import asyncio
import os
import re
import sqlite3
from collections.abc import AsyncIterator, Callable
from contextlib import closing
from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.mission.file import load_mission
from gcs.station.picture import TilesPicture
from gcs.station.tiles import TILE_MAX_BYTES, MapTiles, TileImage, opened_tiles
from tests.support.page.map_tiles import corner_deg, mbtiles, png, tile_folder
from tests.support.page.station import Station, received, station

ZURICH = (47.397742, 8.545594)
HOME = (14, 8580, 5736)
"""The tile of level 14 in which this place lies: between its corners by the inverse map."""
RED, BLUE = png((255, 0, 0)), png((0, 0, 255))
JPEG, WEBP = b"\xff\xd8\xff\xe0 a photograph", b"RIFF\x10\0\0\0WEBPVP8 "
VECTOR = b"\x1f\x8b\x08 a vector tile"


def test_a_folder_has_its_levels_and_images_by_their_kind(tmp_path: Path) -> None:
    folder = tile_folder(tmp_path / "tiles", {HOME: RED, (16, 5, 6): BLUE})
    tile_folder(folder, {(15, 1, 2): JPEG}, ".jpg")
    tile_folder(folder, {(15, 1, 3): WEBP}, ".webp")
    tile_folder(folder, {(15, 1, 4): b"<html>not here"}, ".png")
    (folder / "20").mkdir()
    (folder / "openlayers.html").write_text("a viewer")
    tiles = opened_tiles(folder, ZURICH)
    assert tiles.picture == TilesPicture(14, 16)
    assert tiles.tile(*HOME) == TileImage(RED, "image/png")
    assert tiles.tile(15, 1, 2) == TileImage(JPEG, "image/jpeg")
    assert tiles.tile(15, 1, 3) == TileImage(WEBP, "image/webp")
    for missing in ((14, 8580, 5738), (15, 1, 4), (20, 0, 0), (3, 0, 0)):
        assert tiles.tile(*missing) is None, missing


def test_mbtiles_count_rows_from_the_south(tmp_path: Path) -> None:
    """Of the two rows of level 1, number 1 of an MBTiles file is the northern one, number 0 on the page."""
    path = mbtiles(tmp_path / "#1 50%.mbtiles", [(1, 0, 1, RED), (1, 0, 0, BLUE), (3, 2, 0, JPEG)], format="png")
    tiles = opened_tiles(path, ZURICH)
    assert tiles.picture == TilesPicture(1, 3)
    assert tiles.tile(1, 0, 0) == TileImage(RED, "image/png")
    assert tiles.tile(1, 0, 1) == TileImage(BLUE, "image/png")
    assert tiles.tile(3, 2, 7) == TileImage(JPEG, "image/jpeg")
    assert tiles.tile(1, 1, 0) is tiles.tile(2, 0, 0) is tiles.tile(1, 0, 99_999_999) is None


@pytest.mark.parametrize(
    ("metadata", "shown"),
    [
        ({"name": "field", "attribution": "© A. Surveyor"}, "© A. Surveyor"),
        ({"attribution": '<a href="https://x.example">&copy; Streets</a>\n contributors'}, "© Streets contributors"),
        ({"name": "field"}, "field"),
        ({}, ""),
    ],
)
def test_whose_tiles_they_are_is_plain_text(tmp_path: Path, metadata: dict[str, str], shown: str) -> None:
    path = mbtiles(tmp_path / "t.mbtiles", [(0, 0, 0, RED)], **metadata)
    assert opened_tiles(path, ZURICH).picture.source == shown


def test_tiles_that_cannot_be_drawn_are_refused(tmp_path: Path, subtests: pytest.Subtests) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mbtiles").write_text("no tiles " * 200)
    (tmp_path / "map.pmtiles").write_bytes(b"PMTiles\x03")
    (tmp_path / "nothing.mbtiles").touch()
    mbtiles(tmp_path / "none.mbtiles", [], format="png")
    mbtiles(tmp_path / "vector.mbtiles", [(0, 0, 0, VECTOR)], format="pbf")
    mbtiles(tmp_path / "deep.mbtiles", [(99, 0, 0, RED)], format="png")
    mbtiles(tmp_path / "odd.mbtiles", [("low", 0, 0, RED)], format="png")
    tile_folder(tmp_path / "vectors", {(0, 0, 0): VECTOR}, ".pbf")
    for name, words in (
        ("nowhere", "No such file"),
        ("empty", "no tile Z/X/Y.png"),
        ("vectors", "no tile Z/X/Y.png"),
        ("text.mbtiles", "not an MBTiles file"),
        ("nothing.mbtiles", "not an MBTiles file"),
        ("none.mbtiles", "no tile"),
        ("vector.mbtiles", "'pbf'"),
        ("map.pmtiles", "pmtiles-convert"),
        ("deep.mbtiles", "99"),
        ("odd.mbtiles", "'low'"),
    ):
        with subtests.test(name):
            with pytest.raises(InputError) as refused:
                opened_tiles(tmp_path / name, ZURICH)
            assert name in str(refused.value)
            assert words in str(refused.value)


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
ENDLESS_TILES = f"{ENDLESS} SELECT i % 1 AS zoom_level, i % 2 + 5 AS tile_column, 0 AS tile_row, i AS tile_data FROM n"
LARGE_TILE = "SELECT 0 AS zoom_level, 0 AS tile_column, 0 AS tile_row, zeroblob(900000000) AS tile_data"
COMPUTED = "CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data AS (zeroblob(900000000)))"
NO_TILES = "CREATE TABLE tiles (zoom_level); DROP TABLE metadata"
IMAGE = "CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data)"


@pytest.mark.parametrize(
    ("script", "words"),
    [
        pytest.param(f"CREATE VIEW tiles AS {ENDLESS_TILES}", "sqlite3", id="endless"),
        pytest.param(f"CREATE VIEW tiles AS {LARGE_TILE}", "sqlite3", id="large"),
        pytest.param(f"{COMPUTED}; INSERT INTO tiles VALUES (0, 0, 0)", "computed", id="computed"),
        pytest.param(
            f"{NO_TILES}; CREATE VIEW metadata AS {ENDLESS} SELECT i AS name, i AS value FROM n", "metadata", id="names"
        ),
        pytest.param(f"{NO_TILES}; CREATE VIRTUAL TABLE metadata USING fts5(name, value)", "metadata", id="virtual"),
        pytest.param(f"{IMAGE}; INSERT INTO tiles VALUES (0, 0, 0, zeroblob(90000000))", "too big", id="large image"),
    ],
)
def test_a_file_that_would_take_for_ever_or_all_memory_is_refused(tmp_path: Path, script: str, words: str) -> None:
    path = tmp_path / "t.mbtiles"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(f"CREATE TABLE metadata (name, value); {script}")
    with pytest.raises(InputError) as refused:
        opened_tiles(path, ZURICH)
    assert words in str(refused.value)


def test_the_view_of_a_file_is_made_a_table_as_the_message_says(tmp_path: Path) -> None:
    path = tmp_path / "t.mbtiles"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE TABLE metadata (name, value); CREATE TABLE images (id, tile_data);"
            "CREATE TABLE map (zoom_level, tile_column, tile_row, id); INSERT INTO map VALUES (0, 0, 0, 1);"
            "CREATE VIEW tiles AS SELECT zoom_level, tile_column, tile_row, tile_data FROM map JOIN images USING (id)"
        )
        database.execute("INSERT INTO images VALUES (1, ?)", (RED,))
        database.commit()
    with pytest.raises(InputError) as refused:
        opened_tiles(path, ZURICH)
    (script,) = re.findall("'([^']*)'", str(refused.value))
    with closing(sqlite3.connect(path)) as database:
        database.executescript(script)
    assert opened_tiles(path, ZURICH).tile(0, 0, 0) == TileImage(RED, "image/png")


def test_a_query_of_a_file_that_has_become_endless_ends(tmp_path: Path) -> None:
    path = mbtiles(tmp_path / "t.mbtiles", [(0, 0, 0, RED)])
    opened = opened_tiles(path, ZURICH)
    with closing(sqlite3.connect(path)) as database:
        database.executescript(f"DROP TABLE tiles; CREATE VIEW tiles AS {ENDLESS_TILES}")
    assert opened.tile(0, 0, 0) is None


def test_pipes_and_long_files_among_the_tiles_are_no_tiles(tmp_path: Path) -> None:
    folder = tile_folder(tmp_path / "tiles", {HOME: RED, (15, 1, 2): RED + bytes(TILE_MAX_BYTES)})
    os.mkfifo(folder / "15" / "1" / "3.png")
    (folder / "15" / "1" / "4.png").symlink_to("/dev/zero")
    opened = opened_tiles(folder, ZURICH)
    assert opened.tile(*HOME) == TileImage(RED, "image/png")
    for row in (2, 3, 4):
        assert opened.tile(15, 1, row) is None
    for beside in ("-journal", "-wal"):
        path = mbtiles(tmp_path / f"with{beside}.mbtiles", [(0, 0, 0, RED)])
        os.mkfifo(f"{path}{beside}")
        assert opened_tiles(path, ZURICH).tile(0, 0, 0) == TileImage(RED, "image/png")
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(InputError, match="regular file"):
        opened_tiles(path, ZURICH)


def test_a_mission_that_lies_nowhere_has_no_tiles(tmp_path: Path) -> None:
    folder = tile_folder(tmp_path / "tiles", {HOME: RED})
    with pytest.raises(InputError, match=r"\[frame\] is local"):
        opened_tiles(folder, None)


def test_tiles_that_lie_elsewhere_are_recognised(tmp_path: Path) -> None:
    level, column, row = HOME
    (north, west), (south, east) = corner_deg(*HOME), corner_deg(level, column + 1, row + 1)
    assert south < ZURICH[0] < north
    assert west < ZURICH[1] < east
    flipped = 2**level - 1 - row
    for name, tiles, covers in (
        ("here", {HOME: RED}, True),
        ("at the deepest level alone", {(10, 0, 0): RED, HOME: RED}, True),
        ("a column further", {(level, column + 1, row): RED}, False),
        ("rows from the south", {(level, column, flipped): RED}, False),
    ):
        assert opened_tiles(tile_folder(tmp_path / name, tiles), ZURICH).covers_origin is covers, name
    assert opened_tiles(mbtiles(tmp_path / "t.mbtiles", [(level, column, flipped, RED)]), ZURICH).covers_origin
    assert not opened_tiles(tmp_path / "here", (89.0, 180.0)).covers_origin, "beyond the map"


def test_a_file_that_is_damaged_or_gone_meanwhile_has_no_tile(tmp_path: Path) -> None:
    path = mbtiles(tmp_path / "t.mbtiles", [(0, 0, 0, RED)])
    tiles = opened_tiles(path, ZURICH)
    with closing(sqlite3.connect(path)) as database:
        database.execute("DROP TABLE tiles")
    assert tiles.tile(0, 0, 0) is None
    path.unlink()
    assert tiles.tile(0, 0, 0) is None


@pytest.fixture
def tiles(tmp_path: Path) -> MapTiles:
    return opened_tiles(mbtiles(tmp_path / "t.mbtiles", [(2, 1, 3, RED), (2, 3, 0, BLUE)], name="two"), ZURICH)


@pytest.fixture
async def served(mission_file: Callable[..., str], tmp_path: Path, tiles: MapTiles) -> AsyncIterator[Station]:
    (tmp_path / "page").mkdir()
    (tmp_path / "secret.png").write_bytes(RED)
    async with station(load_mission(mission_file("case2")), tmp_path / "page", tiles) as running:
        yield running


@pytest.mark.wire
async def test_tiles_are_served_as_the_rest_of_the_page_is(
    served: Station, tiles: MapTiles, subtests: pytest.Subtests
) -> None:
    with subtests.test("tiles"):
        for path, image in (("/tiles/2/1/0", RED), ("/tiles/2/3/3", BLUE)):
            status, headers, body = await served.get_as_page(path)
            assert (status, headers["Content-Type"], body) == (200, "image/png", image)
            assert headers["Cache-Control"] == "no-cache", "another set may be served at this address tomorrow"
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert "img-src 'self'" in headers["Content-Security-Policy"]
    with subtests.test("many at once"):
        answers = await asyncio.gather(*(served.get_as_page("/tiles/2/1/0") for _ in range(40)))
        assert {(status, body) for status, _, body in answers} == {(200, RED)}
    with subtests.test("the page has their levels and source"):
        async with served.connected() as page:
            shown = (await received(page, "mission"))["tiles"]
        assert shown == {"level_min": 2, "level_max": 2, "source": tiles.picture.source}
    with subtests.test("strangers"):
        assert (await served.get("/tiles/2/1/0"))[0] == 404
        assert (await served.get("/tiles/2/1/0", Authorization="Bearer "))[0] == 404
        assert (await served.get_as_page("/tiles/2/1/0", Host="evil.example"))[0] == 403
        assert (await served.get_as_page("/tiles/2/1/0", Origin="https://evil.example"))[0] == 403
        assert (await served.get_as_page("/tiles/2/1/0", "POST"))[0] == 405
    with subtests.test("what is missing, and what is no tile"):
        for place in (
            "2/0/0",
            "9/0/0",
            "2/1/0.png",
            "2/1",
            "2/1/0/0",
            "2/1/-1",
            "2/1/%E0%A5%A6",
            f"2/1/{'9' * 5000}",
            "",
        ):
            assert (await served.get_as_page(f"/tiles/{place}"))[0] == 404, place
        assert (await served.get_as_page("/tiles/99/99999999/99999999"))[0] == 404
    with subtests.test("nothing outside of the tiles"):
        for place in ("../../../secret", "2/1/../../../secret", "%2e%2e/%2e%2e/%2e%2e/secret", "2/1/%2e%2e%2fsecret"):
            assert (await served.get_as_page(f"/tiles/{place}"))[0] == 404, place
            assert (await served.get_as_page(f"/tiles/{place}.png"))[0] == 404, place
