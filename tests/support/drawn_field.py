"""One field in the formats that are read, by hand after their specifications: a fence, a house, a mast, a rally point.

Its places are geodesics from the origin of case 2, by distance and azimuth: their geometry is not the mission frame's.
"""

import json
from math import atan2, degrees, hypot

from pyproj import Geod

ORIGIN_DEG = (47.397742, 8.545594)
"""Of case 2, whose x points east and y north."""
EARTH = Geod(ellps="WGS84")
Place = tuple[float, float]

FENCE_M: tuple[Place, ...] = ((-120.0, -190.0), (-120.0, 195.0), (630.0, 200.0), (640.0, -190.0))
HOUSE_M: tuple[Place, ...] = ((180.0, -80.0), (180.0, -60.0), (212.0, -60.0), (212.0, -82.0), (196.0, -71.0))
"""A corner of it cuts into it."""
MAST_M, MAST_RADIUS_M = (140.0, 84.0), 15.5
RALLY_M = (-30.0, 40.0)


def degrees_of(place_m: Place) -> tuple[float, float]:
    """Return the latitude and the longitude of a place."""
    x, y = place_m
    longitude, latitude, _ = EARTH.fwd(ORIGIN_DEG[1], ORIGIN_DEG[0], degrees(atan2(x, y)), hypot(x, y))
    return round(latitude, 9), round(longitude, 9)


def area_m2(corners_m: tuple[Place, ...]) -> float:
    """Return the area of a polygon on the ellipsoid."""
    latitudes, longitudes = zip(*map(degrees_of, corners_m), strict=True)
    area, _ = EARTH.polygon_area_perimeter(longitudes, latitudes)
    return abs(area)


def plan(**changes: object) -> str:
    """Return the field as a plan of QGroundControl, with other values of some keys."""
    circle = {"circle": {"center": degrees_of(MAST_M), "radius": MAST_RADIUS_M}, "inclusion": False, "version": 1}
    polygons = [
        {"inclusion": inside, "polygon": [degrees_of(corner) for corner in corners], "version": 1}
        for inside, corners in ((True, FENCE_M), (False, HOUSE_M))
    ]
    return json.dumps(
        {
            "fileType": "Plan",
            "geoFence": {"circles": [circle], "polygons": polygons, "version": 2},
            "groundStation": "QGroundControl",
            "mission": {
                "items": [{"type": "SimpleItem"}] * 2,
                "plannedHomePosition": [*ORIGIN_DEG, 488.0],
                "version": 2,
            },
            "rallyPoints": {"points": [[*degrees_of(RALLY_M), 20]], "version": 2},
            "version": 1,
            **changes,
        }
    )


def geojson() -> str:
    """Return the field as GeoJSON, with heights of the house."""

    def feature(kind: str, coordinates: object, **properties: object) -> dict[str, object]:
        return {
            "type": "Feature",
            "geometry": {"type": kind, "coordinates": coordinates},
            "properties": properties,
        }

    house = feature("MultiPolygon", [[ring(HOUSE_M)]], name="house", floor=2, ceiling=40.5)
    features = [
        feature("Polygon", [ring(FENCE_M)], name="field", inclusion=True),
        house,
        feature("Point", degrees_of(MAST_M)[::-1], name="Mast", radius=MAST_RADIUS_M),
        feature("Point", degrees_of(RALLY_M)[::-1], name="north corner"),
        feature("LineString", [[8.0, 47.0], [8.1, 47.0]], name="a fence of wire"),
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


def ring(corners_m: tuple[Place, ...]) -> list[list[float]]:
    """Return a closed ring of GeoJSON."""
    positions = [list(degrees_of(corner)[::-1]) for corner in corners_m]
    return [*positions, positions[0]]


KML = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Folder>
<Placemark><name>Feld &amp; Wald</name><Polygon><outerBoundaryIs><LinearRing><coordinates>{fence}</coordinates>
</LinearRing></outerBoundaryIs><innerBoundaryIs><LinearRing><coordinates>{house}</coordinates></LinearRing>
</innerBoundaryIs></Polygon></Placemark>
<Placemark><name>Häuser</name><ExtendedData><Data name="ceiling"><value>40.5</value></Data></ExtendedData>
<MultiGeometry><Polygon><outerBoundaryIs><LinearRing>
<coordinates>
  {house}
</coordinates></LinearRing></outerBoundaryIs></Polygon><Point><coordinates>8.5,47.4,0</coordinates></Point>
</MultiGeometry></Placemark></Folder></Document></kml>
"""


def kml() -> str:
    """Return fence and house as KML, the house also as a hole in the fence."""
    return KML.format(fence=_coordinates(FENCE_M), house=_coordinates(HOUSE_M))


def _coordinates(corners_m: tuple[Place, ...]) -> str:
    return "\n".join(f"{longitude},{latitude},12.5" for longitude, latitude in ring(corners_m))
