"""A drawing on the ground: fence, no-fly zones and rally points in metres, checked as a mission's are."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import cos, degrees, dist, hypot, pi, radians, remainder, sin, tau
from unicodedata import normalize

from agents.safety.fence import Fence
from agents.settings.sections import CORNERS_MAX, RALLY_MAX, ZONES_MAX
from estimation.frames import Geodetic, MissionFrame
from estimation.vectors import Pair
from gcs.errors import InputError, KeyFault
from gcs.zones.drawing import Degrees, DrawnArea, DrawnField, DrawnPoint, collected

CIRCLE_CORNERS = 64
"""Of the polygon in a circle to stay in, which is at most 0.12 % of the radius smaller."""
FAR_M = 20_000.0
"""From the origin of the mission: zones beyond are left out."""
CORNER_MAX_M = 100_000.0
"""From the origin: beyond, straight lines of the map and of the mission's plane differ by many metres."""
AREA_LEAST_M2 = 1.0
RADIUS_MAX_M = 10_000.0
"""Of a circle, as of a mission's zone."""
_SAME_M = 0.01
_DIGITS = 2
_EARTH_RADIUS_M = 6_371_000.0
_NAME_MAX = 24


@dataclass(frozen=True, slots=True)
class GroundArea:
    """An area in the mission frame [m]: the corners of its outline, or a circle of `radius_m` about its only corner.

    Heights are above the mission's origin, None without a limit.
    """

    name: str
    corners_m: tuple[Pair, ...]
    radius_m: float = 0.0
    floor_m: float | None = None
    ceiling_m: float | None = None

    @property
    def area_m2(self) -> float:
        """The area of the ground that it covers."""
        if self.radius_m:
            return pi * self.radius_m**2
        sides = zip(self.corners_m, (*self.corners_m[1:], self.corners_m[0]), strict=True)
        return abs(sum(x1 * y2 - x2 * y1 for (x1, y1), (x2, y2) in sides)) / 2.0


@dataclass(frozen=True, slots=True)
class GroundPoint:
    """A rally point in the mission frame [m]."""

    name: str
    place_m: Pair


@dataclass(frozen=True, slots=True)
class Layout:
    """What a mission takes of a drawing, and in words what it does not."""

    fence: GroundArea | None
    zones: tuple[GroundArea, ...]
    points: tuple[GroundPoint, ...]
    left_out: tuple[str, ...]


def laid_out(drawing: DrawnField, frame: MissionFrame, fence: str | None = None) -> Layout:
    """Return a drawing in a mission's frame; `fence` names the area to stay in, also one not drawn as such.

    Zones and points beyond `FAR_M` are left out. Raises InputError with every fault: areas that cross themselves, reach
    too far away or have too many corners, several to stay in, and if nothing is near.
    """
    inside, others, left_out = _chosen(_named(drawing.areas), fence)
    others += _holes(inside)
    near = [area for area in others if _may_be_near(area.corners_deg, area.radius_m, frame)]
    ground = collected(lambda area: _area(area, frame), [*inside, *near])
    bounds, zones = ground[: len(inside)], [area for area in ground[len(inside) :] if _away_m(area) <= FAR_M]
    kept = {area.name for area in zones}
    left_out += [f"'{area.name}', more than {FAR_M / 1000.0:g} km away" for area in others if area.name not in kept]
    left_out += [_filled(area) for area in others if area.holes and area.name in kept]
    points = [each for each in drawing.points if _may_be_near((each.place_deg,), 0.0, frame)]
    if far := len(drawing.points) - len(points):
        left_out.append(f"{far} rally points more than {FAR_M / 1000.0:g} km away")
    if not (bounds or zones or points):
        reason = f"nothing of it is within {FAR_M / 1000.0:g} km of the mission's origin{_origin_text(frame)}"
        raise InputError([KeyFault(drawing.file, f"{reason}: are latitude and longitude in their order?")])
    if len(points) > RALLY_MAX:
        raise InputError(
            [KeyFault(drawing.file, f"a mission has at most {RALLY_MAX} rally points (given: {len(points)})")]
        )
    if any(each.altitude_m for each in points):
        left_out.append("heights of rally points: vehicles return in their layers")
    if len(zones) > ZONES_MAX:
        reason = f"a mission has at most {ZONES_MAX} no-fly zones (given: {len(zones)} within {FAR_M / 1000.0:g} km)"
        raise InputError([KeyFault(drawing.file, reason)])
    return Layout(
        _inscribed(bounds[0]) if bounds else None,
        tuple(zones),
        tuple(_point(n, each, frame) for n, each in enumerate(points, start=1)),
        (*drawing.left_out, *left_out),
    )


