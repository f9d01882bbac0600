"""QGroundControl's plans, version 1, with geofences and rally points of version 2.

https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html
"""

import json
from typing import Final

from estimation.frames import MissionFrame
from estimation.vectors import Pair
from gcs.errors import InputError, KeyFault
from gcs.mission.mission import Mission, MissionVehicle
from gcs.zones.drawing import (
    HEIGHT_MAX_M,
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

FILE_TYPE: Final = "Plan"
_DEGREES_DIGITS = 8
"""A millimetre."""
_VERSIONS = {"": 1, "geoFence": 2, "rallyPoints": 2}
_OF_ONE_AREA = 1


def plan_drawing(root: JsonNode) -> DrawnField:
    """Return what a plan holds; raises InputError."""
    parts = {name: root.get(name) if name else root for name in _VERSIONS}
    collected(lambda name: _require_version(parts[name], _VERSIONS[name]), _VERSIONS)
    fence, rally = parts["geoFence"], parts["rallyPoints"]
    faults, areas, points = list[KeyFault](), tuple[DrawnArea, ...](), tuple[DrawnPoint, ...]()
    try:
        polygons = [] if fence is None else list(each_of(fence.get("polygons")))
        circles = [] if fence is None else list(each_of(fence.get("circles")))
        areas = collected(_area, [*polygons, *circles])
    except InputError as error:
        faults += error.placed
    try:
        points = collected(_rally_point, each_of(None if rally is None else rally.get("points")))
    except InputError as error:
        faults += error.placed
    if faults:
        raise InputError(faults)
    return DrawnField(root.file, "QGroundControl plan", areas, points, tuple(_left_out(root, fence)))


def plan_text(mission: Mission, vehicle: MissionVehicle | None = None) -> str:
    """Return a mission's fence and zones as a plan without mission items; of a vehicle with its own fence and spots.

    Plans have no heights: a zone is closed at all of them. Raises ValueError in a local frame.
    """
    frame = mission.mission_frame()
    fence_m = (mission.safety if vehicle is None else vehicle.section.limits(mission.safety)).fence_m
    polygons, circles = [_plan_polygon(frame, fence_m, inclusion=True)] if fence_m else [], list[dict[str, object]]()
    for zone in mission.safety.no_fly:
        if zone.center_m is not None and zone.radius_m is not None:
            circle = {"center": _plan_place(frame, zone.center_m), "radius": zone.radius_m}
            circles.append({"circle": circle, "inclusion": False, "version": _OF_ONE_AREA})
        else:
            polygons.append(_plan_polygon(frame, zone.polygon_m, inclusion=False))
    points = [] if vehicle is None else _plan_points(mission, vehicle)
    home = [mission.frame.latitude_deg, mission.frame.longitude_deg, mission.frame.altitude_m]
    return json.dumps(
        {
            "fileType": FILE_TYPE,
            "geoFence": {"circles": circles, "polygons": polygons, "version": _VERSIONS["geoFence"]},
            "groundStation": "cordon",
            "mission": {
                "cruiseSpeed": 15,
                "firmwareType": 0,
                "globalPlanAltitudeMode": 1,
                "hoverSpeed": 5,
                "items": [],
                "plannedHomePosition": home,
                "vehicleType": 2,
                "version": 2,
            },
            "rallyPoints": {"points": points, "version": _VERSIONS["rallyPoints"]},
            "version": _VERSIONS[""],
        },
        indent=4,
    )


def _plan_points(mission: Mission, vehicle: MissionVehicle) -> list[list[float]]:
    """Return a vehicle's spots at the rally points, at the height of its layer on the way home."""
    height_m = mission.agent_config(vehicle).return_altitude_m
    return [[*_plan_place(mission.mission_frame(), spot), height_m] for spot in mission.rally_m(vehicle)]


def _plan_polygon(frame: MissionFrame, corners_m: tuple[Pair, ...], *, inclusion: bool) -> dict[str, object]:
    corners = [_plan_place(frame, corner) for corner in corners_m]
    return {"inclusion": inclusion, "polygon": corners, "version": _OF_ONE_AREA}


def _plan_place(frame: MissionFrame, place_m: Pair) -> list[float]:
    place = frame.geodetic_from_mission((*place_m, 0.0))
    return [round(place.latitude_deg, _DEGREES_DIGITS), round(place.longitude_deg, _DEGREES_DIGITS)]


def _require_version(part: JsonNode | None, known: int) -> None:
    if part is None:
        return
    version = part["version"]
    if isinstance(version.value, bool) or version.value != known:
        step = "next: open it with a present QGroundControl, and save it"
        raise version.fault(f"only version {known} is read (given: {str(version.value)[:20]}); {step}")


def _area(area: JsonNode) -> DrawnArea:
    _require_version(area, _OF_ONE_AREA)
    inclusion = area["inclusion"].flag()
    circle = area.get("circle")
    if circle is not None:
        centre = circle["center"]
        radius_m = circle["radius"].number("a radius in metres", 0.01, RADIUS_MAX_M)
        return DrawnArea(place=area.place, corners_deg=(_corner(centre),), stay_inside=inclusion, radius_m=radius_m)
    outline = area["polygon"]
    corners = ring_of(outline.place, collected(_corner, outline.items()))
    return DrawnArea(place=area.place, corners_deg=corners, stay_inside=inclusion)


def _corner(corner: JsonNode) -> Degrees:
    latitude, longitude, *_ = corner.items(2)
    return degrees_of(corner.place, latitude.value, longitude.value)


def _rally_point(point: JsonNode) -> DrawnPoint:
    """Return a rally point; its altitude is above home."""
    values = point.items(2)
    altitude = values[2].number("an altitude in metres", -HEIGHT_MAX_M, HEIGHT_MAX_M) if len(values) > 2 else None
    return DrawnPoint(point.place, _corner(point), altitude_m=altitude)


def _left_out(root: JsonNode, fence: JsonNode | None) -> list[str]:
    mission = root.get("mission")
    items = [] if mission is None or not isinstance(mission.value, dict) else list(each_of(mission.get("items")))
    said = [f"{len(items)} mission item{'s' * (len(items) != 1)}"] if items else []
    if fence is not None and fence.get("breachReturn") is not None:
        said.append("the fence's breach return point")
    return said
