"""The files that maps read: KML 2.2 with Google's tracks, GPX 1.1 and GeoJSON (RFC 7946)."""

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from itertools import chain, pairwise
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from estimation.frames import Geodetic
from gcs.report.maps.mapped_flight import MapLine, MappedFlight, MapPoint, MapTrack, MapZone, timestamp

KML: Final = "http://www.opengis.net/kml/2.2"
KML_TRACKS: Final = "http://www.google.com/kml/ext/2.2"
GPX: Final = "http://www.topografix.com/GPX/1/1"
_DEGREES = 8
"""Digits behind the point: a millimetre."""
_METRES = 3
_TRACK_PX = "3"
_LINE_PX = "2"


def kml(flight: MappedFlight) -> bytes:
    """Return a flight as KML: tracks with times, rings and tracks at their heights, fences on the ground."""
    root = Element("kml", {"xmlns": KML, "xmlns:gx": KML_TRACKS})
    document = SubElement(root, "Document")
    _text(document, "name", flight.name)
    _text(document, "description", f"flight of {timestamp(flight.began_s)}; heights are above mean sea level")
    for track in flight.tracks:
        _style(document, track.name, track.colour, _TRACK_PX)
    for line in (*flight.rings, *flight.bounds):
        _style(document, line.name, line.colour, _LINE_PX)
    _add_tracks(document, flight.tracks)
    _add_lines(document, "rings", flight.rings, "absolute")
    _add_lines(document, "fences", flight.bounds, "clampToGround")
    _add_points(document, "starts", flight.starts)
    _add_points(document, "events", flight.events)
    return _xml(root)


def gpx(flight: MappedFlight) -> bytes:
    """Return a flight as GPX: starts and events as waypoints, rings and fences as closed routes, and tracks."""
    root = Element("gpx", {"xmlns": GPX, "version": "1.1", "creator": f"cordon {version('cordon-gcs')}"})
    metadata = SubElement(root, "metadata")
    _text(metadata, "name", flight.name)
    _text(metadata, "time", timestamp(flight.began_s))
    for point in (*flight.starts, *flight.events):
        shown = _gpx_point(root, "wpt", point.place, point.unix_s)
        _text(shown, "name", point.name)
        _text(shown, "type", point.kind)
    for line in (*flight.rings, *flight.bounds):
        route = SubElement(root, "rte")
        _text(route, "name", line.name)
        for each in _closed(line):
            _gpx_point(route, "rtept", each, None)
    for track in flight.tracks:
        shown = SubElement(root, "trk")
        _text(shown, "name", track.name)
        _text(shown, "desc", f"by {track.source}")
        segment = SubElement(shown, "trkseg")
        for unix_s, place in track.places:
            _gpx_point(segment, "trkpt", place, unix_s)
    return _xml(root)


def geojson(flight: MappedFlight) -> bytes:
    """Return a flight as GeoJSON: longitude and latitude, and beside them times and heights above mean sea level.

    Fences and no-fly zones have the properties that `gcs.zones.geojson` reads. The third coordinate of RFC 7946 is a
    height above the ellipsoid, which is not known, and is left out.
    """
    features = chain(
        map(_track_feature, flight.tracks),
        map(_ring_feature, flight.rings),
        (_bound_feature("fence", each, {"name": each.name, "inclusion": True}) for each in flight.fences),
        map(_zone_feature, flight.zones),
        map(_point_feature, (*flight.starts, *flight.events)),
    )
    collection = {"type": "FeatureCollection", "features": list(features)}
    return json.dumps(collection, allow_nan=False, ensure_ascii=False).encode()


FORMATS: Mapping[str, Callable[[MappedFlight], bytes]] = {"kml": kml, "gpx": gpx, "geojson": geojson}
"""The formats by their names, which are also those of the options and the suffixes of the files."""


def _closed(line: MapLine) -> tuple[Geodetic, ...]:
    return (*line.places, line.places[0])


def _counter_clockwise(line: MapLine) -> tuple[Geodetic, ...]:
    """Return the places of a closed line counter-clockwise, as RFC 7946 requires of an outer ring."""
    closed = _closed(line)
    doubled_area = sum(
        (one.longitude_deg - closed[0].longitude_deg) * (other.latitude_deg - one.latitude_deg)
        - (other.longitude_deg - one.longitude_deg) * (one.latitude_deg - closed[0].latitude_deg)
        for one, other in pairwise(closed)
    )
    return closed if doubled_area > 0.0 else closed[::-1]


def _lon_lat_height(place: Geodetic) -> tuple[str, str, str]:
    longitude_deg, latitude_deg = (f"{each:.{_DEGREES}f}" for each in (place.longitude_deg, place.latitude_deg))
    return longitude_deg, latitude_deg, f"{place.altitude_m:.{_METRES}f}"


def _text(parent: Element, tag: str, text: str) -> None:
    SubElement(parent, tag).text = text


def _xml(root: Element) -> bytes:
    ElementTree.indent(root, " ")
    return bytes(ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True))