def own_frame(drawing: DrawnField) -> MissionFrame:
    """Return a frame at the first place of a drawing, north along x."""
    places = [area.corners_deg[0] for area in drawing.areas] + [point.place_deg for point in drawing.points]
    return MissionFrame(Geodetic(*places[0], 0.0))


def _named(areas: Sequence[DrawnArea]) -> list[DrawnArea]:
    """Return the areas with a name of their own each."""
    names = [_mission_name(area.name) or f"zone-{n}" for n, area in enumerate(areas, start=1)]
    often, seen = Counter(names), Counter[str]()
    named = list[DrawnArea]()
    for area, name in zip(areas, names, strict=True):
        seen[name] += 1
        named.append(replace(area, name=f"{name[: _NAME_MAX - 4]}-{seen[name]}" if often[name] > 1 else name))
    return named


def _mission_name(name: str) -> str:
    """Return a name as missions have them: letters without accents, digits, - and _."""
    plain = normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9_]+", "-", plain).strip("-")[:_NAME_MAX].strip("-")


def _chosen(areas: Sequence[DrawnArea], fence: str | None) -> tuple[list[DrawnArea], list[DrawnArea], list[str]]:
    """Return the area to stay in, if there is one, the areas to keep out of, and what is left out in words."""
    inside = [area for area in areas if area.stay_inside]
    others = [area for area in areas if not area.stay_inside]
    if fence is None:
        if len(inside) > 1:
            names = ", ".join(f"'{area.name}'" for area in inside)
            raise InputError(
                [f"--fence: the file has {len(inside)} areas to stay in ({names}), a mission one fence: name it"]
            )
        return inside, others, []
    chosen = [area for area in areas if fence == area.name]
    if not chosen:
        names = ", ".join(f"'{area.name}'" for area in areas) or "none"
        raise InputError([f"--fence: the file has no area {fence!r} (areas: {names})"])
    left_out = [f"'{area.name}', another area to stay in" for area in inside if area not in chosen]
    return chosen, [area for area in others if area not in chosen], left_out


def _area(area: DrawnArea, frame: MissionFrame) -> GroundArea:
    corners = _without_repeats([_place_m(area.place, each, frame) for each in area.corners_deg])
    ground = GroundArea(area.name, tuple(corners), area.radius_m, area.floor_m, area.ceiling_m)
    if area.floor_m is not None and area.ceiling_m is not None and area.floor_m >= area.ceiling_m:
        reason = f"its floor of {area.floor_m:g} m is not below its ceiling of {area.ceiling_m:g} m"
        raise InputError([KeyFault(area.place, reason)])
    if not area.radius_m:
        _require_sound(area, ground)
    elif area.radius_m > RADIUS_MAX_M:
        raise InputError([KeyFault(area.place, f"a radius is at most {RADIUS_MAX_M:g} m (given: {area.radius_m:g})")])
    return ground


def _require_sound(area: DrawnArea, ground: GroundArea) -> None:
    count = len(ground.corners_m)
    if count > CORNERS_MAX:
        reason = f"an area has at most {CORNERS_MAX} corners (given: {count}); next: simplify it"
        raise InputError([KeyFault(area.place, reason)])
    crossed = Fence(ground.corners_m).crossed_edges() if count >= 3 else None
    if crossed is not None:
        one, other = (_degrees_text(area.corners_deg[at]) for at in crossed)
        reason = (
            f"it crosses itself: the edges from corner {crossed[0]}, {one}, and from corner {crossed[1]}, {other}, meet"
        )
        raise InputError([KeyFault(area.place, reason)])
    if count < 3 or ground.area_m2 < AREA_LEAST_M2:
        raise InputError([KeyFault(area.place, f"its outline encloses less than {AREA_LEAST_M2:g} m²")])


