"""Flights as KML, GPX and GeoJSON, read back: places by the test's own formula of the ellipsoid."""

import json
from collections.abc import Iterator, Sequence
from datetime import datetime
from itertools import pairwise
from math import cos, dist, hypot, radians, sin, sqrt
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from msgspec import structs

from estimation.frames import Triple
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Truth
from gcs.flightlog.run import mission_of, unix_offset_s
from gcs.report.maps.formats import FORMATS
from gcs.report.maps.mapped_flight import mapped_flight
from gcs.zones.layout import laid_out
from gcs.zones.reading import read_drawing
from tests.conftest import RunHere
from tests.support.flight_logs import engaging, record_simulation, rewrite

BEARING_DEG = 30.0
BEGAN_S = 1.7e9
FENCE_M = ((-30.0, -40.0), (-30.0, 40.0), (100.0, 40.0), (100.0, -40.0))
"""Clockwise seen from above: the mission's y axis is to the left of x."""
CHANGES = (
    (("frame", "x_bearing_deg"), BEARING_DEG),
    (("safety", "fence_m"), [list(each) for each in FENCE_M]),
    (("target", "start_m"), [13.0, -5.0]),  # they engage once they have moved
)
NAMESPACES = {
    "kml": "http://www.opengis.net/kml/2.2",
    "gx": "http://www.google.com/kml/ext/2.2",
    "gpx": "http://www.topografix.com/GPX/1/1",
}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> FlightLog:
    """Return the log of a flight along a bearing of 30 degrees inside a fence, until all are on the ring."""
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    record_simulation(engaging("case2-field", *CHANGES), path, duration_s=30.0)
    return read_log(path)


class Place(NamedTuple):
    """A place as a file states it; its time is None where it has none."""

    lon_deg: float
    lat_deg: float
    height_m: float
    time_s: float | None = None


