"""Sightings from outside the team: what they become, and what is refused, counted and told once."""

import json
from math import hypot, radians
from typing import Any

import numpy as np
import pytest

from agents.team.perception import (
    SOURCES_FROM,
    Perception,
    Refusal,
)
from estimation.frames import Geodetic, MissionFrame

NOW_S = 1000.0
EARTH = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), radians(90.0))
LOCAL = MissionFrame(None)
GOOD = {
    "frame": "mission",
    "position": [35.0, -5.0],
    "covariance_m2": [0.25, 0.1, 1.0],
    "importance": 0.8,
    "threat": 0.2,
    "time_s": 999.5,
    "source": 7,
}


def take(
    changes: dict[str, object] | None = None, where: MissionFrame = EARTH, time_scale: float = 1.0
) -> tuple[Any, Perception, list[str]]:
    told: list[str] = []
    perception = Perception(where, told.append)
    content = {key: value for key, value in (GOOD | (changes or {})).items() if value is not ...}
    return perception.take(json.dumps(content).encode(), NOW_S, time_scale), perception, told


def test_a_sighting_in_the_missions_frame_is_taken_as_it_is() -> None:
    sighting, perception, told = take()
    assert (sighting.time_s, sighting.sensor_id) == (999.5, SOURCES_FROM + 7)
    assert (sighting.position_m, sighting.covariance_m2) == ((35.0, -5.0), (0.25, 0.1, 1.0))
    assert (sighting.importance, sighting.threat) == (0.8, 0.2)
    assert not perception.refused
    assert told == []


@pytest.mark.parametrize("frame", [{}, {"frame": "geodetic", "position": [47.3978, 8.5457]}])
def test_an_altitude_is_above_the_missions_origin_in_either_frame(frame: dict[str, object]) -> None:
    assert take(frame)[0].altitude_m is None
    sighting, _, _ = take({**frame, "altitude_m": -3.5, "altitude_sigma_m": 0.2})
    assert (sighting.altitude_m, sighting.altitude_sigma_m) == (-3.5, 0.2)


def test_a_geodetic_one_is_turned_into_the_missions_frame_with_its_covariance() -> None:
    """With x east and y north: by hand, on a sphere of the Earth's curvature here."""
    sighting, _, _ = take(
        {"frame": "geodetic", "position": [47.397742 + 1e-4, 8.545594 + 2e-4], "covariance_m2": [4.0, 0.5, 1.0]}
    )
    x, y = sighting.position_m
    assert y == pytest.approx(1e-4 * 111175.0, rel=1e-3)
    assert x == pytest.approx(2e-4 * 111320.0 * np.cos(radians(47.3977)), rel=3e-3)
    assert sighting.covariance_m2 == pytest.approx((1.0, 0.5, 4.0))


