"""What a file holds: areas to stay in or to keep out of, and rally points, in latitude and longitude."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from gcs.errors import InputError, KeyFault

T = TypeVar("T")
U = TypeVar("U")

Degrees = tuple[float, float]
"""Latitude and longitude [deg], WGS 84."""
RADIUS_MAX_M = 100_000.0
HEIGHT_MAX_M = 9000.0
NAME_MAX = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnArea:
    """An area, by the corners of its outline, or a circle of `radius_m` about its only corner.

    `place` says where in the file it stands. Heights are metres as the file has them, None without a limit. `holes` are
    inner outlines.
    """

    place: str
    corners_deg: tuple[Degrees, ...]
    name: str = ""
    stay_inside: bool = False
    radius_m: float = 0.0
    floor_m: float | None = None
    ceiling_m: float | None = None
    holes: tuple[tuple[Degrees, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class DrawnPoint:
    """A rally point; `altitude_m` is its height as the file has it, None without one."""

    place: str
    place_deg: Degrees
    name: str = ""
    altitude_m: float | None = None


@dataclass(frozen=True, slots=True)
class DrawnField:
    """All that was read from a file, and in words what it holds besides."""

    file: str
    file_format: str
    areas: tuple[DrawnArea, ...]
    points: tuple[DrawnPoint, ...] = ()
    left_out: tuple[str, ...] = ()


def collected(read: Callable[[T], U], given: Iterable[T]) -> tuple[U, ...]:
    """Read one after the other; raises InputError with the faults of all that cannot be read."""
    done, faults = list[U](), list[KeyFault]()
    for each in given:
        try:
            done.append(read(each))
        except InputError as error:
            faults += error.placed
    if faults:
        raise InputError(faults)
    return tuple(done)


def ranged(place: str, what: str, value: object, low: float, high: float) -> float:
    """Return a number between two limits, so also a finite one; raises InputError that names the place."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError([KeyFault(place, f"{what} is a number from {low:g} to {high:g} (given: {_shown(value)})")])
    return float(value)


def degrees_of(place: str, latitude: object, longitude: object) -> Degrees:
    """Return a latitude and a longitude; raises InputError that names the place."""
    latitude_deg = ranged(place, "a latitude", latitude, -90.0, 90.0)
    return latitude_deg, ranged(place, "a longitude", longitude, -180.0, 180.0)


def ring_of(place: str, corners: tuple[Degrees, ...]) -> tuple[Degrees, ...]:
    """Return an outline without the repetition of its first corner; raises InputError for fewer than three corners."""
    open_ring = corners[:-1] if len(corners) > 1 and corners[0] == corners[-1] else corners
    if len(open_ring) < 3:
        raise InputError([KeyFault(place, f"an area has at least 3 corners (given: {len(open_ring)})")])
    return open_ring


def _shown(value: object) -> str:
    return repr(value)[:NAME_MAX]