def _point(number: int, point: DrawnPoint, frame: MissionFrame) -> GroundPoint:
    return GroundPoint(_mission_name(point.name) or f"rally-{number}", _place_m(point.place, point.place_deg, frame))


def _filled(area: DrawnArea) -> str:
    return f"{len(area.holes)} inner outlines of '{area.name}': nobody flies inside of them either"


def _may_be_near(corners: Sequence[Degrees], radius_m: float, frame: MissionFrame) -> bool:
    """Return whether the box around corners, `FAR_M` larger, holds the origin: else the area is farther away."""
    assert frame.origin is not None
    latitude_deg, longitude_deg = frame.origin.latitude_deg, frame.origin.longitude_deg
    north_deg = degrees((FAR_M + radius_m) / _EARTH_RADIUS_M)
    east_deg = north_deg / max(cos(radians(latitude_deg)), 0.01)
    norths = [latitude - latitude_deg for latitude, _ in corners]
    easts = [remainder(longitude - longitude_deg, 360.0) for _, longitude in corners]
    return min(norths) <= north_deg and max(norths) >= -north_deg and min(easts) <= east_deg and max(easts) >= -east_deg


def _place_m(place: str, corner: Degrees, frame: MissionFrame) -> Pair:
    assert frame.origin is not None
    x, y, up_m = frame.mission_from_geodetic(Geodetic(*corner, frame.origin.altitude_m))
    # The far side of the Earth has small coordinates in the tangent plane, too: it is far below.
    if hypot(x, y, up_m) > CORNER_MAX_M:
        reason = f"{_degrees_text(corner)} is more than {CORNER_MAX_M / 1000.0:g} km from the origin"
        raise InputError([KeyFault(place, f"{reason}{_origin_text(frame)}; next: cut the area")])
    return round(x, _DIGITS) + 0.0, round(y, _DIGITS) + 0.0


def _origin_text(frame: MissionFrame) -> str:
    origin = frame.origin
    return "" if origin is None else f", {_degrees_text((origin.latitude_deg, origin.longitude_deg))}"


def _without_repeats(corners: Sequence[Pair]) -> Iterator[Pair]:
    for before, corner in zip((corners[-1], *corners[:-1]), corners, strict=True):
        if len(corners) == 1 or dist(before, corner) >= _SAME_M:
            yield corner


def _holes(inside: Sequence[DrawnArea]) -> Iterator[DrawnArea]:
    """Yield the inner outlines of the fence as no-fly zones."""
    for area in inside:
        for n, hole in enumerate(area.holes, start=1):
            yield DrawnArea(place=area.place, corners_deg=hole, name=f"{area.name[: _NAME_MAX - 9]}-inner-{n}")


def _inscribed(fence: GroundArea | None) -> GroundArea | None:
    """Return a fence as a polygon: that in a circle."""
    if fence is None or not fence.radius_m:
        return fence
    (x, y), radius_m = fence.corners_m[0], fence.radius_m
    turns = (tau * k / CIRCLE_CORNERS for k in range(CIRCLE_CORNERS))
    corners = ((x + radius_m * cos(turn), y + radius_m * sin(turn)) for turn in turns)
    return GroundArea(fence.name, tuple((round(a, _DIGITS) + 0.0, round(b, _DIGITS) + 0.0) for a, b in corners))


def _away_m(area: GroundArea) -> float:
    """Return the distance of an area from the origin, 0 around it."""
    if area.radius_m:
        return max(hypot(*area.corners_m[0]) - area.radius_m, 0.0)
    clearance_m = Fence(area.corners_m).clearance_m((0.0, 0.0))
    return max(-clearance_m, 0.0)


def _degrees_text(place: Degrees) -> str:
    return f"{place[0]:.6f}, {place[1]:.6f}"