def test_a_covariance_keeps_its_size_and_shape_however_the_mission_lies() -> None:
    slanted = MissionFrame(EARTH.origin, radians(30.0))
    sighting, _, _ = take(
        {"frame": "geodetic", "position": [47.3978, 8.5457], "covariance_m2": [4.0, 0.0, 1e-6]}, slanted
    )
    xx, xy, yy = sighting.covariance_m2
    (x, y), spread = slanted.mission_from_ned((1.0, 0.0, 0.0))[:2], np.array([[xx, xy], [xy, yy]])
    assert np.linalg.eigvalsh(spread) == pytest.approx([1e-6, 4.0])
    assert spread @ (x, y) == pytest.approx([4.0 * x, 4.0 * y])
    assert hypot(x, y) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("changes", "refusal"),
    [
        ({"frame": "utm"}, Refusal.FRAME),
        ({"frame": ""}, Refusal.FRAME),
        ({"time_s": 1001.5}, Refusal.FUTURE),
        ({"covariance_m2": [0.0, 0.0, 1.0]}, Refusal.COVARIANCE),
        ({"covariance_m2": [1.0, 1.0, 1.0]}, Refusal.COVARIANCE),
        ({"covariance_m2": [-1.0, 0.0, -1.0]}, Refusal.COVARIANCE),
        ({"covariance_m2": [1e-200, 0.0, 1e-200]}, Refusal.COVARIANCE),
        ({"covariance_m2": [1e200, 1e200, 1e200]}, Refusal.MALFORMED),
        ({"covariance_m2": [1e300, 0.0, 1e300]}, Refusal.MALFORMED),
        ({"position": [1e200, 0.0]}, Refusal.AWAY),
        ({"position": [0.0, -1.1e6]}, Refusal.AWAY),
        ({"frame": "geodetic", "position": [-47.0, -171.0]}, Refusal.AWAY),
        ({"covariance_m2": [1.0, 0.0]}, Refusal.MALFORMED),
        ({"covariance_m2": ...}, Refusal.MALFORMED),
        ({"position": [1e400, 0.0]}, Refusal.MALFORMED),
        ({"position": ["35", 0.0]}, Refusal.MALFORMED),
        ({"frame": "geodetic", "position": [91.0, 8.0]}, Refusal.MALFORMED),
        ({"importance": 1.1}, Refusal.MALFORMED),
        ({"threat": -0.1}, Refusal.MALFORMED),
        ({"source": -1}, Refusal.MALFORMED),
        ({"height_m": 3.0}, Refusal.MALFORMED),
        ({"altitude_m": "3"}, Refusal.MALFORMED),
        ({"altitude_m": 3.0, "altitude_sigma_m": 0.0}, Refusal.MALFORMED),
    ],
)
def test_what_no_sighting_can_be_is_refused_with_the_reason(changes: dict[str, object], refusal: Refusal) -> None:
    sighting, perception, told = take(changes)
    assert sighting is None
    assert perception.refused == {refusal: 1}
    assert len(told) == 1
    assert refusal.value in told[0]


def test_a_geodetic_one_is_refused_where_the_mission_lies_nowhere() -> None:
    sighting, perception, _ = take({"frame": "geodetic", "position": [47.0, 8.0]}, LOCAL)
    assert sighting is None
    assert perception.refused == {Refusal.NOWHERE: 1}


@pytest.mark.parametrize("payload", [b"{", b"{}", b"{" * 4000, b'{"frame": "\xff"}', b"[1, 2]"])
def test_nonsense_is_refused(payload: bytes) -> None:
    perception = Perception(EARTH, lambda _: None)
    assert perception.take(payload, NOW_S, 1.0) is None
    assert perception.refused == {Refusal.MALFORMED: 1}


def test_a_reason_is_reported_once_and_counted_every_time() -> None:
    told: list[str] = []
    perception = Perception(EARTH, told.append)
    for _ in range(5):
        for changes in ({"frame": "utm"}, {"time_s": 2000.0}):
            perception.take(json.dumps(GOOD | changes).encode(), NOW_S, 1.0)
    assert perception.refused == {Refusal.FRAME: 5, Refusal.FUTURE: 5}
    assert len(told) == 2


def test_a_sighting_names_one_of_several_targets_or_none() -> None:
    told: list[str] = []
    perception = Perception(EARTH, told.append, ("north", "south"))
    for name in (None, "south", "nort", "south\n", "north"):
        given = GOOD if name is None else GOOD | {"target": name}
        sighting = perception.take(json.dumps(given).encode(), NOW_S, 1.0)
        known = name in (None, "north", "south")
        assert (sighting is not None) is known
        assert sighting is None or sighting.target == name
    assert perception.refused == {Refusal.TARGET: 2}
    assert len(told) == 1
    assert "'nort', known: north, south" in told[0]


def test_the_only_target_has_no_name() -> None:
    sighting, perception, told = take({"target": "north"})
    assert sighting is None
    assert perception.refused == {Refusal.TARGET: 1}
    assert "leave it out" in told[0]
    assert take()[0].target is None
