"""Rings that cut each other, against points sampled on both circles over the mission."""

from math import pi, tau

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.settings.sections import EncirclementSettings
from gcs.mission.tubes import TRACKING_M, Tube, nearest_m
from sitl.world import Leg, TargetMotion
from tests.gcs.mission.test_rings import SEVERAL, STACK
from tests.support.mission_text import Content, faults, parsed, put

DURATION_S = 60.0


def tube(radius_m: float, target: TargetMotion) -> Tube:
    return Tube(0, EncirclementSettings(radius_m=radius_m, angular_rate_rad_s=0.1), target, is_shared=False)


coordinates = st.floats(-40.0, 40.0)
spots = st.tuples(coordinates, coordinates)
radii = st.floats(1.0, 20.0)
still = st.builds(TargetMotion, spots)
steady = st.builds(TargetMotion, spots, st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)))
legs = st.lists(st.builds(Leg, spots, st.floats(0.5, 5.0), st.floats(0.0, 10.0)), min_size=1, max_size=3).map(tuple)
along_legs = st.builds(lambda start, way: TargetMotion(start, legs=way), spots, legs)
motions = st.one_of(still, steady, along_legs)

POINTS, TIMES = 90, 601
TURN_RAD = np.arange(POINTS) * tau / POINTS
CIRCLE = np.stack([np.cos(TURN_RAD), np.sin(TURN_RAD)], axis=-1)


def sampled_m(one: Tube, other: Tube) -> float:
    """Return the least distance of a point of one circle from the other circle, over all times and points."""
    times_s = np.linspace(0.0, DURATION_S, TIMES)
    (centre_m, _), (other_m, _) = (each.target.over(times_s) for each in (one, other))
    points_m = centre_m[:, None] + one.ring.radius_m * CIRCLE
    return float(np.abs(np.hypot(*np.moveaxis(points_m - other_m[:, None], -1, 0)) - other.ring.radius_m).min())


@settings(max_examples=150, deadline=None)
@given(radii, radii, motions, motions)
def test_the_distance_of_two_rings_is_the_least_of_all_their_points(
    radius_m: float, other_m: float, target: TargetMotion, other: TargetMotion
) -> None:
    one, two = tube(radius_m, target), tube(other_m, other)
    exact_m, at_s = nearest_m(one, two, DURATION_S)
    least_m = sampled_m(one, two)
    fastest_m_s = target.speed_max_m_s + other.speed_max_m_s
    # A sample is off by half a step of angle and of time at most.
    between_m = radius_m * pi / POINTS + fastest_m_s * DURATION_S / (TIMES - 1) / 2.0
    assert exact_m - 1e-6 <= least_m <= exact_m + between_m + 1e-6
    centres_m = [np.array(each.target.position_m(at_s)) for each in (one, two)]
    points_m = centres_m[0] + radius_m * CIRCLE
    there_m = np.abs(np.hypot(*(points_m - centres_m[1]).T) - other_m).min()
    assert 0.0 <= at_s <= DURATION_S
    assert there_m == pytest.approx(exact_m, abs=radius_m * pi / POINTS + 1e-6)


def stacked(radius_m: float, altitude_m: float, **others: object) -> Content:
    return put(
        STACK, ("rings", 1), {"name": "high", "places": 3, "radius_m": radius_m, "altitude_m": altitude_m, **others}
    )


def test_rings_are_apart_in_radius_or_in_height(subtests: pytest.Subtests) -> None:
    """With 3 m of separation, 2 m in height, and vehicles at 8 m; the other ring has 10 m at their flying height."""
    needed_m = 3.0 + TRACKING_M
    for words, other, fits in (
        ("in one place", stacked(10.0, 8.0), False),
        ("above", stacked(10.0, 10.0), True),
        ("a little above", stacked(10.0, 9.9), False),
        ("below", stacked(10.0, 6.0), True),
        ("around", stacked(10.0 + needed_m, 8.0), True),
        ("closely around", stacked(10.0 + needed_m - 0.01, 8.0), False),
        ("inside", stacked(10.0 - needed_m, 8.0), True),
        ("shared", stacked(10.0, 8.0, shared=True), True),
        ("above and tilted down to it", stacked(10.0, 12.0, tilt_deg=15.0), False),  # 2.7 m down
        ("above and tilted", stacked(10.0, 12.0, tilt_deg=10.0), True),  # 1.8 m down
        ("above vehicles that fly higher", put(stacked(10.0, 11.0), ("vehicles", 1, "altitude_m"), 9.5), False),
        ("far above vehicles that fly higher", put(stacked(10.0, 11.5), ("vehicles", 1, "altitude_m"), 9.5), True),
    ):
        with subtests.test(words):
            if fits:
                assert len(parsed(other).rings) == 2
            else:
                assert [fault.partition(": ")[0] for fault in faults(other)] == ["rings[1]"]


def test_targets_that_meet_are_found_with_the_time() -> None:
    """The southern target comes north at 0.4 m/s: 40 - 0.4 t is 18 + 3.5 after 46.25 s, and 0 in all after 55 s."""
    meeting = put(SEVERAL, ("targets", 1, "velocity_m_s"), [0.0, 0.4])
    fault = faults(meeting)[0]
    assert fault.startswith("rings[1]: 0.00 m from rings[0] after ")
    assert parsed(put(meeting, ("mission", "duration_s"), 46.0)).rings
    assert "0.00 m" not in faults(put(meeting, ("mission", "duration_s"), 47.0))[0]
