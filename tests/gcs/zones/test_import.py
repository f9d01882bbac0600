"""Fences, zones and rally points of other programs: where they lie in the mission frame, and what is refused."""

import json
import tomllib
from math import dist
from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.mission.file import load_mission, parse_mission
from gcs.zones.layout import Layout, laid_out
from gcs.zones.reading import BYTES_MAX, read_drawing
from gcs.zones.tables import tables_text, with_layout
from tests.conftest import RunHere
from tests.support.drawn_field import (
    FENCE_M,
    HOUSE_M,
    MAST_M,
    MAST_RADIUS_M,
    RALLY_M,
    Place,
    area_m2,
    degrees_of,
    geojson,
    kml,
    plan,
    ring,
)
from tests.support.mission_text import CASE2
from tests.support.wording import facts_missing

FRAME = load_mission("case2").mission_frame()
NEAR_M = 0.1
"""At the origin's height of 488 m, a geodesic of 670 m is 5 cm longer than on the ellipsoid."""


def layout(folder: Path, name: str, text: str, fence: str | None = None) -> Layout:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return laid_out(read_drawing(path), FRAME, fence)


def assert_same(found: tuple[Place, ...], wanted: tuple[Place, ...]) -> None:
    assert len(found) == len(wanted)
    assert max(map(dist, found, wanted)) < NEAR_M


def test_a_field_is_the_same_in_all_formats(tmp_path: Path) -> None:
    """Positions are compared with geodesics, areas with those on the ellipsoid."""
    plan_layout = layout(tmp_path, "f.plan", plan())
    json_layout = layout(tmp_path, "f.geojson", geojson())
    kml_layout = layout(tmp_path, "f.kml", kml(), "Feld-Wald")
    for each in (plan_layout, json_layout, kml_layout):
        assert each.fence is not None
        assert_same(each.fence.corners_m, FENCE_M)
        assert each.fence.area_m2 == pytest.approx(area_m2(FENCE_M), rel=1e-3)
        house = each.zones[0]
        assert_same(house.corners_m, HOUSE_M)
        assert house.area_m2 == pytest.approx(area_m2(HOUSE_M), rel=1e-3)
    for each in (plan_layout, json_layout):
        mast = each.zones[1]
        assert_same(mast.corners_m, (MAST_M,))
        assert mast.radius_m == MAST_RADIUS_M
        (rally,) = each.points
        assert_same((rally.place_m,), (RALLY_M,))
    assert [zone.name for zone in plan_layout.zones] == ["zone-2", "zone-3"]
    assert [(zone.name, zone.floor_m, zone.ceiling_m) for zone in json_layout.zones] == [
        ("house", 2.0, 40.5),
        ("Mast", None, None),
    ]
    assert json_layout.points[0].name == "north-corner"
    assert [(zone.name, zone.ceiling_m) for zone in kml_layout.zones] == [("Hauser", 40.5), ("Feld-Wald-inner-1", None)]
    assert_same(kml_layout.zones[1].corners_m, HOUSE_M)
    assert plan_layout.left_out == ("2 mission items", "heights of rally points: vehicles return in their layers")
    assert json_layout.left_out == ("1 LineString",)
    assert kml_layout.left_out == ("1 Point",)


def test_a_circle_to_stay_in_becomes_a_polygon_within_it(tmp_path: Path) -> None:
    circle = {"circle": {"center": degrees_of((10.0, 20.0)), "radius": 300.0}, "inclusion": True, "version": 1}
    fence = layout(tmp_path, "f.plan", plan(geoFence={"circles": [circle], "version": 2})).fence
    assert fence is not None
    assert all(299.9 < dist(corner, (10.0, 20.0)) < 300.1 for corner in fence.corners_m)
    middles = zip(fence.corners_m, fence.corners_m[1:], strict=False)
    assert all(dist(((x1 + x2) / 2, (y1 + y2) / 2), (10.0, 20.0)) > 299.5 for (x1, y1), (x2, y2) in middles)


