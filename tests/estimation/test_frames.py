"""Frames against WGS-84 geometry written out here."""

from math import cos, degrees, isclose, nan, pi, radians, sin, sqrt, tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.frames import (
    Geodetic,
    MissionFrame,
    euler_from_quaternion_rad,
    up_from_ned,
)
from estimation.state import Vector
from estimation.vectors import wrap_signed_rad

SEMI_MAJOR_M, FLATTENING = 6378137.0, 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
ZURICH = Geodetic(47.397742, 8.545594, 488.0)
ORIGINS = [ZURICH, Geodetic(-33.9, 151.2, 20.0), Geodetic(0.0, -78.5, 2800.0), Geodetic(78.2, 179.99999, 5.0)]

angles = st.floats(-1e4, 1e4)
metres = st.floats(-3000.0, 3000.0)


def earth_centred_m(place: Geodetic) -> Vector:
    latitude, longitude = radians(place.latitude_deg), radians(place.longitude_deg)
    normal_m = SEMI_MAJOR_M / sqrt(1.0 - ECCENTRICITY_SQUARED * sin(latitude) ** 2)
    across_m = (normal_m + place.altitude_m) * cos(latitude)
    along_m = (normal_m * (1.0 - ECCENTRICITY_SQUARED) + place.altitude_m) * sin(latitude)
    return np.array([across_m * cos(longitude), across_m * sin(longitude), along_m])


def axes_of(frame: MissionFrame) -> tuple[Vector, Vector, Vector]:
    """The unit vectors of x, y and z in earth-centred coordinates."""
    assert frame.origin is not None
    latitude, longitude = radians(frame.origin.latitude_deg), radians(frame.origin.longitude_deg)
    east = np.array([-sin(longitude), cos(longitude), 0.0])
    up = np.array([cos(latitude) * cos(longitude), cos(latitude) * sin(longitude), sin(latitude)])
    north = np.cross(up, east)
    x = north * cos(frame.x_bearing_rad) + east * sin(frame.x_bearing_rad)
    return x, np.cross(up, x), up


def test_places_agree_with_earth_centred_geometry_and_come_back(subtests: pytest.Subtests) -> None:
    for origin in ORIGINS:
        for bearing_deg in [0.0, 90.0, -135.0]:
            with subtests.test(origin=origin, bearing_deg=bearing_deg):
                frame = MissionFrame(origin, radians(bearing_deg))
                for offset in [(0.0, 0.0, 0.0), (0.01, 0.0, 3.0), (-0.004, 0.013, -40.0), (0.0, -0.02, 120.0)]:
                    longitude = degrees(wrap_signed_rad(radians(origin.longitude_deg + offset[1])))
                    place = Geodetic(origin.latitude_deg + offset[0], longitude, origin.altitude_m + offset[2])
                    line = earth_centred_m(place) - earth_centred_m(origin)
                    mission = frame.mission_from_geodetic(place)
                    assert mission == pytest.approx([axis @ line for axis in axes_of(frame)], abs=1e-6)
                    again = frame.geodetic_from_mission(mission)
                    assert earth_centred_m(again) == pytest.approx(earth_centred_m(place), abs=1e-6)


def test_north_east_down_by_hand(subtests: pytest.Subtests) -> None:
    for bearing_deg, ned, mission in (
        (0.0, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        (0.0, (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)),
        (90.0, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        (90.0, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        (180.0, (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)),
        (45.0, (1.0, 1.0, -2.0), (sqrt(2.0), 0.0, 2.0)),
    ):
        with subtests.test(bearing_deg=bearing_deg, ned=ned, mission=mission):
            frame = MissionFrame(ZURICH, radians(bearing_deg))
            assert frame.mission_from_ned(ned) == pytest.approx(mission, abs=1e-12)
            assert frame.ned_from_mission(mission) == pytest.approx(ned, abs=1e-12)


@given(angles, metres, metres, metres)
def test_rotation_into_the_mission_frame_is_undone_exactly(bearing: float, x: float, y: float, z: float) -> None:
    frame = MissionFrame(ZURICH, bearing)
    assert frame.mission_from_ned(frame.ned_from_mission((x, y, z))) == pytest.approx((x, y, z), abs=1e-9)
    assert frame.ned_from_mission(frame.mission_from_ned((x, y, z))) == pytest.approx((x, y, z), abs=1e-9)


@given(angles)
def test_wrapping_changes_an_angle_by_whole_turns_only(angle: float) -> None:
    wrapped = wrap_signed_rad(angle)
    assert -pi <= wrapped <= pi
    turns = (angle - wrapped) / tau
    assert isclose(turns, round(turns), abs_tol=1e-9)


def test_what_is_no_place_on_earth_is_refused(subtests: pytest.Subtests) -> None:
    for place in (
        (90.1, 0.0, 0.0),
        (0.0, -180.1, 0.0),
        (nan, 0.0, 0.0),
        (0.0, 0.0, nan),
    ):
        with subtests.test(place=place), pytest.raises(ValueError, match="not a place on Earth"):
            Geodetic(*place)


def test_a_bearing_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="not a bearing"):
        MissionFrame(ZURICH, nan)


@given(st.tuples(metres, metres, metres))
def test_rows_of_ned_convert_as_the_mission_frame_of_bearing_zero(ned: tuple[float, float, float]) -> None:
    rows = np.array([ned, (1.0, 2.0, 3.0)])
    frame = MissionFrame(None)
    assert up_from_ned(rows).tolist() == [list(frame.mission_from_ned(ned)), [1.0, -2.0, -3.0]]
    assert up_from_ned(up_from_ned(rows)).tolist() == rows.tolist()


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_a_quaternion_is_the_product_of_its_three_turns(roll: float, pitch: float, yaw: float) -> None:
    """Yaw, then pitch, then roll: the quaternion multiplied out here turn by turn."""

    def times(a: Vector, b: Vector) -> Vector:
        vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
        return np.array([a[0] * b[0] - a[1:] @ b[1:], *vector])

    turns = [np.array([cos(angle / 2.0), 0.0, 0.0, 0.0]) for angle in (yaw, pitch, roll)]
    for turn, axis, angle in zip(turns, (3, 2, 1), (yaw, pitch, roll), strict=True):
        turn[axis] = sin(angle / 2.0)
    whole = times(times(turns[0], turns[1]), turns[2])
    assert euler_from_quaternion_rad(np.array([whole]))[0] == pytest.approx((roll, pitch, yaw), abs=1e-6)
