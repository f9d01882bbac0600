"""Map tiles of an area: which they are, from a file, from a server that is asked politely, and what is refused."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.mission.file import load_mission
from gcs.station.tile_area import TileArea, box_area, mission_area
from gcs.station.tile_server import TileServer, TileServerError
from gcs.station.tiles import opened_tiles
from tests.conftest import RunHere
from tests.support.page.map_tiles import corner_deg, mbtiles, png, tile_folder
from tests.support.wording import facts_missing

BOX = "47.3962,8.5442,47.3992,8.5492"
FIELD = TileArea(47.3962, 8.5442, 47.3992, 8.5492, 14, 17)


def test_an_area_has_the_tiles_that_touch_it() -> None:
    """By the inverse of the map, all tiles about the area are either listed or beside it."""
    listed = set(FIELD.tiles())
    for level in range(14, 18):
        near = {tile for tile in listed if tile[0] == level}
        columns, rows = {column for _, column, _ in near}, {row for _, _, row in near}
        for column in range(min(columns) - 2, max(columns) + 3):
            for row in range(min(rows) - 2, max(rows) + 3):
                (north, west), (south, east) = corner_deg(level, column, row), corner_deg(level, column + 1, row + 1)
                touches = west < 8.5492 and east > 8.5442 and south < 47.3992 and north > 47.3962
                assert ((level, column, row) in listed) is touches
    assert FIELD.count == len(listed)
    world = TileArea(-85.05, -180.0, 85.05, 180.0, 0, 3)
    assert len(set(world.tiles())) == world.count == 1 + 4 + 16 + 64


def test_the_area_of_a_mission_holds_all_that_it_flies() -> None:
    """The target of case 2 is at x = 35 m east at first, the ring has 10 m; 150 m are left around."""
    mission = load_mission("case2", {"safety.rally": [{"name": "far", "place_m": [-500.0, 300.0]}]})
    area = mission_area(mission, (14, 16))
    frame = mission.mission_frame()
    for x, y in ((-640.0, 440.0), (190.0, -150.0)):
        place = frame.geodetic_from_mission((x, y, 0.0))
        assert area.south_deg < place.latitude_deg < area.north_deg
        assert area.west_deg < place.longitude_deg < area.east_deg
    x, y, _ = frame.mission_from_geodetic(frame.geodetic_from_mission((0.0, 0.0, 0.0)))
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-6)


@dataclass
class MapServer:
    """A server of tiles: what it was asked, and how it answers a request by its number."""

    status: Callable[[int, str], int] = lambda _number, _path: 200
    body: bytes = field(default_factory=lambda: png((9, 9, 9), 8))
    asked: list[tuple[float, str, str]] = field(default_factory=list)
    location: str = ""

    @contextmanager
    def running(self) -> Iterator[str]:
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                server.asked.append((time.monotonic(), self.path, self.headers["User-Agent"]))
                status = server.status(len(server.asked), self.path)
                self.send_response(status)
                if server.location:
                    self.send_header("Location", server.location)
                self.send_header("Retry-After", "0")
                body = server.body + self.path.encode() if status == 200 else b""
                self.send_header("Content-Length", f"{len(body)}")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None: ...

        http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        thread = threading.Thread(target=http.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{http.server_port}/{{z}}/{{x}}/{{y}}.png"
        finally:
            http.shutdown()
            http.server_close()


def test_a_download_is_polite_continues_after_a_break_and_is_drawn(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    last = max(FIELD.tiles())
    server = MapServer()
    # The fourth request meets a busy server once; from the eighth on it is down; a tile is not there.
    server.status = lambda number, path: (
        503 if number == 4 or 8 <= number <= 11 else 404 if path == _path(last) else 200
    )
    with server.running() as address:
        command = ("tiles", BOX, "--from", address, "--out", "f.mbtiles", "--zoom", "14:17", "--rate", "20")
        code, out, err = run_here(*command, "--json")
        assert (code, out) == (2, "")
        assert facts_missing(err, "21 tiles, about 0.4 MB", "127.0.0.1", "--yes") == [], err
        assert server.asked == []
        monkeypatch.setattr("gcs.station.tile_server._FIRST_WAIT_S", 0.01)
        code, out, err = run_here(*command, "--yes", "--json", "--attribution", "© A. Surveyor")
        found = json.loads(out)
        assert (code, found["tiles"], found["stored"]) == (1, 21, 6)
        assert facts_missing(err, "503", "again continues") == [], err
        assert len(server.asked) == 11
        code, out, _ = run_here(*command, "--yes", "--json", "--attribution", "© A. Surveyor")
    found = json.loads(out)
    assert (code, found["stored"], found["missing"], found["problem"]) == (0, 20, 1, "")
    assert sorted({path for _, path, _ in server.asked}) == sorted(map(_path, FIELD.tiles()))
    assert len(server.asked) == 11 + 15, "what is stored is not asked for again"
    assert {agent.split("/")[0] for _, _, agent in server.asked} == {"cordon"}
    times = [at_s for at_s, _, _ in server.asked]
    assert (times[10] - times[0]) > 10 / 20.0 - 0.02
    tiles = opened_tiles(Path("f.mbtiles"), FIELD.centre_deg)
    assert (tiles.picture.level_min, tiles.picture.level_max, tiles.picture.source) == (14, 17, "© A. Surveyor")
    for place in FIELD.tiles():
        image = tiles.tile(*place)
        assert (image is None) is (place == last)
        assert image is None or image.data == server.body + _path(place).encode()


def _path(place: tuple[int, int, int]) -> str:
    level, column, row = place
    return f"/{level}/{column}/{row}.png"


def test_an_area_is_cut_out_of_a_file(tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    inside, outside = list(FIELD.tiles()), [(14, 5, 6), (18, 140000, 90000)]
    images = {place: png((place[2] % 256, place[1] % 256, place[0]), 8) for place in (*inside, *outside)}
    rows = [(level, column, 2**level - 1 - row, data) for (level, column, row), data in images.items()]
    mbtiles(Path("all.mbtiles"), rows, name="all", attribution="© B. Owner")
    tile_folder(Path("folder"), images)
    for source, name in (("all.mbtiles", "one.mbtiles"), ("folder", "two.mbtiles")):
        code, _, _ = run_here("tiles", BOX, "--from", source, "--out", name, "--zoom", "14:17")
        assert code == 0
        cut = opened_tiles(Path(name), FIELD.centre_deg)
        assert {place for place in images if cut.tile(*place) is not None} == set(inside)
        assert all((tile := cut.tile(*place)) and tile.data == images[place] for place in inside)
    assert opened_tiles(Path("one.mbtiles"), FIELD.centre_deg).picture.source == "© B. Owner"


REFUSED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("{box} --from https://tile.openstreetmap.org/{{z}}/{{x}}/{{y}}.png", ("tile.openstreetmap.org", "policy", "file")),
    ("{box} --from https://a.tile.OpenStreetMap.org/{{z}}/{{x}}/{{y}}.png", ("openstreetmap.org", "policy")),
    ("{box} --from https://a.tile.openstreetmap.org./{{z}}/{{x}}/{{y}}.png", ("openstreetmap.org", "policy")),
    ("{box} --from https://tile.%6Fpenstreetmap.org/{{z}}/{{x}}/{{y}}.png", ("openstreetmap.org", "policy")),
    ("{box} --from https://tile.\uff4fpenstreetmap.org/{{z}}/{{x}}/{{y}}.png", ("openstreetmap.org", "policy")),
    ("{box} --from https://tile.osm.org/{{z}}/{{x}}/{{y}}.png", ("osm.org", "policy")),
    ("{box} --from https://tiles..example/{{z}}/{{x}}/{{y}}.png", ("--from", "tiles..example")),
    ("{box} --from https://mt1.google.com/vt/x={{x}}&y={{y}}&z={{z}}", ("google.com", "offline")),
    ("{box} --from https://tiles.example/{{z}}/{{x}}.png", ("--from", "{y}")),
    ("{box} --from ftp://tiles.example/{{z}}/{{x}}/{{y}}.png", ("--from", "ftp://")),
    ("{box} --from nowhere.mbtiles", ("nowhere.mbtiles", "No such file")),
    ("{box} --from other.mbtiles", ("--out", "exists already")),
    ("47.4,8.5,47.3,8.6 --from other.mbtiles", ("AREA", "47.4,8.5,47.3,8.6", "southern")),
    ("47.3,8.5,nan,8.6 --from other.mbtiles", ("AREA", "nan")),
    ("47.3,181,47.4,190 --from other.mbtiles", ("AREA", "longitudes")),
    ("47.3,8.5,47.4 --from other.mbtiles", ("AREA", "SOUTH,WEST,NORTH,EAST")),
    ("nomission --from other.mbtiles", ("nomission", "bundled")),
    ("{box} --from other.mbtiles --zoom 18:14", ("--zoom", "18:14")),
    ("{box} --from other.mbtiles --zoom 14:25", ("--zoom", "14:25")),
    ("46,7,48,9 --from other.mbtiles --zoom 14:18", ("--zoom", "more than 100000")),
)


def test_what_cannot_be_fetched_is_refused(
    tmp_path: Path, run_here: RunHere, subtests: pytest.Subtests, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mbtiles(Path("other.mbtiles"), [(14, 1, 1, png((1, 2, 3), 8))], name="other")
    mbtiles(Path("f.mbtiles"), [(14, 1, 1, png((1, 2, 3), 8))], name="mine")
    before = Path("f.mbtiles").read_bytes()
    for arguments, words in REFUSED:
        with subtests.test(arguments):
            given = arguments.format(box=BOX).split()
            code, out, err = run_here("tiles", *given, "--out", "f.mbtiles", "--yes")
            assert (code, out) == (2, "")
            assert facts_missing(err, *words) == [], err
    assert Path("f.mbtiles").read_bytes() == before


@pytest.mark.parametrize(
    ("server", "error", "words"),
    [
        (MapServer(lambda *_: 403), InputError, ("403",)),
        (MapServer(body=b"<html>pay first"), InputError, ("no PNG",)),
        (MapServer(lambda *_: 302, location="http://localhost:9/1.png"), InputError, ("302",)),
        (MapServer(lambda *_: 503), TileServerError, ("503",)),
    ],
)
def test_a_server_that_refuses_ends_the_download(
    server: MapServer, error: type[Exception], words: tuple[str, ...]
) -> None:
    waits = list[float]()
    with server.running() as address, pytest.raises(error) as caught:
        TileServer(address, 20.0, waits.append).tile((1, 0, 0))
    assert facts_missing(str(caught.value), *words) == []
    assert len(server.asked) == (4 if error is TileServerError else 1)


def test_rows_may_count_from_the_south() -> None:
    server = MapServer()
    with server.running() as address:
        TileServer(address.replace("{y}", "{-y}"), 20.0).tile((3, 2, 1))
    assert server.asked[0][1] == "/3/2/6.png"
    assert box_area("-90,-180,90,180", (0, 0)).count == 1