def test_zones_far_away_are_told_and_not_taken(tmp_path: Path) -> None:
    """A zone whose corners are all far away may still reach the mission."""
    box = [(-15_000.0, -15_000.0), (-15_000.0, 15_000.0), (15_000.0, 0.0)]
    shapes = {
        "far": ring(((40_000.0, 0.0), (41_000.0, 0.0), (40_000.0, 900.0))),
        "around": ring((*box,)),
        "antipode": [[-171.4, -47.4], [-171.3, -47.4], [-171.4, -47.3], [-171.4, -47.4]],
    }
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": "Polygon", "coordinates": [corners]}}
        for name, corners in shapes.items()
    ]
    taken = layout(tmp_path, "f.json", json.dumps({"type": "FeatureCollection", "features": features}))
    assert [zone.name for zone in taken.zones] == ["around"]
    assert [text.split(",")[0] for text in taken.left_out] == ["'far'", "'antipode'"]


def test_the_mission_keeps_its_text_but_for_fence_and_zones(tmp_path: Path) -> None:
    field = layout(tmp_path, "f.geojson", geojson())
    fence = "fence_m = [[-50, -50], # [a corner]\n  [700.0, -50.0],\n  [700, 60], [-50.0, 60]]  # metres\n"
    assert field.fence is not None
    corners = [list(corner) for corner in field.fence.corners_m]
    for name, text in {
        "no fence": CASE2,
        "fence in lines": CASE2.replace("[safety]\n", f"[safety]  # limits\n{fence}"),
        "no section": "\n".join(line for line in CASE2.split("\n[safety]\n")[0].split("\n"))
        + CASE2.split("\n[safety]\n")[1][CASE2.split("\n[safety]\n")[1].index("\n[") :],
    }.items():
        assert ("[safety]" in text) is (name != "no section"), name
        after = with_layout(text, field)
        assert {line for line in text.splitlines() if line.startswith("#")} <= set(after.splitlines()), name
        before, now = tomllib.loads(text), tomllib.loads(after)
        assert {**now, "safety": {}} == {**before, "safety": {}}, name
        others = {key: value for key, value in now["safety"].items() if key not in ("fence_m", "no_fly", "rally")}
        assert others == {key: value for key, value in before.get("safety", {}).items() if key != "fence_m"}, name
        assert now["safety"]["fence_m"] == corners, name
        mission = parse_mission(after, None)
        (rally,) = mission.safety.rally
        assert rally.name == "north-corner"
        assert_same((rally.place_m,), (RALLY_M,))
        house, mast = mission.safety.no_fly
        assert (house.name, house.floor_m, house.ceiling_m) == ("house", 2.0, 40.5)
        assert_same(house.polygon_m, HOUSE_M)
        assert mast.center_m is not None
        assert_same((mast.center_m,), (MAST_M,))
        assert tomllib.loads(tables_text(field))["safety"] == {
            key: now["safety"][key] for key in ("fence_m", "no_fly", "rally")
        }, name
    with pytest.raises(InputError, match="by hand"):
        with_layout(CASE2.replace("[safety]\n", "[safety]\nno_fly = []\n"), field)


