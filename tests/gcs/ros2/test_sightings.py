"""Poses of ROS 2 as sightings: bytes packed by hand, frames and covariances by matrices of the test's own."""

import json
from collections.abc import Sequence
from contextlib import suppress
from math import cos, inf, nan, radians, sin, sqrt
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs.ros2.messages import Messages
from gcs.ros2.sightings import PoseRefusal, PoseSightings, RefusedError, SightingDefaults
from tests.support.cdr import pose_bytes
from tests.support.mission_text import content, parsed, put

POSE_KEY = "0/target/pose/geometry_msgs::msg::dds_::PoseStamped_/" + (
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
)
COVARIANCE_KEY = "0/target/pose/geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/" + (
    "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
)
NOW_S = 1_767_225_600.25
NOW = (1_767_225_600, 250_000_000)
SIGMA_M = 1.5
MESSAGES = Messages("map")
ASYMMETRIC = [1.0, 0.5, *[0.0] * 5, 1.0, *[0.0] * 28]


def reader(bearing_deg: float = 90.0, **defaults: Any) -> PoseSightings:
    mission = parsed(put(content(), ("frame", "x_bearing_deg"), bearing_deg))
    return PoseSightings(mission, MESSAGES, SightingDefaults("map", SIGMA_M, 0.7, 0.1, **defaults))


