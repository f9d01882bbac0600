"""GeoJSON (RFC 7946): polygons are areas, points are rally points, points with a `radius` are circles.

The properties that are read: `name`, `inclusion` (true for an area to stay in), `radius`, `floor` and `ceiling` [m],
and `kind`: points of another one than `rally` are left out, such as the starts and events of an exported flight.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Final

from gcs.errors import InputError, KeyFault
from gcs.zones.drawing import (
    HEIGHT_MAX_M,
    NAME_MAX,
    RADIUS_MAX_M,
    Degrees,
    DrawnArea,
    DrawnField,
    DrawnPoint,
    collected,
    degrees_of,
    ring_of,
)
from gcs.zones.json_node import JsonNode, each_of

GEOMETRIES: Final = (
    "Point",
    "MultiPoint",
    "LineString",
    "MultiLineString",
    "Polygon",
    "MultiPolygon",
    "GeometryCollection",
)
KINDS: Final = ("FeatureCollection", "Feature", *GEOMETRIES)
_WGS_84 = ("CRS84", "4326")
_RALLY = "rally"
_POSITIONS_LEAST = 4
"""Of a ring: three corners, and the first once more."""


def geojson_drawing(root: JsonNode) -> DrawnField:
    """Return what a GeoJSON text holds; raises InputError."""
    _require_wgs84(root)
    others = Counter[str]()
    shapes = [each for each in _shapes(root, others) if each.is_of_a_mission(others)]
    read = collected(lambda shape: shape.read(), shapes)
    areas = tuple(each for each in read if isinstance(each, DrawnArea))
    points = tuple(each for each in read if isinstance(each, DrawnPoint))
    left_out = tuple(f"{count} {kind}{'s' * (count != 1)}" for kind, count in others.items())
    return DrawnField(root.file, "GeoJSON", areas, points, left_out)


class _Shape:
    """A polygon's rings or a point's position, with the properties of its feature."""

    def __init__(self, properties: JsonNode | None, coordinates: JsonNode, *, is_polygon: bool) -> None:
        self._properties = properties
        self._coordinates = coordinates
        self._is_polygon = is_polygon

    def is_of_a_mission(self, others: Counter[str]) -> bool:
        """Return whether this is an area or a rally point; else it is counted among the others."""
        kind = self._property("kind")
        if self._is_polygon or kind is None or kind.value == _RALLY or self._property("radius") is not None:
            return True
        others["Point"] += 1
        return False

    def read(self) -> DrawnArea | DrawnPoint:
        place, name = self._coordinates.place, self._name()
        if not self._is_polygon and self._property("radius") is None:
            position = self._coordinates.items(2)
            height_m = position[2].number("a height in metres", -HEIGHT_MAX_M, HEIGHT_MAX_M) if position[2:] else None
            return DrawnPoint(place, _position(self._coordinates), name, height_m)
        inclusion = self._property("inclusion")
        rings = collected(_ring, self._coordinates.items(1)) if self._is_polygon else ()
        floor_m, ceiling_m = self._height("floor"), self._height("ceiling")
        return DrawnArea(
            place=place,
            corners_deg=rings[0] if rings else (_position(self._coordinates),),
            name=name,
            stay_inside=inclusion is not None and inclusion.flag(),
            radius_m=0.0 if rings else self._radius_m(),
            floor_m=floor_m,
            ceiling_m=ceiling_m,
            holes=rings[1:],
        )

    def _property(self, name: str) -> JsonNode | None:
        return None if self._properties is None else self._properties.get(name)

    def _name(self) -> str:
        name = self._property("name")
        return "" if name is None else str(name.value)[:NAME_MAX]

    def _radius_m(self) -> float:
        radius = self._property("radius")
        assert radius is not None
        return radius.number("a radius in metres", 0.01, RADIUS_MAX_M)

    def _height(self, name: str) -> float | None:
        height = self._property(name)
        return None if height is None else height.number("a height in metres", -HEIGHT_MAX_M, HEIGHT_MAX_M)


def _require_wgs84(root: JsonNode) -> None:
    """Refuse coordinates that are not latitude and longitude: before RFC 7946 the key `crs` named others."""
    crs = root.get("crs")
    if crs is not None and not any(known in str(crs.value) for known in _WGS_84):
        raise crs.fault(f"positions have to be longitude and latitude, WGS 84 (given: {str(crs.value)[:80]})")


def _shapes(root: JsonNode, others: Counter[str]) -> Iterator[_Shape]:
    match root["type"].value:
        case "FeatureCollection":
            for feature in root["features"].items():
                yield from _feature_shapes(feature, others)
        case "Feature":
            yield from _feature_shapes(root, others)
        case _:
            yield from _geometry_shapes(None, root, others)


def _feature_shapes(feature: JsonNode, others: Counter[str]) -> Iterator[_Shape]:
    geometry = feature.get("geometry")
    if geometry is not None:  # RFC 7946: a feature without a place has null
        yield from _geometry_shapes(feature.get("properties"), geometry, others)


def _geometry_shapes(properties: JsonNode | None, geometry: JsonNode, others: Counter[str]) -> Iterator[_Shape]:
    match kind := geometry["type"].value:
        case "Polygon" | "Point":
            yield _Shape(properties, geometry["coordinates"], is_polygon=kind == "Polygon")
        case "MultiPolygon" | "MultiPoint":
            for each in geometry["coordinates"].items():
                yield _Shape(properties, each, is_polygon=kind == "MultiPolygon")
        case "GeometryCollection":
            for each in each_of(geometry.get("geometries")):
                yield from _geometry_shapes(properties, each, others)
        case "LineString" | "MultiLineString":
            others[kind] += 1
        case _:
            raise geometry["type"].fault(f"it is no kind of GeoJSON (kinds: {', '.join(GEOMETRIES)})")


def _ring(ring: JsonNode) -> tuple[Degrees, ...]:
    corners = collected(_position, ring.items(_POSITIONS_LEAST))
    if corners[0] != corners[-1]:
        raise InputError([KeyFault(ring.place, "the last position of a ring repeats the first (RFC 7946, 3.1.6)")])
    return ring_of(ring.place, corners)


def _position(position: JsonNode) -> Degrees:
    longitude, latitude, *_ = position.items(2)
    return degrees_of(position.place, latitude.value, longitude.value)
