"""KML 2.2: the polygons of its placemarks, also of several geometries, are areas.

https://docs.ogc.org/is/12-007r2/12-007r2.html. A document type, by which a text could grow to any length or name other
files, is refused before expat reads it. `Data` or `SimpleData` of the names `floor` and `ceiling` are heights [m].
"""

from collections import Counter
from collections.abc import Iterator
from xml.parsers import expat

from gcs.errors import InputError, KeyFault
from gcs.zones.drawing import (
    HEIGHT_MAX_M,
    NAME_MAX,
    Degrees,
    DrawnArea,
    DrawnField,
    collected,
    degrees_of,
    ranged,
    ring_of,
)

_DEPTH_MAX = 100
_ELEMENTS_MAX = 200_000
_OTHER_GEOMETRIES = ("Point", "LineString", "LinearRing", "Model", "Track", "MultiTrack")
_OTHER_FEATURES = ("NetworkLink", "GroundOverlay", "ScreenOverlay", "PhotoOverlay", "Tour")


class KmlElement:
    """An element: its local name, its line, its attribute `name`, its content and the elements in it."""

    def __init__(self, tag: str, line: int, name: str) -> None:
        self.tag = tag
        self.line = line
        self.name = name
        self.content = ""
        self.inner: list[KmlElement] = []

    def all(self, *tags: str) -> "Iterator[KmlElement]":
        """Yield the elements of these names at any depth below, in the order of the file."""
        for each in self.inner:
            if each.tag in tags:
                yield each
            yield from each.all(*tags)

    def child(self, tag: str) -> "KmlElement | None":
        """Return the first element of a name right in this one."""
        return next((each for each in self.inner if each.tag == tag), None)


class _Reader:
    """Builds the elements of a file; raises InputError for what is no XML, or not safe to read."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._root = KmlElement("", 0, "")
        self._open = [self._root]
        self._count = 0
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = lambda _tag: self._open.pop()
        self._parser.CharacterDataHandler = self._characters
        self._parser.StartDoctypeDeclHandler = self._doctype

    def read(self, content: bytes) -> KmlElement:
        try:
            self._parser.Parse(content, True)
        except expat.ExpatError as error:
            reason = f"it is not XML: {expat.ErrorString(error.code)} in line {error.lineno}"
            raise InputError([KeyFault(self._file, reason, error.lineno)]) from error
        except (ValueError, LookupError) as error:  # an unknown encoding
            raise InputError([KeyFault(self._file, f"it is not XML: {error}")]) from error
        return self._root

    def _fault(self, reason: str) -> InputError:
        line = self._parser.CurrentLineNumber
        return InputError([KeyFault(f"{self._file}: line {line}", reason, line)])

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if len(self._open) > _DEPTH_MAX or self._count > _ELEMENTS_MAX:
            raise self._fault(f"more than {_DEPTH_MAX} elements in each other, or {_ELEMENTS_MAX} in all")
        found = KmlElement(tag.rpartition(":")[2], self._parser.CurrentLineNumber, attributes.get("name", ""))
        self._open[-1].inner.append(found)
        self._open.append(found)

    def _characters(self, text: str) -> None:
        self._open[-1].content += text

    def _doctype(self, *_declared: object) -> None:
        raise self._fault("a document type (<!DOCTYPE) is not read: its entities may grow to any length; take it out")


def kml_drawing(file: str, content: bytes) -> DrawnField:
    """Return what a KML text holds; raises InputError."""
    root = _Reader(file).read(content)
    if root.child("kml") is None:
        tag = root.inner[0].tag if root.inner else ""
        raise InputError([KeyFault(file, f"it is XML, but not KML: its first element is {tag[:NAME_MAX]!r}")])
    placed = [(mark, polygon) for mark in root.all("Placemark") for polygon in mark.all("Polygon")]
    areas = collected(lambda each: _area(file, *each), placed)
    others = Counter(each.tag for mark in root.all("Placemark") for each in _other_geometries(mark))
    others.update(each.tag for each in root.all(*_OTHER_FEATURES))
    return DrawnField(
        file, "KML", areas, left_out=tuple(f"{count} {tag}{'s' * (count != 1)}" for tag, count in others.items())
    )


def _other_geometries(mark: KmlElement) -> Iterator[KmlElement]:
    for each in mark.inner:
        if each.tag == "MultiGeometry":
            yield from _other_geometries(each)
        elif each.tag in _OTHER_GEOMETRIES:
            yield each


def _area(file: str, mark: KmlElement, polygon: KmlElement) -> DrawnArea:
    named = mark.child("name")
    name = "" if named is None else " ".join(named.content.split())[:NAME_MAX]
    place = f"{file}: line {polygon.line}, {name!r}" if name else f"{file}: line {polygon.line}"
    outer = polygon.child("outerBoundaryIs")
    if outer is None:
        raise InputError([KeyFault(place, "a polygon has an outerBoundaryIs", polygon.line)])
    inner = [each for each in polygon.inner if each.tag == "innerBoundaryIs"]
    outline, *holes = collected(lambda boundary: _ring(file, boundary), [outer, *inner])
    return DrawnArea(
        place=place,
        corners_deg=outline,
        name=name,
        floor_m=_height(place, mark, "floor"),
        ceiling_m=_height(place, mark, "ceiling"),
        holes=tuple(holes),
    )


def _ring(file: str, boundary: KmlElement) -> tuple[Degrees, ...]:
    """Return the corners of a boundary: longitude,latitude[,altitude] between white space."""
    coordinates = next(boundary.all("coordinates"), None)
    place = f"{file}: line {boundary.line if coordinates is None else coordinates.line}"
    corners = () if coordinates is None else tuple(coordinates.content.split())
    return ring_of(place, collected(lambda corner: _corner(place, corner), corners))


def _corner(place: str, text: str) -> Degrees:
    parts = text.split(",")
    if len(parts) not in (2, 3):
        raise InputError([KeyFault(place, f"a corner is longitude,latitude[,altitude] (given: {text[:NAME_MAX]!r})")])
    return degrees_of(place, _number(parts[1]), _number(parts[0]))


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _height(place: str, mark: KmlElement, name: str) -> float | None:
    data = next((each for each in mark.all("Data", "SimpleData") if each.name == name), None)
    if data is None:
        return None
    value = data.child("value") or data
    return ranged(place, f"{name} in metres", _number(value.content.strip()), -HEIGHT_MAX_M, HEIGHT_MAX_M)