def ecef_m(lat_deg: float, lon_deg: float, height_m: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return earth-centred coordinates on WGS-84: semi-major axis 6378137 m, flattening 1/298.257223563."""
    lat, lon, flattening = radians(lat_deg), radians(lon_deg), 1.0 / 298.257223563
    e2 = flattening * (2.0 - flattening)
    normal_m = 6378137.0 / sqrt(1.0 - e2 * sin(lat) ** 2)
    across_m = (normal_m + height_m) * cos(lat)
    return np.array([across_m * cos(lon), across_m * sin(lon), (normal_m * (1.0 - e2) + height_m) * sin(lat)])


def mission_m(log: FlightLog, place: Place) -> Triple:
    """Return the mission coordinates of a place: x is 30 degrees clockwise from north, y to its left."""
    origin = mission_of(log).mission_frame().origin
    assert origin is not None
    lat, lon = radians(origin.latitude_deg), radians(origin.longitude_deg)
    away_m = ecef_m(place.lat_deg, place.lon_deg, place.height_m) - ecef_m(
        origin.latitude_deg, origin.longitude_deg, origin.altitude_m
    )
    east = float(away_m @ [-sin(lon), cos(lon), 0.0])
    north = float(away_m @ [-sin(lat) * cos(lon), -sin(lat) * sin(lon), cos(lat)])
    up = float(away_m @ [cos(lat) * cos(lon), cos(lat) * sin(lon), sin(lat)])
    bearing = radians(BEARING_DEG)
    return north * cos(bearing) + east * sin(bearing), north * sin(bearing) - east * cos(bearing), up


def unix_s(text: str) -> float:
    assert text.endswith("Z"), "ISO 8601 in UTC"
    return datetime.fromisoformat(text).timestamp()


class Drawn(NamedTuple):
    """What is read from a file: tracks by name, closed lines by name, starts and events as name and place."""

    tracks: dict[str, list[Place]]
    lines: dict[str, list[Place]]
    starts: list[tuple[str, Place]]
    events: list[tuple[str, Place]]


def read_kml(content: bytes) -> Drawn:
    root = ElementTree.fromstring(content)
    assert root.tag == f"{{{NAMESPACES['kml']}}}kml"
    found = Drawn({}, {}, [], [])
    for placemark in root.iterfind(".//kml:Placemark", NAMESPACES):
        name = placemark.findtext("kml:name", "", NAMESPACES)
        if (track := placemark.find("gx:Track", NAMESPACES)) is not None:
            assert track.findtext("kml:altitudeMode", "", NAMESPACES) == "absolute", "above sea level"
            whens = [unix_s(each.text or "") for each in track.iterfind("kml:when", NAMESPACES)]
            coords = [(each.text or "").split() for each in track.iterfind("gx:coord", NAMESPACES)]
            found.tracks[name] = [
                Place(float(x), float(y), float(z), at_s) for (x, y, z), at_s in zip(coords, whens, strict=True)
            ]
            continue
        text = placemark.findtext(".//kml:coordinates", "", NAMESPACES)
        rows = [list(map(float, each.split(","))) for each in text.split()]
        places = [Place(lon_deg, lat_deg, height_m) for lon_deg, lat_deg, height_m in rows]
        if placemark.find("kml:Point", NAMESPACES) is None:
            found.lines[name] = places
        elif when := placemark.findtext("kml:TimeStamp/kml:when", "", NAMESPACES):
            found.events.append((name, places[0]._replace(time_s=unix_s(when))))
        else:
            found.starts.append((name, places[0]))
    return found


def read_gpx(content: bytes) -> Drawn:
    root = ElementTree.fromstring(content)
    assert root.tag == f"{{{NAMESPACES['gpx']}}}gpx"
    assert root.get("version") == "1.1"
    assert root.get("creator")
    kinds = [each.tag.rpartition("}")[2] for each in root]
    order = ["metadata", "wpt", "rte", "trk"]
    assert kinds == sorted(kinds, key=order.index), "the order of the schema"

    def place(point: ElementTree.Element) -> Place:
        time = point.findtext("gpx:time", "", NAMESPACES)
        height_m = float(point.findtext("gpx:ele", "", NAMESPACES))
        return Place(float(point.get("lon", "")), float(point.get("lat", "")), height_m, unix_s(time) if time else None)

    def named(tag: str, points: str) -> dict[str, list[Place]]:
        return {
            each.findtext("gpx:name", "", NAMESPACES): list(map(place, each.iterfind(points, NAMESPACES)))
            for each in root.iterfind(f"gpx:{tag}", NAMESPACES)
        }

    waypoints = [
        (each.findtext("gpx:name", "", NAMESPACES), place(each)) for each in root.iterfind("gpx:wpt", NAMESPACES)
    ]
    starts = [each for each in waypoints if each[1].time_s is None]
    events = [each for each in waypoints if each[1].time_s is not None]
    return Drawn(named("trk", "gpx:trkseg/gpx:trkpt"), named("rte", "gpx:rtept"), starts, events)


def read_geojson(content: bytes) -> Drawn:
    collection = json.loads(content)
    assert collection["type"] == "FeatureCollection"
    found = Drawn({}, {}, [], [])
    for feature in collection["features"]:
        assert feature["type"] == "Feature"
        geometry, properties = feature["geometry"], feature["properties"]
        kind, coordinates, heights_m = geometry["type"], geometry["coordinates"], properties["height_amsl_m"]
        if kind == "Point":
            time = properties.get("time")
            lon_deg, lat_deg = coordinates
            place = Place(lon_deg, lat_deg, heights_m, unix_s(time) if time else None)
            (found.starts if time is None else found.events).append((properties["name"], place))
            continue
        (shape,) = coordinates if kind == "Polygon" else (coordinates,)
        places = [Place(lon, lat, height_m) for (lon, lat), height_m in zip(shape, heights_m, strict=True)]
        if properties["kind"] in ("vehicle", "target"):
            times = map(unix_s, properties["coordTimes"])
            found.tracks[properties["name"]] = [
                each._replace(time_s=at) for each, at in zip(places, times, strict=True)
            ]
        else:
            found.lines[properties["name"]] = places
        if kind == "Polygon":
            area = sum(one.lon_deg * two.lat_deg - two.lon_deg * one.lat_deg for one, two in pairwise(places))
            assert area > 0.0, "RFC 7946: counter-clockwise"
    return found


READERS = {"kml": read_kml, "gpx": read_gpx, "geojson": read_geojson}


@pytest.fixture(params=READERS)
def drawn(request: pytest.FixtureRequest, log: FlightLog) -> Drawn:
    """Return what is read from the flight's file of a format."""
    return READERS[request.param](FORMATS[request.param](mapped_flight(log, lambda _share: None)))


def truth(log: FlightLog, vehicle_id: int) -> Iterator[tuple[float, Triple]]:
    """Return the Unix times and true positions of a vehicle: the clock of a simulation begins with the run."""
    first_s = min(records[0].time_ns for records in log.vehicles.values()) / 1e9
    for each in log.of_kind(vehicle_id, Truth):
        yield each.time_s - first_s + BEGAN_S, each.position_m


def test_tracks_are_the_true_positions_of_the_record(log: FlightLog, drawn: Drawn) -> None:
    assert set(drawn.tracks) == {"vehicle 1", "vehicle 2", "vehicle 3", "target"}
    for number in (1, 2, 3):
        true_m = {round(at_s, 3): position_m for at_s, position_m in truth(log, number)}
        track = drawn.tracks[f"vehicle {number}"]
        assert len(track) == pytest.approx(30.0 / 0.2, abs=2), "five a second, of 30 s"
        for place in track:
            assert place.time_s is not None
            assert dist(mission_m(log, place), true_m[round(place.time_s, 3)]) < 3e-3
    motion, (begun, *_) = mission_of(log).target.motion, drawn.tracks["target"]
    for place in drawn.tracks["target"]:
        assert place.time_s is not None
        assert begun.time_s is not None
        x, y = motion.position_m(place.time_s - begun.time_s)
        assert mission_m(log, place) == pytest.approx((x, y, 0.0), abs=3e-3)


def test_ring_fence_and_starts_are_where_the_mission_has_them(log: FlightLog, drawn: Drawn) -> None:
    mission = mission_of(log)
    assert set(drawn.lines) == {"ring, radius 10 m", "fence"}
    ring_m = [mission_m(log, each) for each in drawn.lines["ring, radius 10 m"]]
    x, y, _ = mission_m(log, drawn.tracks["target"][-1])
    assert [hypot(each[0] - x, each[1] - y) for each in ring_m] == pytest.approx([10.0] * len(ring_m), abs=0.3)
    assert {round(each[2], 2) for each in ring_m} == {min(each.section.altitude_m for each in mission.vehicles)}
    fence_m = [mission_m(log, each)[:2] for each in drawn.lines["fence"]]
    assert fence_m[0] == fence_m[-1]
    assert sorted((round(x), round(y)) for x, y in fence_m[:-1]) == sorted(FENCE_M)
    starts = [mission_m(log, place) for _, place in drawn.starts]
    for vehicle, start_m in zip(mission.vehicles, starts, strict=True):
        assert start_m == pytest.approx((*vehicle.section.start_m, 0.0), abs=3e-3)


def test_an_exported_fence_and_zone_are_imported_as_the_mission_has_them(tmp_path: Path) -> None:
    """A new mission takes them from the flight; starts and events are no rally points."""
    zone = {"name": "mast", "polygon_m": [[80.0, 30.0], [88.0, 30.0], [88.0, 36.0]], "floor_m": 2.0, "ceiling_m": 40.5}
    changes = (*CHANGES, (("safety", "no_fly"), [zone]))
    record_simulation(engaging("case2-field", *changes), tmp_path / "flight.mcap", duration_s=2.0)
    log = read_log(tmp_path / "flight.mcap")
    (tmp_path / "flight.geojson").write_bytes(FORMATS["geojson"](mapped_flight(log, lambda _share: None)))
    again = laid_out(read_drawing(tmp_path / "flight.geojson"), mission_of(log).mission_frame())
    assert again.fence is not None
    assert sorted(again.fence.corners_m) == [pytest.approx(corner, abs=0.02) for corner in sorted(FENCE_M)]
    (mast,) = again.zones
    assert (mast.name, mast.floor_m, mast.ceiling_m, len(mast.corners_m)) == ("mast", 2.0, 40.5, 3)
    assert mast.area_m2 == pytest.approx(24.0, abs=0.5)
    assert again.points == ()
    assert any("Point" in each for each in again.left_out)


def test_events_are_where_their_vehicles_were(log: FlightLog, drawn: Drawn) -> None:
    engaged = [(name, place) for name, place in drawn.events if "formation -> encircle" in name]
    assert len(engaged) >= 2
    for name, place in engaged:
        assert place.time_s is not None
        away_m = [
            dist(position_m, mission_m(log, place))
            for at_s, position_m in truth(log, int(name[0]))
            if 0.0 <= place.time_s - at_s < 0.25
        ]
        assert min(away_m) < 3e-3


def test_without_truth_tracks_are_those_of_the_autopilots(log: FlightLog, tmp_path: Path) -> None:
    none = log
    for number in (1, 2, 3):
        path = tmp_path / f"{number}.mcap"
        none = rewrite(none, path, number, lambda each: None if each.kind is Truth else each.read(each.kind))
    mapped = mapped_flight(none, lambda _share: None)
    assert {each.source for each in mapped.vehicles} == {"estimate"}
    place = mapped.vehicles[0].places[-1].place
    last_m = mission_m(log, Place(place.longitude_deg, place.latitude_deg, place.altitude_m))
    *_, (_, true_m) = truth(log, 1)
    assert 1e-3 < dist(last_m, true_m) < 3.0, "noise, and no more"


def test_times_of_a_flight_at_another_speed_begin_when_it_began(log: FlightLog) -> None:
    """The wall's clock of a flight at speed 5 is five times Unix time; that of one at speed 1 is Unix time."""
    records = [each._replace(time_ns=each.time_ns + round(BEGAN_S * 1e9)) for each in log.vehicles[1]]
    wall = FlightLog(log.path, [], {1: records})
    first_s = records[0].time_ns / 1e9
    for speed, expected_s in ((1.0, 0.0), (5.0, BEGAN_S - 5.0 * first_s)):
        wall.__dict__["run"] = structs.replace(log.run, speed=speed)
        assert unix_offset_s(wall) == pytest.approx(expected_s, abs=1e-3)


def test_the_command_writes_files_that_only_their_owner_reads(
    log: FlightLog, run_here: RunHere, tmp_path: Path
) -> None:
    for name, read in READERS.items():
        ran = run_here("log", "export", f"--{name}", str(log.path))
        assert ran.code == 0, ran.err
        file = log.path.with_suffix(f".{name}")
        assert len(read(file.read_bytes()).tracks) == 4
        assert file.stat().st_mode & 0o077 == 0
        assert str(file) in ran.err


def test_bad_input_ends_in_2_and_names_what_is_wrong(
    log: FlightLog, run_here: RunHere, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    (tmp_path / "there.kml").write_bytes(b"kept")
    (tmp_path / "none.mcap").write_bytes(b"no log")
    record_simulation(engaging("case2-field", (("frame",), {"local": True})), tmp_path / "local.mcap", duration_s=2.0)
    rows: Sequence[tuple[tuple[str, ...], str]] = (
        ((str(log.path),), "--kml"),
        (("--kml", "--gpx", str(log.path)), "--kml and --gpx"),
        (("--kml", str(log.path), "-o", str(tmp_path / "there.kml")), "there.kml' exists already"),
        (("--gpx", str(log.path), "-o", str(tmp_path / "missing" / "x.gpx")), "--output: no folder"),
        (("--geojson", str(tmp_path / "none.mcap")), "it is not an MCAP file"),
        (("--kml", str(tmp_path / "local.mcap")), "local frame"),
    )
    for words, named in rows:
        with subtests.test(named):
            ran = run_here("log", "export", *words)
            assert ran.code == 2
            assert named in ran.err
    assert (tmp_path / "there.kml").read_bytes() == b"kept"
    assert not (tmp_path / "local.kml").exists()
