"""Map tiles: what is read from folders and MBTiles files, what is refused, and who is served what."""

import asyncio
import sqlite3
from collections.abc import AsyncIterator, Callable
from contextlib import closing
from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.mission.file import load_mission
from gcs.station.picture import TilesPicture
from gcs.station.tiles import MapTiles, TileImage, opened_tiles
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


@pytest.fixture(params=["folder", "mbtiles"])
def tiles(request: pytest.FixtureRequest, tmp_path: Path) -> MapTiles:
    if request.param == "folder":
        return opened_tiles(tile_folder(tmp_path / "tiles", {(2, 1, 0): RED, (2, 3, 3): BLUE}), ZURICH)
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
            status, headers, body = await served.get(path)
            assert (status, headers["Content-Type"], body) == (200, "image/png", image)
            assert headers["Cache-Control"] == "no-cache", "another set may be served at this address tomorrow"
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert "img-src 'self'" in headers["Content-Security-Policy"]
    with subtests.test("the page has their levels and source"):
        async with served.connected() as page:
            shown = (await received(page, "mission"))["tiles"]
        assert shown == {"level_min": 2, "level_max": 2, "source": tiles.picture.source}
    with subtests.test("strangers"):
        assert (await served.get("/tiles/2/1/0", Cookie=""))[0] == 403
        assert (await served.get("/tiles/2/1/0", Host="evil.example"))[0] == 403
        assert (await served.get("/tiles/2/1/0", Origin="https://evil.example"))[0] == 403
        assert (await served.get("/tiles/2/1/0", "POST"))[0] == 405
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
            assert (await served.get(f"/tiles/{place}"))[0] == 404, place
        assert (await served.get("/tiles/99/99999999/99999999"))[0] == 404
    with subtests.test("nothing outside of the tiles"):
        for place in ("../../../secret", "2/1/../../../secret", "%2e%2e/%2e%2e/%2e%2e/secret", "2/1/%2e%2e%2fsecret"):
            assert (await served.get(f"/tiles/{place}"))[0] == 404, place
            assert (await served.get(f"/tiles/{place}.png"))[0] == 404, place


@pytest.mark.wire
async def test_many_tiles_at_once(served: Station) -> None:
    answers = await asyncio.gather(*(served.get("/tiles/2/1/0") for _ in range(40)))
    assert {(status, body) for status, _, body in answers} == {(200, RED)}
