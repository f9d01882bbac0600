"""The spacing law against the paper's two conditions and its decay, in closed form."""

from collections.abc import Callable
from functools import partial
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
eight_weights = st.just([1.0] * 8) | st.lists(st.floats(0.1, 10.0), min_size=8, max_size=8)
"""Of the wanted gaps ahead of the vehicles: even, or each another."""


def wanted_rad(weights: list[float]) -> Vector:
    return np.asarray(np.array(weights) / np.sum(weights) * tau)


@given(gaps, st.floats(-20.0, 20.0), eight_weights)
def test_the_law_is_the_one_solution_of_the_papers_two_conditions(
    gaps: list[float], turn: float, eight_weights: list[float]
) -> None:
    """(19): neighbours' rates differ by -gamma times the error of their spacing; (21): the mean rate is the ring's."""
    count, gain_per_s, ring_rad_s, weights = len(gaps), 0.3, 0.05, eight_weights[: len(gaps)]
    ahead = np.array(gaps) / np.sum(gaps) * tau
    bearings = np.cumsum(ahead) - ahead[0] + turn
    differences = np.roll(np.eye(count), 1, axis=1) - np.eye(count)  # the rate of the next minus one's own
    wanted = -gain_per_s * (np.roll(ahead, -1) - wanted_rad(weights))
    conditions = np.vstack([differences, np.full((1, count), 1.0 / count)])
    rates, *_ = np.linalg.lstsq(conditions, np.append(wanted, ring_rad_s), rcond=None)
    errors = np.array(place_errors_rad(bearings.tolist(), range(1, count + 1), dict(enumerate(weights, 1))))
    assert ring_rad_s + gain_per_s * errors == pytest.approx(rates, abs=1e-9)
    if count == 3 and min(weights) == max(weights):  # (22)
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


@given(gaps, st.floats(-20.0, 20.0), eight_weights, st.randoms(use_true_random=False))
def test_every_vehicle_computes_the_same_places(
    gaps: list[float], turn: float, eight_weights: list[float], random: Random
) -> None:
    ahead = np.array(gaps) / np.sum(gaps) * tau
    members = list(zip((np.cumsum(ahead) + turn).tolist(), random.sample(range(1, 255), len(gaps)), strict=True))
    weights = dict(zip((each for _, each in members), eight_weights, strict=False))

    def computed() -> dict[int, float]:
        random.shuffle(members)
        bearings_rad, ids = zip(*members, strict=True)
        return dict(zip(ids, place_errors_rad(bearings_rad, ids, weights), strict=True))

    assert computed() == pytest.approx(computed(), abs=1e-9)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("members", [2, 3, 6, 12, 24, 32])
def test_every_deviation_of_any_number_of_vehicles_decays_alike(members: int, uneven: bool) -> None:
    """About the wanted gaps, at which no error is left."""
    weights = [1.0 + uneven * (each % 3) for each in range(members)]
    gaps = dict(enumerate(weights))
    assert modes(lambda bearings: place_errors_rad(bearings, range(members), gaps), weights) == pytest.approx(
        [0.0, *[1.0] * (members - 1)], abs=1e-7
    )


@pytest.mark.parametrize("members", [3, 8])
def test_the_law_between_neighbours_decays_as_a_ring_laplacian(members: int) -> None:
    closed_form = [2.0 / 3.0 * (1.0 - cos(tau * k / members)) for k in range(members)]
    weights = [1.0] * members
    assert modes(partial(neighbour_errors_rad, weights), weights) == pytest.approx(sorted(closed_form), abs=1e-7)


def test_the_law_between_neighbours_leads_to_uneven_gaps_as_well() -> None:
    weights = [2.0, 1.0, 0.5, 1.0, 3.0]
    slowest, *others = modes(partial(neighbour_errors_rad, weights), weights)
    assert slowest == pytest.approx(0.0, abs=1e-7)
    assert min(others) > 0.1


def neighbour_errors_rad(weights: list[float], bearings_rad: list[float]) -> list[float]:
    def without(values: list[float], own: int) -> list[float]:
        return [*values[:own], *values[own + 1 :]]

    return [
        ring_place(bearing, without(bearings_rad, own), [weights[own], *without(weights, own)]).error_rad
        for own, bearing in enumerate(bearings_rad)
    ]


def modes(law: Callable[[list[float]], list[float]], weights: list[float]) -> list[float]:
    """The decay rates about the ring with the wanted gaps for a gain of 1, slowest first, by a numerical Jacobian."""
    wanted, step = np.append(0.0, np.cumsum(wanted_rad(weights))[:-1]) + 0.1, 1e-6

    def errors(bearings: Vector) -> Vector:
        return np.array(law(bearings.tolist()))

    assert errors(wanted) == pytest.approx(0.0, abs=1e-9)
    columns = [(errors(wanted + step * e) - errors(wanted - step * e)) / (2.0 * step) for e in np.eye(len(weights))]
    return sorted((-np.linalg.eigvals(np.column_stack(columns)).real).tolist())


@given(gaps, st.floats(-20.0, 20.0), eight_weights)
def test_neighbours_are_the_adjacent_gaps_wherever_the_ring_is_turned_to(
    gaps: list[float], turn: float, eight_weights: list[float]
) -> None:
    scaled = np.array(gaps) / np.sum(gaps) * tau
    bearings, weights = np.cumsum(scaled) + turn, eight_weights[: len(gaps)]
    wanted = wanted_rad(weights)
    for own in range(len(gaps)):
        others, of_others = np.delete(bearings, own).tolist(), np.delete(weights, own).tolist()
        place = ring_place(bearings[own], others, [weights[own], *of_others])
        assert place.members == len(gaps)
        if len(gaps) > 1:
            assert place.lag_rad == pytest.approx(scaled[own], abs=1e-9)
            assert place.lead_rad == pytest.approx(scaled[(own + 1) % len(gaps)], abs=1e-9)
            assert (place.desired_rad, place.desired_lag_rad) == pytest.approx((wanted[own], wanted[own - 1]))


def test_alone_on_the_ring_there_is_no_spacing_to_keep() -> None:
    place = ring_place(1.0, [])
    assert (place.members, place.lead_rad, place.lag_rad) == (1, None, None)
    assert place.error_rad == 0.0
    assert place_errors_rad([1.0], [7]) == [0.0]