def _style(document: Element, name: str, colour: str, width_px: str) -> None:
    """Add the style of a line; KML has its colours as opacity, blue, green, red."""
    line = SubElement(SubElement(document, "Style", {"id": _style_id(name)}), "LineStyle")
    red, green, blue = colour[1:3], colour[3:5], colour[5:7]
    _text(line, "color", f"ff{blue}{green}{red}".lower())
    _text(line, "width", width_px)


def _style_id(name: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name)


def _add_tracks(document: Element, tracks: Sequence[MapTrack]) -> None:
    folder = _folder(document, "tracks")
    for track in tracks:
        shown = SubElement(_placemark(folder, track.name, f"by {track.source}", track.name), "gx:Track")
        _text(shown, "altitudeMode", "absolute")
        for each in track.places:
            _text(shown, "when", timestamp(each.unix_s))
        for each in track.places:
            _text(shown, "gx:coord", " ".join(_lon_lat_height(each.place)))


def _add_lines(document: Element, name: str, lines: Sequence[MapLine], altitude_mode: str) -> None:
    folder = _folder(document, name)
    for line in lines:
        shown = SubElement(_placemark(folder, line.name, "", line.name), "LineString")
        _text(shown, "tessellate", "1")
        _text(shown, "altitudeMode", altitude_mode)
        _text(shown, "coordinates", " ".join(",".join(_lon_lat_height(each)) for each in _closed(line)))


def _add_points(document: Element, name: str, points: Sequence[MapPoint]) -> None:
    folder = _folder(document, name)
    for point in points:
        placemark = _placemark(folder, point.name, point.kind)
        if point.unix_s is not None:
            _text(SubElement(placemark, "TimeStamp"), "when", timestamp(point.unix_s))
        shown = SubElement(placemark, "Point")
        _text(shown, "altitudeMode", "absolute")
        _text(shown, "coordinates", ",".join(_lon_lat_height(point.place)))


def _folder(document: Element, name: str) -> Element:
    folder = SubElement(document, "Folder")
    _text(folder, "name", name)
    return folder


def _placemark(folder: Element, name: str, description: str, style: str = "") -> Element:
    placemark = SubElement(folder, "Placemark")
    _text(placemark, "name", name)
    if description:
        _text(placemark, "description", description)
    if style:
        _text(placemark, "styleUrl", f"#{_style_id(style)}")
    return placemark


def _gpx_point(parent: Element, tag: str, place: Geodetic, unix_s: float | None) -> Element:
    longitude_deg, latitude_deg, height_m = _lon_lat_height(place)
    point = SubElement(parent, tag, {"lat": latitude_deg, "lon": longitude_deg})
    _text(point, "ele", height_m)
    if unix_s is not None:
        _text(point, "time", timestamp(unix_s))
    return point


def _lon_lat(place: Geodetic) -> list[float]:
    return [round(place.longitude_deg, _DEGREES), round(place.latitude_deg, _DEGREES)]


def _height(place: Geodetic) -> float:
    return round(place.altitude_m, _METRES)


def _feature(kind: str, geometry: Mapping[str, object], properties: Mapping[str, object]) -> dict[str, object]:
    return {"type": "Feature", "geometry": geometry, "properties": {"kind": kind, **properties}}


def _track_feature(track: MapTrack) -> dict[str, object]:
    geometry = {"type": "LineString", "coordinates": [_lon_lat(each.place) for each in track.places]}
    properties = {
        "name": track.name,
        "vehicle": track.vehicle,
        "source": track.source,
        "coordTimes": [timestamp(each.unix_s) for each in track.places],
        "height_amsl_m": [_height(each.place) for each in track.places],
    }
    return _feature("target" if track.vehicle is None else "vehicle", geometry, properties)


def _ring_feature(ring: MapLine) -> dict[str, object]:
    places = _closed(ring)
    geometry = {"type": "LineString", "coordinates": list(map(_lon_lat, places))}
    return _feature("ring", geometry, {"name": ring.name, "height_amsl_m": list(map(_height, places))})


def _zone_feature(zone: MapZone) -> dict[str, object]:
    heights = {"floor": zone.floor_m, "ceiling": zone.ceiling_m}
    limits = {key: height_m for key, height_m in heights.items() if height_m is not None}
    return _bound_feature("no_fly", zone.outline, {"name": zone.name, "inclusion": False, **limits})


def _bound_feature(kind: str, outline: MapLine, properties: Mapping[str, object]) -> dict[str, object]:
    places = _counter_clockwise(outline)
    geometry = {"type": "Polygon", "coordinates": [list(map(_lon_lat, places))]}
    return _feature(kind, geometry, {**properties, "height_amsl_m": list(map(_height, places))})


def _point_feature(point: MapPoint) -> dict[str, object]:
    geometry = {"type": "Point", "coordinates": _lon_lat(point.place)}
    properties = {"name": point.name, "vehicle": point.vehicle, "height_amsl_m": _height(point.place)}
    if point.unix_s is None:
        return _feature(point.kind, geometry, properties)
    return _feature(
        "event", geometry, {**properties, "event": point.kind, "text": point.text, "time": timestamp(point.unix_s)}
    )
