"""A coordinate within its bounds, against the fastest motion that they allow."""

from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.ring.transition import ShapedCoordinate

STEP_S = 0.1


def followed(start: ShapedCoordinate, wanted: float, acceleration: float, jerk: float, steps: int) -> np.ndarray:
    """Return value, rate and acceleration (steps + 1, 3)."""
    each, track = start, [start]
    for _ in range(steps):
        each = each.follow(wanted, acceleration, jerk, STEP_S)
        track.append(each)
    return np.array([[each.value, each.rate, each.acceleration] for each in track])


@given(
    rate=st.floats(-3.0, 3.0), wanted=st.floats(-3.0, 3.0), acceleration=st.floats(0.05, 2.0), jerk=st.floats(0.05, 5.0)
)
def test_bounds_are_kept_and_the_rate_arrives_without_overshoot(
    rate: float, wanted: float, acceleration: float, jerk: float
) -> None:
    # The fastest: the jerk up, the acceleration held, the jerk down. A triangle where it is not reached.
    missing = abs(wanted - rate)
    fastest_s = missing / acceleration + acceleration / jerk
    if missing < acceleration**2 / jerk:
        fastest_s = 2.0 * (missing / jerk) ** 0.5
    steps = int(fastest_s / STEP_S) + 10
    track = followed(ShapedCoordinate(0.0, rate), wanted, acceleration, jerk, steps)
    assert np.abs(track[:, 2]).max() <= acceleration + 1e-9
    assert np.abs(np.diff(track[:, 2])).max() <= jerk * STEP_S + 1e-9
    assert track[:, 1].min() >= min(rate, wanted) - 1e-9
    assert track[:, 1].max() <= max(rate, wanted) + 1e-9
    assert track[-1, 1] == pytest.approx(wanted, abs=jerk * STEP_S**2)
    assert np.diff(track[:, 0]) == pytest.approx((track[1:, 1] + track[:-1, 1]) / 2.0 * STEP_S, abs=1e-9)


def test_a_rate_that_changes_slowly_is_followed_exactly() -> None:
    each = ShapedCoordinate(0.0, 1.0, -0.01)
    for tick in range(1, 50):
        wanted = 1.0 - 0.01 * tick * STEP_S
        each = each.follow(wanted, 0.3, 0.5, STEP_S)
        assert each.rate == pytest.approx(wanted, abs=1e-12)


def test_it_stays_near_what_it_leads() -> None:
    each = ShapedCoordinate(5.0, 1.0, 0.2)
    for leader, expected in (
        ((4.8, 0.0, 0.5, 1.0), (5.0, 1.0, 0.2)),
        ((3.0, 0.0, 0.5, 1.0), (3.5, 1.0, 0.2)),
        ((9.0, 0.0, inf, 0.25), (8.0, 0.25, 0.2)),
        ((4.0, 0.4, 0.5, 0.0), (4.0, 0.4, 0.2)),
    ):
        near = each.near(*leader)
        assert (near.value, near.rate, near.acceleration) == expected
