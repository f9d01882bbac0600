"""The spacing law against the modes of a ring Laplacian, in closed form."""

from math import cos, tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.ring.place import ring_place, scaled_gain_per_s, spacing_decay_per_s, spacing_errors_rad
from estimation.state import Vector

RATE_RAD_S = 0.05
# Angles from each vehicle to the next, then scaled to a whole turn: no two share a bearing.
gaps = st.lists(st.floats(0.01, 1.0), min_size=1, max_size=8)


def rates(bearings: Vector, gain_per_s: float) -> Vector:
    """The angular rate that (22) asks of each vehicle."""
    if len(bearings) == 1:
        return np.array([RATE_RAD_S])
    gain = 2.0 / 3.0 * scaled_gain_per_s(len(bearings), gain_per_s)
    return RATE_RAD_S + gain * np.array(spacing_errors_rad(bearings.tolist()))


def modes_per_s(members: int, gain_per_s: float) -> list[float]:
    """The decay rates of the evenly spaced ring, slowest first: eigenvalues of a numerical Jacobian."""
    even, step = np.arange(members) * tau / members + 0.1, 1e-6
    columns = [
        (rates(even + step * e, gain_per_s) - rates(even - step * e, gain_per_s)) / (2.0 * step)
        for e in np.eye(members)
    ]
    return sorted((-np.linalg.eigvals(np.column_stack(columns)).real).tolist())


@pytest.mark.parametrize("members", [2, 3, 7])
def test_the_slowest_mode_decays_at_the_gain_and_all_of_them_as_a_ring_laplacian(members: int) -> None:
    gain = 0.15
    scaled = 1.5 * gain / (1.0 - cos(tau / members))
    closed_form = [2.0 * scaled / 3.0 * (1.0 - cos(tau * k / members)) for k in range(members)]
    modes = modes_per_s(members, gain)
    assert modes == pytest.approx(sorted(closed_form), abs=1e-7)
    assert modes[1] == pytest.approx(gain)


@pytest.mark.parametrize("members", [11, 20])
def test_the_fastest_mode_of_a_large_ring_is_bounded(members: int) -> None:
    fastest = modes_per_s(members, 0.3)[-1]
    assert fastest == pytest.approx(1.5 * (1.0 - cos(tau * (members // 2) / members)), abs=1e-7)
    assert fastest <= 3.0 + 1e-9


def test_the_stated_decay_of_a_ring_is_that_of_its_slowest_mode(subtests: pytest.Subtests) -> None:
    for members in [2, 3, 12, 24]:
        for gain in [0.05, 1.5]:
            with subtests.test(members=members, gain=gain):
                assert spacing_decay_per_s(members, gain) == pytest.approx(modes_per_s(members, gain)[1], rel=1e-4)


@given(gaps, st.floats(-20.0, 20.0))
def test_neighbours_are_the_adjacent_gaps_wherever_the_ring_is_turned_to(gaps: list[float], turn: float) -> None:
    scaled = np.array(gaps) / np.sum(gaps) * tau
    bearings = np.cumsum(scaled) + turn
    for own in range(len(gaps)):
        place = ring_place(bearings[own], np.delete(bearings, own).tolist())
        assert place.members == len(gaps)
        if len(gaps) > 1:
            assert place.lag_rad == pytest.approx(scaled[own], abs=1e-9)
            assert place.lead_rad == pytest.approx(scaled[(own + 1) % len(gaps)], abs=1e-9)
            error_rad = spacing_errors_rad(bearings.tolist())[own]
            assert error_rad == pytest.approx((scaled[(own + 1) % len(gaps)] - scaled[own]) / 2.0, abs=1e-9)


def test_alone_on_the_ring_there_is_no_spacing_to_keep() -> None:
    place = ring_place(1.0, [])
    assert (place.members, place.lead_rad, place.lag_rad) == (1, None, None)
    assert spacing_errors_rad([1.0]) == [0.0]
