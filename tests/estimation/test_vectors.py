"""Clipping a vector, against its direction and length worked out by other means; rounding, against Python's."""

from cmath import phase
from math import hypot

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from estimation.vectors import clipped, clipped_pair, length, rounded

component = st.floats(-1e6, 1e6).filter(lambda value: value == 0.0 or abs(value) > 1e-6)
lengths = st.floats(1e-3, 1e6)


@given(x=component, y=component)
def test_the_length_is_that_of_the_standard_library(x: float, y: float) -> None:
    assert length(x, y) == pytest.approx(hypot(x, y), rel=4e-16, abs=0.0)


@given(x=component, y=component, length_max=lengths)
def test_a_vector_too_long_keeps_its_direction_and_gets_the_length(x: float, y: float, length_max: float) -> None:
    assume(abs(complex(x, y)) > length_max * (1.0 + 1e-9))
    for shorter in (clipped(np.array([x, y]), length_max).tolist(), clipped_pair((x, y), length_max)):
        turned = complex(*shorter)
        assert abs(turned) == pytest.approx(length_max)
        assert phase(turned / complex(x, y)) == pytest.approx(0.0, abs=1e-9)


@given(x=component, y=component, more=st.floats(1.0, 10.0))
def test_a_vector_short_enough_is_the_argument_itself(x: float, y: float, more: float) -> None:
    vector, pair = np.array([x, y]), (x, y)
    length_max = more * (1.0 + 1e-9) * abs(complex(x, y))
    assert clipped(vector, length_max) is vector
    assert clipped_pair(pair, length_max) == pair


halfway = st.builds(lambda whole, digits: (whole + 0.5) / 10.0**digits, st.integers(-(10**6), 10**6), st.integers(0, 9))


@given(st.one_of(st.floats(-1e3, 1e3), st.floats(), halfway), st.integers(0, 9))
def test_rounding_is_pythons(value: float, digits: int) -> None:
    assert rounded(value, digits) == pytest.approx(round(value, digits), abs=0.0, rel=0.0, nan_ok=True)
