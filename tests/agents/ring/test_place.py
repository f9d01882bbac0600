"""The spacing law against the paper's two conditions and its decay, in closed form."""

from collections.abc import Callable
from math import cos, tau
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.ring.place import place_errors_rad, ring_place
from estimation.state import Vector

# Angles from each vehicle to the next, then scaled to a whole turn: no two are about at one bearing.
gaps = st.lists(st.floats(0.02, 1.0), min_size=1, max_size=8)


@given(gaps, st.floats(-20.0, 20.0))
def test_the_law_is_the_one_solution_of_the_papers_two_conditions(gaps: list[float], turn: float) -> None:
    """(19): neighbours' rates differ by -gamma times the error of their spacing; (21): the mean rate is the ring's."""
    count, gain_per_s, ring_rad_s = len(gaps), 0.3, 0.05
    ahead = np.array(gaps) / np.sum(gaps) * tau
    bearings = np.cumsum(ahead) - ahead[0] + turn
    differences = np.roll(np.eye(count), 1, axis=1) - np.eye(count)  # the rate of the next minus one's own
    wanted = -gain_per_s * (np.roll(ahead, -1) - tau / count)
    conditions = np.vstack([differences, np.full((1, count), 1.0 / count)])
    rates, *_ = np.linalg.lstsq(conditions, np.append(wanted, ring_rad_s), rcond=None)
    errors = np.array(place_errors_rad(bearings.tolist(), range(1, count + 1)))
    assert ring_rad_s + gain_per_s * errors == pytest.approx(rates, abs=1e-9)
    if count == 3:  # (22)
        assert errors == pytest.approx((np.roll(ahead, -1) - ahead) / 3.0, abs=1e-9)


@given(
    ids=st.lists(st.integers(1, 254), min_size=2, max_size=12, unique=True),
    at_rad=st.sampled_from([0.0, tau]) | st.floats(-20.0, 20.0),
    off_rad=st.lists(st.floats(-9e-4, 9e-4), min_size=144, max_size=144),
)
def test_a_column_of_vehicles_at_one_bearing_is_spread_in_the_order_of_their_ids(
    ids: list[int], at_rad: float, off_rad: list[float]
) -> None:
    """Each computes its own place, from bearings of which it knows each a little differently, in any order."""
    count, views, places = len(ids), iter(off_rad), {}
    for own, vehicle_id in enumerate(ids):
        members = [vehicle_id, *ids[:own], *ids[own + 1 :]]
        places[vehicle_id] = at_rad + place_errors_rad([at_rad + next(views) for _ in members], members)[0]
    in_order = [places[each] for each in sorted(ids)]
    assert np.diff(in_order) == pytest.approx(tau / count, abs=4e-3)
    assert np.mean(in_order) == pytest.approx(at_rad, abs=2e-3)


@given(gaps, st.floats(-20.0, 20.0), st.randoms(use_true_random=False))
def test_every_vehicle_computes_the_same_places(gaps: list[float], turn: float, random: Random) -> None:
    ahead = np.array(gaps) / np.sum(gaps) * tau
    members = list(zip((np.cumsum(ahead) + turn).tolist(), random.sample(range(1, 255), len(gaps)), strict=True))

    def computed() -> dict[int, float]:
        random.shuffle(members)
        bearings_rad, ids = zip(*members, strict=True)
        return dict(zip(ids, place_errors_rad(bearings_rad, ids), strict=True))

    assert computed() == pytest.approx(computed(), abs=1e-9)


@pytest.mark.parametrize("members", [2, 3, 6, 12, 24, 32])
def test_every_deviation_of_any_number_of_vehicles_decays_alike(members: int) -> None:
    assert modes(lambda bearings: place_errors_rad(bearings, range(members)), members) == pytest.approx(
        [0.0, *[1.0] * (members - 1)], abs=1e-7
    )


@pytest.mark.parametrize("members", [3, 8])
def test_the_law_between_neighbours_decays_as_a_ring_laplacian(members: int) -> None:
    closed_form = [2.0 / 3.0 * (1.0 - cos(tau * k / members)) for k in range(members)]
    assert modes(neighbour_errors_rad, members) == pytest.approx(sorted(closed_form), abs=1e-7)


def neighbour_errors_rad(bearings_rad: list[float]) -> list[float]:
    others = [bearings_rad[:own] + bearings_rad[own + 1 :] for own in range(len(bearings_rad))]
    return [ring_place(own, rest).error_rad for own, rest in zip(bearings_rad, others, strict=True)]


def modes(law: Callable[[list[float]], list[float]], members: int) -> list[float]:
    """The decay rates about the evenly spaced ring for a gain of 1, slowest first, by a numerical Jacobian."""
    even, step = np.arange(members) * tau / members + 0.1, 1e-6

    def errors(bearings: Vector) -> Vector:
        return np.array(law(bearings.tolist()))

    columns = [(errors(even + step * e) - errors(even - step * e)) / (2.0 * step) for e in np.eye(members)]
    return sorted((-np.linalg.eigvals(np.column_stack(columns)).real).tolist())


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


def test_alone_on_the_ring_there_is_no_spacing_to_keep() -> None:
    place = ring_place(1.0, [])
    assert (place.members, place.lead_rad, place.lag_rad) == (1, None, None)
    assert place.error_rad == 0.0
    assert place_errors_rad([1.0], [7]) == [0.0]
