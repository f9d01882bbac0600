"""A drawing on the ground: fence, no-fly zones and rally points in metres, checked as a mission's are."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from itertools import count
from math import cos, degrees, dist, hypot, pi, radians, remainder, sin, tau
from unicodedata import normalize

from agents.safety.fence import Fence
from agents.settings.sections import CORNERS_MAX, RALLY_MAX, ZONE_AREA_LEAST_M2, ZONES_MAX, SafetySettings
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
        return pi * self.radius_m**2 if self.radius_m else Fence(self.corners_m).area_m2


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

    def beside(self, safety: SafetySettings) -> "Layout":
        """Return this layout with names that a mission's own zones and rally points do not have."""
        zones = _distinct([each.name for each in self.zones], [each.name for each in safety.no_fly])
        points = _distinct([each.name for each in self.points], [each.name for each in safety.rally])
        return replace(
            self,
            zones=tuple(replace(each, name=name) for each, name in zip(self.zones, zones, strict=True)),
            points=tuple(replace(each, name=name) for each, name in zip(self.points, points, strict=True)),
        )


def laid_out(drawing: DrawnField, frame: MissionFrame, fence: str | None = None) -> Layout:
    """Return a drawing in a mission's frame; `fence` names the area to stay in, also one not drawn as such.

    Zones and points beyond `FAR_M` are left out. Raises InputError with every fault: areas that cross themselves, reach
    too far away or have too many corners, several to stay in, and if nothing is near.
    """
    named = _named(drawing.areas)
    inside, others, left_out = _chosen(named, fence)
    others += _holes(inside, [area.name for area in named])
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
        _points(points, frame),
        (*drawing.left_out, *left_out),
    )


def own_frame(drawing: DrawnField) -> MissionFrame:
    """Return a frame at the first place of a drawing, north along x."""
    places = [area.corners_deg[0] for area in drawing.areas] + [point.place_deg for point in drawing.points]
    return MissionFrame(Geodetic(*places[0], 0.0))


def _named(areas: Sequence[DrawnArea]) -> list[DrawnArea]:
    """Return the areas with a name of their own each."""
    names = _distinct([_mission_name(area.name) or f"zone-{n}" for n, area in enumerate(areas, start=1)])
    return [replace(area, name=name) for area, name in zip(areas, names, strict=True)]


def _distinct(names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Return names of which none comes twice or is taken: such a one gets the first number that makes it new."""
    often, used, distinct = Counter([*names, *taken]), {*names, *taken}, list[str]()
    for name in names:
        distinct.append(_numbered(name, used) if often[name] > 1 else name)
        used.add(distinct[-1])
    return distinct


def _numbered(name: str, used: AbstractSet[str]) -> str:
    return next(each for n in count(1) if (each := f"{name[: _NAME_MAX - 4]}-{n}") not in used)


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
    places = [_place_m(area.place, each, frame) for each in area.corners_deg]
    kept = _without_repeats(places)
    corners = tuple(places[at] for at in kept)
    ground = GroundArea(area.name, corners, area.radius_m, area.floor_m, area.ceiling_m)
    if area.floor_m is not None and area.ceiling_m is not None and area.floor_m >= area.ceiling_m:
        reason = f"its floor of {area.floor_m:g} m is not below its ceiling of {area.ceiling_m:g} m"
        raise InputError([KeyFault(area.place, reason)])
    if not area.radius_m:
        _require_sound(area, ground, kept)
    elif area.radius_m > RADIUS_MAX_M:
        raise InputError([KeyFault(area.place, f"a radius is at most {RADIUS_MAX_M:g} m (given: {area.radius_m:g})")])
    return ground


def _require_sound(area: DrawnArea, ground: GroundArea, kept: Sequence[int]) -> None:
    """Raise InputError unless the outline on the ground, whose corners are those `kept` of the drawn ones, is one."""
    corners = len(ground.corners_m)
    if corners > CORNERS_MAX:
        reason = f"an area has at most {CORNERS_MAX} corners (given: {corners}); next: simplify it"
        raise InputError([KeyFault(area.place, reason)])
    crossed = Fence(ground.corners_m).crossed_edges() if corners >= 3 else None
    if crossed is not None:
        one, other = (f"{kept[at]}, {_degrees_text(area.corners_deg[kept[at]])}" for at in crossed)
        reason = f"it crosses itself: the edges from corner {one}, and from corner {other}, meet"
        raise InputError([KeyFault(area.place, reason)])
    if corners < 3 or ground.area_m2 < ZONE_AREA_LEAST_M2:
        raise InputError([KeyFault(area.place, f"its outline encloses less than {ZONE_AREA_LEAST_M2:g} m²")])


def _points(points: Sequence[DrawnPoint], frame: MissionFrame) -> tuple[GroundPoint, ...]:
    names = _distinct([_mission_name(each.name) or f"rally-{n}" for n, each in enumerate(points, start=1)])
    placed = (_place_m(each.place, each.place_deg, frame) for each in points)
    return tuple(map(GroundPoint, names, placed))


def _filled(area: DrawnArea) -> str:
    return f"{len(area.holes)} inner outlines of '{area.name}': they are closed as well"


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


def _without_repeats(corners: Sequence[Pair]) -> list[int]:
    """Return the places in the sequence of the corners that do not repeat the one before."""
    if len(corners) == 1:
        return [0]
    befores = (corners[-1], *corners[:-1])
    pairs = enumerate(zip(befores, corners, strict=True))
    return [at for at, (before, corner) in pairs if dist(before, corner) >= _SAME_M]


def _holes(inside: Sequence[DrawnArea], taken: Sequence[str]) -> Iterator[DrawnArea]:
    """Yield the inner outlines of the fence as no-fly zones, by names that are not taken."""
    for area in inside:
        names = [f"{area.name[: _NAME_MAX - 9]}-inner-{n}" for n in range(1, len(area.holes) + 1)]
        for hole, name in zip(area.holes, _distinct(names, taken), strict=True):
            yield DrawnArea(place=area.place, corners_deg=hole, name=name)


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
