"""All conversions of frames - geodetic, mission frame, a vehicle's local NED.

The mission frame is tangent to the ellipsoid at the mission origin: x along a stated bearing, z up, y completing the
right-handed system. A vehicle's local NED is parallel to north-east-down at the mission origin, shifted to that
vehicle's own estimator origin. The two tangent planes differ slightly: at a distance of 1 km by 2 mm for origins 10 m
apart, by 17 mm for 100 m. A local frame, for indoor flights, has no position on Earth: its north is that of the
vehicles' NED, and the positions of their origins in it have to be given.
"""

from dataclasses import dataclass
from functools import cached_property
from math import cos, isfinite, sin
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyproj

Triple = tuple[float, float, float]


def up_from_ned(ned: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert rows in a vehicle's local NED, (..., 3), to x north, y west, z up about the same origin; its own inverse.

    The result is a mission frame whose x axis points north. World and body axes (front, left, up) both differ by half a
    turn about north, so the function also converts rows of roll, pitch and yaw [rad].
    """
    return np.multiply(ned, (1.0, -1.0, -1.0))


def euler_from_quaternion_rad(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return roll, pitch, yaw (T, 3) [rad] of unit quaternions w, x, y, z (T, 4), in the same frame."""
    w, x, y, z = quaternions.T
    roll_rad = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch_rad = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw_rad = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack((roll_rad, pitch_rad, yaw_rad))


@dataclass(frozen=True)
class Geodetic:
    """A WGS-84 position: degrees, and metres above the ellipsoid or another datum that is used throughout.

    Raises ValueError when it is not a place on Earth.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    def __post_init__(self) -> None:
        if not (abs(self.latitude_deg) <= 90.0 and abs(self.longitude_deg) <= 180.0 and isfinite(self.altitude_m)):
            raise ValueError(f"{self} is not a place on Earth")


@dataclass(frozen=True)
class MissionFrame:
    """The mission frame: its origin, and the bearing of its x axis clockwise from north.

    A frame without an origin is local: it has no geodetic coordinates, and its north is that of the vehicles' NED.
    """

    origin: Geodetic | None
    x_bearing_rad: float = 0.0

    def __post_init__(self) -> None:
        if not isfinite(self.x_bearing_rad):
            raise ValueError(f"x_bearing_rad = {self.x_bearing_rad} is not a bearing")

    @property
    def is_local(self) -> bool:
        """Whether it has no position on Earth."""
        return self.origin is None

    def mission_from_ned(self, ned: Triple) -> Triple:
        """Rotate north-east-down into the mission frame: velocities, and positions about one origin [m, m/s]."""
        north, east, down = ned
        cosine, sine = cos(self.x_bearing_rad), sin(self.x_bearing_rad)
        return north * cosine + east * sine, north * sine - east * cosine, -down

    def ned_from_mission(self, mission: Triple) -> Triple:
        """Rotate the mission frame into north-east-down; the inverse of `mission_from_ned`."""
        x, y, z = mission
        cosine, sine = cos(self.x_bearing_rad), sin(self.x_bearing_rad)
        return x * cosine + y * sine, x * sine - y * cosine, -z

    def mission_from_geodetic(self, place: Geodetic) -> Triple:
        """Return the mission coordinates of a place [m]; raises ValueError in a local frame, which has none."""
        east, north, up = self._enu_from_geodetic.transform(place.longitude_deg, place.latitude_deg, place.altitude_m)
        return self.mission_from_ned((north, east, -up))

    def geodetic_from_mission(self, mission: Triple) -> Geodetic:
        """Return the place at mission coordinates [m]; raises ValueError in a local frame, which has none."""
        north, east, down = self.ned_from_mission(mission)
        longitude, latitude, altitude = self._enu_from_geodetic.transform(east, north, -down, direction="INVERSE")
        return Geodetic(latitude, longitude, altitude)

    def ned_from_geodetics(
        self,
        latitudes_deg: NDArray[np.float64],
        longitudes_deg: NDArray[np.float64],
        altitudes_m: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return north-east-down of many places about the origin, (T, 3) [m]; raises ValueError in a local frame."""
        east, north, up = self._enu_from_geodetic.transform(longitudes_deg, latitudes_deg, altitudes_m)
        return np.column_stack((north, east, np.negative(up)))

    @cached_property
    def _enu_from_geodetic(self) -> "pyproj.Transformer":
        # pyproj takes 0.1 s to import, and simulations do not need it.
        from pyproj import Transformer  # noqa: PLC0415

        if self.origin is None:
            raise ValueError("a local frame has no geodetic coordinates")
        origin = self.origin
        return Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
            f"+step +proj=topocentric +ellps=WGS84 +lon_0={origin.longitude_deg!r} +lat_0={origin.latitude_deg!r} "
            f"+h_0={origin.altitude_m!r}"
        )
