"""Which map tiles an area has: a box of latitudes and longitudes with a range of levels, or that of a mission."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from math import cos, degrees, isfinite, radians

from gcs.console.vehicle_view import Pair
from gcs.errors import InputError
from gcs.mission.mission import Mission
from gcs.station.tiles import LEVEL_MAX, tile_at

LATITUDE_MAX_DEG = 85.05
"""Where the square web Mercator map ends."""
TILES_MAX = 100_000
MARGIN_M = 150.0
"""Around what a mission flies."""
_EARTH_RADIUS_M = 6_371_000.0
_PATH_POINTS = 50

TilePlace = tuple[int, int, int]
"""Level, column from 180° west, and row from the north."""


@dataclass(frozen=True, slots=True)
class TileArea:
    """A box between two latitudes and two longitudes [deg], and the lowest and the highest level."""

    south_deg: float
    west_deg: float
    north_deg: float
    east_deg: float
    level_min: int
    level_max: int

    def __post_init__(self) -> None:
        if self.count > TILES_MAX:
            raise InputError(
                [
                    f"--zoom: the area has {self.count} tiles of levels {self.level_min} to {self.level_max}, more "
                    f"than {TILES_MAX}; next: a smaller area, or a lower highest level"
                ]
            )

    @property
    def centre_deg(self) -> Pair:
        """The latitude and the longitude of its middle."""
        return (self.south_deg + self.north_deg) / 2.0, (self.west_deg + self.east_deg) / 2.0

    @property
    def count(self) -> int:
        """How many tiles it has."""
        ranges = map(self._ranges, range(self.level_min, self.level_max + 1))
        return sum(len(columns) * len(rows) for columns, rows in ranges)

    def tiles(self) -> Iterator[TilePlace]:
        """Yield all tiles, the lowest level first."""
        for level in range(self.level_min, self.level_max + 1):
            columns, rows = self._ranges(level)
            yield from ((level, column, row) for column in columns for row in rows)

    def _ranges(self, level: int) -> tuple[range, range]:
        first_column, last_row = tile_at(level, self.south_deg, self.west_deg)
        last_column, first_row = tile_at(level, self.north_deg, self.east_deg)
        last = 2**level - 1  # at 180° east the column would be the next
        return range(first_column, min(last_column, last) + 1), range(first_row, min(last_row, last) + 1)


def box_area(text: str, levels: tuple[int, int]) -> TileArea:
    """Return the area of SOUTH,WEST,NORTH,EAST in degrees; raises InputError."""
    try:
        south, west, north, east = map(float, text.split(","))
    except ValueError as error:
        raise InputError([f"AREA: {text!r} is neither a mission nor SOUTH,WEST,NORTH,EAST in degrees"]) from error
    if not (all(map(isfinite, (south, west, north, east))) and -90.0 <= south < north <= 90.0):
        raise InputError([f"AREA: {text!r}: latitudes are from -90 to 90, the southern one first"])
    if not -180.0 <= west < east <= 180.0:
        raise InputError([f"AREA: {text!r}: longitudes are from -180 to 180, the western one first"])
    return _area(south, west, north, east, levels)


def mission_area(mission: Mission, levels: tuple[int, int]) -> TileArea:
    """Return the area of a mission's starts, fences, landing places and rings, with a margin.

    Raises InputError for a local frame.
    """
    frame = mission.mission_frame()
    if frame.is_local:
        raise InputError(["AREA: the mission's frame is local, without latitude and longitude"])
    places = [place for vehicle in mission.vehicles for place in mission.agent_config(vehicle).landing_places_m]
    places += chain(*(vehicle.section.limits(mission.safety).fence_m for vehicle in mission.vehicles))
    for alone in mission.alone:
        radius_m = alone.encirclement.radius_m
        for _, (x, y) in alone.target.motion.path_m(mission.mission.duration_s, _PATH_POINTS):
            places += [(x - radius_m, y - radius_m), (x + radius_m, y + radius_m)]
    found = [frame.geodetic_from_mission((x, y, 0.0)) for x, y in places]
    south, north = min(each.latitude_deg for each in found), max(each.latitude_deg for each in found)
    margin_deg = degrees(MARGIN_M / _EARTH_RADIUS_M)
    across_deg = margin_deg / max(cos(radians(south)), 0.01)
    west, east = min(each.longitude_deg for each in found), max(each.longitude_deg for each in found)
    return _area(south - margin_deg, west - across_deg, north + margin_deg, east + across_deg, levels)


def levels_of(text: str) -> tuple[int, int]:
    """Return the lowest and the highest level of MIN:MAX; raises InputError."""
    low, colon, high = text.partition(":")
    given = (low, high if colon else low)
    if not all(each.isdecimal() and int(each) <= LEVEL_MAX for each in given) or int(given[0]) > int(given[1]):
        raise InputError([f"--zoom: {text!r} is not MIN:MAX, levels from 0 to {LEVEL_MAX}, such as 14:18"])
    return int(given[0]), int(given[1])


def _area(south: float, west: float, north: float, east: float, levels: tuple[int, int]) -> TileArea:
    south, north = (min(max(each, -LATITUDE_MAX_DEG), LATITUDE_MAX_DEG) for each in (south, north))
    return TileArea(south, max(west, -180.0), north, min(east, 180.0), *levels)