def mission_axes(bearing_deg: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the rows x, y of the mission's axes in east and north: x along the bearing, y to its left."""
    turn = radians(bearing_deg)
    return np.array([[sin(turn), cos(turn)], [-cos(turn), sin(turn)]])


def covariance(ee: float, en: float, nn: float, uu: float = 4.0) -> list[float]:
    full = np.zeros((6, 6))
    full[:2, :2] = [[ee, en], [en, nn]]
    full[2, 2] = uu
    full[3:, 3:] = np.eye(3) * 99.0
    return [float(each) for each in full.ravel()]


def taken(reading: PoseSightings, key: str, payload: bytes, team_s: float = NOW_S) -> dict[str, Any]:
    """Return a sighting as the JSON of docs/target.md."""
    return dict(json.loads(reading.take(key, payload, team_s, received_s=1.0)))


def refusal(reading: PoseSightings, key: str, payload: bytes, team_s: float | None = NOW_S) -> PoseRefusal:
    with pytest.raises(RefusedError) as refused:
        reading.take(key, payload, team_s, received_s=1.0)
    assert reading.refused[refused.value.refusal] == 1
    assert reading.taken == 0
    return refused.value.refusal


@given(
    st.floats(-180.0, 180.0),
    st.tuples(*[st.floats(-1e4, 1e4)] * 3),
    st.tuples(st.floats(0.01, 1e3), st.floats(-0.99, 0.99), st.floats(0.01, 1e3)),
)
def test_places_and_covariances_are_those_of_the_mission(
    bearing_deg: float, place_m: Sequence[float], spread: tuple[float, float, float]
) -> None:
    (east_m2, share, north_m2), axes = spread, mission_axes(bearing_deg)
    shared_m2 = share * sqrt(east_m2 * north_m2)
    payload = pose_bytes(place_m, stamp=NOW, covariance=covariance(east_m2, shared_m2, north_m2))
    sighting = taken(reader(bearing_deg), COVARIANCE_KEY, payload)
    assert sighting["frame"] == "mission"
    assert sighting["position"] == pytest.approx(axes @ place_m[:2], abs=1e-6)
    (xx, xy), (_, yy) = axes @ [[east_m2, shared_m2], [shared_m2, north_m2]] @ axes.T
    assert sighting["covariance_m2"] == pytest.approx([xx, xy, yy], abs=1e-9 * (east_m2 + north_m2))
    assert (sighting["altitude_m"], sighting["altitude_sigma_m"]) == pytest.approx((place_m[2], 2.0))
    assert sighting["time_s"] == pytest.approx(NOW_S, abs=1e-6)
    assert (sighting["importance"], sighting["threat"]) == (0.7, 0.1)


def test_what_a_pose_does_not_state_is_taken_from_the_options() -> None:
    """Without a covariance, or with zeros as ROS means an unknown one, and without a stamp."""
    for key, unknown in ((POSE_KEY, []), (COVARIANCE_KEY, [0.0] * 36)):
        sighting = taken(reader(), key, pose_bytes((8.0, 3.0, 2.0), covariance=unknown))
        assert sighting["position"] == pytest.approx([8.0, 3.0])
        assert sighting["covariance_m2"] == pytest.approx([SIGMA_M**2, 0.0, SIGMA_M**2], abs=1e-12)
        assert sighting["altitude_sigma_m"] == SIGMA_M
        assert "time_s" not in sighting
        assert "target" not in sighting


NO_SIGHTINGS: tuple[tuple[PoseRefusal, str, bytes], ...] = (
    (PoseRefusal.TYPE, POSE_KEY.replace("PoseStamped_", "TwistStamped_"), pose_bytes((1.0, 2.0, 3.0))),
    (PoseRefusal.TYPE, POSE_KEY.replace("RIHS01_10", "RIHS01_11"), pose_bytes((1.0, 2.0, 3.0))),
    (PoseRefusal.TYPE, "0/target/pose/x/y", b""),
    (PoseRefusal.LENGTH, POSE_KEY, bytes(1025)),
    (PoseRefusal.MALFORMED, POSE_KEY, b""),
    (PoseRefusal.MALFORMED, POSE_KEY, pose_bytes((1.0, 2.0, 3.0))[:-1]),
    (PoseRefusal.MALFORMED, POSE_KEY, pose_bytes((1.0, 2.0, 3.0)) + bytes(8)),
    (PoseRefusal.MALFORMED, POSE_KEY, b"\x09" + pose_bytes((1.0, 2.0, 3.0))[1:]),
    (PoseRefusal.MALFORMED, COVARIANCE_KEY, pose_bytes((1.0, 2.0, 3.0))),
    (PoseRefusal.MALFORMED, POSE_KEY, pose_bytes((1.0, 2.0, 3.0), covariance=covariance(1.0, 0.0, 1.0))),
    (PoseRefusal.NUMBERS, POSE_KEY, pose_bytes((nan, 2.0, 3.0))),
    (PoseRefusal.NUMBERS, POSE_KEY, pose_bytes((1.0, -inf, 3.0))),
    (PoseRefusal.NUMBERS, POSE_KEY, pose_bytes((1.0, 2.0, nan))),
    (PoseRefusal.NUMBERS, COVARIANCE_KEY, pose_bytes((1.0, 2.0, 3.0), covariance=covariance(nan, 0.0, 1.0))),
    (PoseRefusal.FRAME, POSE_KEY, pose_bytes((1.0, 2.0, 3.0), frame="odom")),
    (PoseRefusal.FRAME, POSE_KEY, pose_bytes((1.0, 2.0, 3.0), frame="")),
    (PoseRefusal.STALE, POSE_KEY, pose_bytes((1.0, 2.0, 3.0), stamp=(NOW[0] - 1, 0))),
    (PoseRefusal.STALE, POSE_KEY, pose_bytes((1.0, 2.0, 3.0), stamp=(-5, 0))),
    (PoseRefusal.VALUE, POSE_KEY, pose_bytes((1.0, 2.0, 3.0), stamp=(NOW[0] + 2, 0))),
    (PoseRefusal.VALUE, POSE_KEY, pose_bytes((2e6, 0.0, 0.0))),
    (PoseRefusal.VALUE, POSE_KEY, pose_bytes((1e300, 0.0, 0.0))),
    (PoseRefusal.COVARIANCE, COVARIANCE_KEY, pose_bytes((1.0, 2.0, 3.0), covariance=covariance(1.0, 2.0, 1.0))),
    (PoseRefusal.COVARIANCE, COVARIANCE_KEY, pose_bytes((1.0, 2.0, 3.0), covariance=covariance(0.0, 0.0, 1.0))),
    (PoseRefusal.COVARIANCE, COVARIANCE_KEY, pose_bytes((1.0, 2.0, 3.0), covariance=covariance(1.0, 0.0, 1.0, -1.0))),
    (
        PoseRefusal.COVARIANCE,
        COVARIANCE_KEY,
        pose_bytes((1.0, 2.0, 3.0), covariance=[1.0, 0.5, *[0.0] * 5, 1.0, *[0.0] * 28]),
    ),
)


def test_what_cannot_be_a_sighting_is_refused_and_counted(subtests: pytest.Subtests) -> None:
    for number, (expected, key, payload) in enumerate(NO_SIGHTINGS):
        with subtests.test(f"{number}: {expected.value}"):
            assert refusal(reader(), key, payload) is expected


def test_nothing_is_sent_to_a_team_that_flies_another_mission_or_of_an_unknown_target() -> None:
    payload = pose_bytes((1.0, 2.0, 3.0))
    assert refusal(reader(), POSE_KEY, payload, team_s=None) is PoseRefusal.TEAM
    assert refusal(reader(target="boat"), POSE_KEY, payload) is PoseRefusal.VALUE


def test_a_flood_is_thinned() -> None:
    """100 in half a second: at most 50 a second pass."""
    reading, payload = reader(), pose_bytes((1.0, 2.0, 3.0))
    for number in range(100):
        with suppress(RefusedError):
            reading.take(POSE_KEY, payload, NOW_S, received_s=100.0 + 0.005 * number)
    assert 20 <= reading.taken <= 26
    assert reading.refused[PoseRefusal.RATE] == 100 - reading.taken