def test_an_exported_plan_is_read_as_the_mission_has_it(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my.toml").write_text(with_layout(CASE2, layout(tmp_path, "f.geojson", geojson())), encoding="utf-8")
    code, _, err = run_here("zones", "export", "my.toml", "--out", "out.plan")
    assert code == 0
    assert facts_missing(err, "no heights: house", "written: out.plan") == [], err
    assert json.loads(Path("out.plan").read_text())["mission"]["plannedHomePosition"] == [47.397742, 8.545594, 488.0]
    again, mission = laid_out(read_drawing(Path("out.plan")), FRAME), load_mission("my.toml")
    assert again.fence is not None
    assert_same(again.fence.corners_m, mission.safety.fence_m)
    house, mast = again.zones
    assert_same(house.corners_m, HOUSE_M)
    assert_same(mast.corners_m, (MAST_M,))
    assert mast.radius_m == MAST_RADIUS_M
    assert (again.points, facts_missing(err, "--vehicle ID")) == ((), [])
    assert run_here("zones", "export", "my.toml", "--out", "1.plan", "--vehicle", "1")[0] == 0
    (spot,) = laid_out(read_drawing(Path("1.plan")), FRAME).points
    assert_same((spot.place_m,), ((RALLY_M[0], RALLY_M[1] + 4.0),))
    code, _, err = run_here("zones", "export", "my.toml", "--out", "out.plan")
    assert (code, "exists" in err) == (2, True)


def box(x: float, y: float) -> tuple[Place, ...]:
    return ((x, y), (x + 8.0, y), (x + 8.0, y + 8.0), (x, y + 8.0))


def features(areas: dict[str, list[tuple[Place, ...]]], points: dict[str, list[Place]]) -> str:
    """Return areas and points by their names as GeoJSON; the area `field` is the fence, with a hole."""
    drawn = [
        feature(name, {"type": "Polygon", "coordinates": [ring(corners), *holes]}, inclusion=name == "field")
        for name, shapes in areas.items()
        for corners in shapes
        for holes in ([ring(box(100.0, 100.0))] if name == "field" else [],)
    ]
    drawn += [
        feature(name, {"type": "Point", "coordinates": degrees_of(place)[::-1]})
        for name, places in points.items()
        for place in places
    ]
    return json.dumps({"type": "FeatureCollection", "features": drawn})


def feature(name: str, geometry: dict[str, object], **properties: object) -> dict[str, object]:
    return {"type": "Feature", "properties": {"name": name, **properties}, "geometry": geometry}


def test_names_are_made_distinct_from_each_other_and_from_those_of_the_mission(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    a, hole = [box(200.0, 60.0), box(220.0, 60.0)], box(200.0, 90.0)
    areas = {"field": [FENCE_M], "a": a, "a-1": [box(240.0, 60.0)], "field-inner-1": [hole]}
    Path("f.json").write_text(features(areas, {"road": [(-30.0, 40.0), (-30.0, -40.0)]}), encoding="utf-8")
    code, _, err = run_here("zones", "import", "f.json", "--mission", "case2", "--out", "1.toml")
    assert code == 0, err
    first = load_mission("1.toml").safety
    assert [each.name for each in first.no_fly] == ["a-2", "a-3", "a-1", "field-inner-1", "field-inner-1-1"]
    assert [each.name for each in first.rally] == ["road-1", "road-2"]
    Path("f.plan").write_text(plan(), encoding="utf-8")
    assert run_here("zones", "import", "f.plan", "--mission", "case2", "--out", "2.toml")[0] == 0
    code, out, err = run_here("zones", "import", "f.plan", "--mission", "2.toml")
    assert code == 0, err
    added = tomllib.loads(out)["safety"]
    assert [each["name"] for each in added["no_fly"]] == ["zone-2-1", "zone-3-1"]
    assert [each["name"] for each in added["rally"]] == ["rally-1-1"]


def test_an_area_around_all_starts_may_be_the_fence(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("f.kml").write_text(kml(), encoding="utf-8")
    code, _, err = run_here("zones", "import", "f.kml", "--mission", "case2", "--out", "my.toml")
    assert code == 2
    assert facts_missing(err, "start_m", "'Feld-Wald'", "--fence Feld-Wald") == [], err
    assert (
        run_here("zones", "import", "f.kml", "--mission", "case2", "--out", "my.toml", "--fence", "Feld-Wald").code == 0
    )


def test_a_mission_without_areas_is_not_exported(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = run_here("zones", "export", "case2", "--out", "out.plan")
    assert (code, facts_missing(err, "case2", "no fence")) == (2, [])
    Path("my.toml").write_text(f'{CASE2}\n[[safety.rally]]\nname = "road"\nplace_m = [-30.0, 40.0]\n')
    code, _, err = run_here("zones", "export", "my.toml", "--out", "out.plan")
    assert (code, facts_missing(err, "--vehicle ID"), Path("out.plan").exists()) == (2, [], False)
    assert run_here("zones", "export", "my.toml", "--out", "out.plan", "--vehicle", "1").code == 0


def crossing() -> dict[str, object]:
    corners = [degrees_of(HOUSE_M[at]) for at in (0, 2, 1, 3)]
    return {"polygons": [{"inclusion": False, "polygon": corners, "version": 1}], "version": 2}


def polygon(corners: object) -> dict[str, object]:
    return {"polygons": [{"inclusion": False, "polygon": corners, "version": 1}], "version": 2}


BOMB = '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><kml>&b;</kml>'
OUTSIDE = '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/passwd">]><kml><Placemark><name>&a;</name></Placemark></kml>'
KML_CORNERS = "<kml><Placemark><name>hill</name><Polygon><outerBoundaryIs><LinearRing>\n<coordinates>{}</coordinates>"
KML_CORNERS += "</LinearRing></outerBoundaryIs></Polygon></Placemark></kml>"
REFUSED: dict[str, tuple[str, tuple[str, ...]]] = {
    "another version of a plan": (plan(version=2), ("f.plan: version", "only version 1", "given: 2")),
    "another version of a fence": (
        plan(geoFence={"polygon": [], "version": 1}),
        ("geoFence.version", "version 2", "1"),
    ),
    "another version of rally points": (plan(rallyPoints={"points": [], "version": 3}), ("rallyPoints.version", "3")),
    "no version": (plan(geoFence={"polygons": []}), ("geoFence", "'version' is missing")),
    "another type": (plan(fileType="Mission"), ("fileType", "'Mission'")),
    "crosses itself": (
        plan(geoFence=crossing()),
        ("geoFence.polygons[0]", "crosses itself", "47.397022, 8.547978", "47.397202"),
    ),
    "crosses itself after a repeated corner": (
        plan(geoFence=polygon([degrees_of(HOUSE_M[at]) for at in (0, 0, 0, 2, 1, 3)])),
        ("corner 0, 47.397022, 8.547978", "corner 4, 47.397202"),
    ),
    "no place on Earth": (
        plan(geoFence=polygon([[47.4, 8.5], [120.5, 8.5], [47.4, 8.6]])),
        ("geoFence.polygons[0].polygon[1]", "latitude", "120.5"),
    ),
    "two corners": (plan(geoFence=polygon([[47.4, 8.5], [47.5, 8.5]])), ("polygons[0].polygon", "3 corners", "2")),
    "a text": (plan(geoFence=polygon([["47.4", 8.5]] * 3)), ("polygon[0]", "latitude", "'47.4'")),
    "no area": (plan(geoFence=polygon([[47.4, 8.5], [47.41, 8.5], [47.42, 8.5]])), ("polygons[0]", "encloses")),
    "all at once": (
        plan(geoFence=polygon([[91, 8.5], [47.4, 181], [47.4, 8.6]])),
        ("polygon[0]", "91", "polygon[1]", "181"),
    ),
    "latitude and longitude exchanged": (
        plan(geoFence=polygon([[8.5, 47.4], [8.5, 47.5], [8.6, 47.4]]), rallyPoints={"points": [], "version": 2}),
        ("f.plan", "20 km", "47.397742, 8.545594", "order"),
    ),
    "reaches across the Earth": (
        plan(geoFence=polygon([[47.4, 8.5], [47.4, 60.0], [48.0, 8.5]])),
        ("polygons[0]", "47.400000, 60.000000", "100 km"),
    ),
    "too many corners": (
        plan(geoFence=polygon([degrees_of((float(x), (x * x) / 500.0)) for x in range(300)])),
        ("polygons[0]", "256", "300"),
    ),
    "nothing in it": (plan(geoFence=None, rallyPoints=None), ("f.plan", "no area and no rally point")),
    "NaN": (plan().replace("15.5", "NaN"), ("f.plan", "NaN is not a number")),
    "beyond numbers": (plan().replace("15.5", "1" + "0" * 400), ("circles[0].circle.radius", "a radius")),
    "an infinite radius": (plan().replace("15.5", "1e999"), ("circles[0].circle.radius", "inf")),
    "thousands of digits": (plan().replace("15.5", "1" * 5000), ("not a QGroundControl plan", "5000 digits")),
    "broken JSON": (plan()[:-40], ("f.plan", "not JSON", "line 1")),
    "nested without end": (
        '{"type": "Feature", "geometry": ' + '{"type": "GeometryCollection", "geometries": [' * 5000,
        ("f.plan",),
    ),
    "empty": (" \n", ("f.plan", "empty")),
    "a list": ("[1]", ("f.plan", "no object")),
    "another JSON": ('{"type": "Topology"}', ("f.plan", "GeoJSON")),
    "an open ring": (
        json.dumps({"type": "Polygon", "coordinates": [ring(HOUSE_M)[:-1]]}),
        ("coordinates[0]", "repeats the first"),
    ),
    "metres of a map": (
        json.dumps({"type": "Point", "coordinates": [1, 2], "crs": {"properties": {"name": "EPSG:2056"}}}),
        ("crs", "EPSG:2056"),
    ),
    "upside down": (
        geojson().replace('"floor": 2', '"floor": 50'),
        ("features[1].geometry.coordinates[0]", "50 m", "40.5 m"),
    ),
    "an entity bomb": (BOMB, ("f.plan: line 1", "DOCTYPE")),
    "another file in XML": (OUTSIDE, ("f.plan: line 1", "DOCTYPE")),
    "another XML": ("<gpx/>", ("f.plan", "not KML", "'gpx'")),
    "broken XML": (kml()[:-20], ("f.plan", "not XML", "line 25")),
    "a word in KML": (KML_CORNERS.format("8.5,47.4 8.5,north 8.6,47.4"), ("line 2", "latitude", "'north'")),
    "a single number in KML": (KML_CORNERS.format("8.5 47.4"), ("line 2", "longitude,latitude", "'8.5'")),
    "elements in each other": ("<kml>" * 5000, ("f.plan", "100 elements")),
    "unpacked": ("PK\x03\x04 a KMZ", ("f.plan", "unzip")),
}


def test_what_cannot_be_read_is_named_with_file_place_and_value(
    tmp_path: Path, run_here: RunHere, subtests: pytest.Subtests, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, (text, words) in REFUSED.items():
        with subtests.test(name):
            Path("f.plan").write_text(text, encoding="utf-8")
            code, out, err = run_here("zones", "import", "f.plan", "--mission", "case2")
            assert (code, out) == (2, "")
            assert facts_missing(err, *words) == [], err
    for wrong, content, words in (
        ("f.plan", b"\xb4\x00\xff", ("not a QGroundControl plan", "no text in UTF-8")),
        ("f.kml", b"hello", ("f.kml: it is not KML",)),
        ("f.txt", b"hello", ("f.txt: it is not JSON",)),
    ):
        with subtests.test(f"{wrong}, other content"):
            Path(wrong).write_bytes(content)
            code, out, err = run_here("zones", "import", wrong)
            assert (code, out, facts_missing(err, *words)) == (2, "", []), err
            assert ("JSON" in err) is (wrong != "f.kml")
    with subtests.test("large"), Path("f.plan").open("wb") as large:
        large.truncate(100_000_000)
        assert run_here("zones", "import", "f.plan") == (2, "", f"f.plan: it is larger than {BYTES_MAX // 1000} kB\n")


def test_the_command_writes_a_mission_and_says_what_it_took(
    tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("f.plan").write_text(plan(), encoding="utf-8")
    code, out, err = run_here("zones", "import", "f.plan", "--mission", "case2", "--out", "my.toml", "--json")
    found = json.loads(out)
    assert (code, found["written"], found["not_taken"]) == (
        0,
        "my.toml",
        ["2 mission items", "heights of rally points: vehicles return in their layers"],
    )
    assert found["fence"]["area_m2"] == pytest.approx(area_m2(FENCE_M), rel=1e-3)
    assert (
        facts_missing(err, "f.plan: QGroundControl plan", "'zone-3': circle of 15.5 m, 755 m²", "2 mission items") == []
    )
    written = load_mission("my.toml")
    assert [list(zone.polygon_m) for zone in written.safety.no_fly] == [
        [tuple(corner) for corner in found["no_fly"][0]["corners_m"]],
        [],
    ]
    for arguments, words in (
        (["--out", "other.toml"], ("--out", "--mission")),
        (["--mission", "case2", "--out", "my.toml"], ("--out", "exists")),
        (["--fence", "field"], ("--fence", "'field'", "'zone-1', 'zone-2', 'zone-3'")),
    ):
        code, out, err = run_here("zones", "import", "f.plan", *arguments)
        assert (code, out) == (2, "")
        assert facts_missing(err, *words) == [], err
    Path("f.plan").write_text(plan().replace('"inclusion": false', '"inclusion": true'), encoding="utf-8")
    code, _, err = run_here("zones", "import", "f.plan")
    assert code == 2
    assert facts_missing(err, "--fence", "'zone-1', 'zone-2', 'zone-3'") == [], err
    code, _, err = run_here("zones", "import", "f.plan", "--fence", "zone-1")
    assert code == 0
    assert facts_missing(err, "not taken: 'zone-2', another area to stay in") == [], err
