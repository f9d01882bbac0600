"""The nearest point in half-planes and a disc, against a general solver."""

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from agents.safety.guard import HalfPlane, nearest
from tests.support.solver import slsqp

Pair = tuple[float, float]
RADIUS_M, MARGIN_M = 6.0, 1e-3


@given(
    st.lists(st.tuples(st.floats(-pi, pi), st.floats(-5.0, 1.0)), max_size=12),
    st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)),
)
def test_the_nearest_point_in_half_planes_is_what_slsqp_finds(bounds: list[tuple[float, float]], wanted: Pair) -> None:
    planes = [HalfPlane((cos(turn), sin(turn)), least) for turn, least in bounds]
    normals, least = np.array([plane.normal for plane in planes]).reshape(-1, 2), np.array([each for _, each in bounds])
    expected, narrower = (
        slsqp(np.array(wanted), RADIUS_M - margin_m, normals, least + margin_m) for margin_m in (0.0, MARGIN_M)
    )
    assume((expected is None) is (narrower is None))  # a set of hardly any points is a matter of rounding
    point = nearest(wanted, RADIUS_M, planes)
    assert point is None if expected is None else point == pytest.approx(expected, abs=1e-4)
