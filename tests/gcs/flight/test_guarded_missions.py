"""Whole missions under guard, each with its control: what happens when the guard is switched off."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from estimation.state import Vector
from gcs.flight.simulated import fly_simulated
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.experiments.random_missions import random_flight

CROSSING_S = 64.0
ARRIVED_S = 60.0
CASE1_S, CASE2_S = 300.0, 380.0


def fly(mission: Mission, seed: int = 0, duration_s: float | None = None, **safety: Any) -> FlightRecord:
    changed = replace(mission, safety=mission.safety.model_copy(update=safety))
    return fly_simulated(changed, seed, duration_s or mission.mission.duration_s, lambda _: None)


def places_m(record: FlightRecord) -> Vector:
    """The true positions, (T, N, 2)."""
    return np.stack([track.position_m for track in record.vehicles], axis=1)


def apart_m(record: FlightRecord) -> Vector:
    """The distance of the closest pair, (T,)."""
    places = places_m(record)
    pairs = [places[:, one] - places[:, other] for one, other in combinations(range(places.shape[1]), 2)]
    return np.asarray(np.linalg.norm(pairs, axis=-1).min(axis=0))


@pytest.mark.parametrize("seed", [93, 111, 12])
def test_a_random_mission_keeps_separation_fence_and_reach(seed: int) -> None:
    flight = random_flight(seed)
    assert flight.holds, flight
    assert flight.interventions > 0


# Four through one point


def slots_m(mission: Mission) -> Vector:
    return np.array([vehicle.section.slot_m for vehicle in mission.vehicles])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_four_swap_through_one_point_and_arrive(seed: int) -> None:
    mission = load_mission("crossing")
    record = fly(mission, seed, CROSSING_S)
    assert apart_m(record).min() >= mission.safety.separation_m == 3.0
    late = record.time_s >= ARRIVED_S
    off_m = np.linalg.norm(places_m(record)[late] - slots_m(mission), axis=-1)
    assert off_m.max() < 0.5


def test_without_the_guard_the_four_collide() -> None:
    record = fly(load_mission("crossing"), duration_s=20.0, guard=False)
    assert apart_m(record).min() < 1.0
    assert record.guard is not None
    assert set(record.guard.causes) <= {"reach"}


def test_on_heights_of_their_own_they_cross_without_minding_each_other() -> None:
    mission = load_mission("crossing")
    stacked = tuple(
        replace(vehicle, section=vehicle.section.model_copy(update={"altitude_m": 8.0 + 2.5 * index}))
        for index, vehicle in enumerate(mission.vehicles)
    )
    record = fly(replace(mission, vehicles=stacked), duration_s=20.0)
    assert apart_m(record).min() < 1.0
    assert record.guard is not None
    assert "separation" not in record.guard.causes


# The paper's missions


@pytest.fixture(scope="module")
def case1() -> FlightRecord:
    return fly(load_mission("case1"), duration_s=CASE1_S)


def test_case1_keeps_three_metres_and_without_the_guard_not_two(case1: FlightRecord) -> None:
    assert apart_m(case1).min() >= 3.0
    assert apart_m(fly(load_mission("case1"), duration_s=CASE1_S, guard=False)).min() < 2.0


def test_case1_recovers_from_its_encounters(case1: FlightRecord) -> None:
    """As exact as ever from 10 s after an encounter until 6 s before the next: the guard looks ahead."""
    time_s, (first, second, third) = case1.time_s, case1.vehicles
    engaged = first.tactic == "encircle"
    met = engaged & (apart_m(case1) < 4.0)
    assert 50 < met.sum() < 300
    since_s = time_s - np.maximum.accumulate(np.where(met, time_s, -np.inf))
    until_s = np.minimum.accumulate(np.where(met, time_s, np.inf)[::-1])[::-1] - time_s
    calm = engaged & (since_s > 10.0) & (until_s > 6.0) & (time_s > time_s[engaged][0] + 10.0)
    assert calm.sum() > 1000
    off_m = np.linalg.norm(first.position_m - case1.target_position_m, axis=1) - 10.0
    assert np.sqrt(np.mean(off_m[calm] ** 2)) <= 0.03
    np.testing.assert_allclose(second.velocity_m_s[calm], np.tile((0.2, 0.0), (calm.sum(), 1)), atol=0.02)
    np.testing.assert_allclose(
        (second.position_m - third.position_m)[calm], np.tile((0.0, 5.0), (calm.sum(), 1)), atol=0.02
    )


def test_case2_is_flown_as_if_there_were_no_guard() -> None:
    mission = load_mission("case2")
    guarded, unguarded = (fly(mission, duration_s=CASE2_S, guard=guard) for guard in (True, False))
    late = guarded.time_s >= 320.0
    for track, twin in zip(guarded.vehicles, unguarded.vehicles, strict=True):
        assert (track.tactic == twin.tactic).all()  # the engagements, to the tick
        off_m = [
            np.linalg.norm(each.position_m[late] - guarded.target_position_m[late], axis=1) - 10.0
            for each in (track, twin)
        ]
        rms_m = np.sqrt(np.mean(np.square(off_m), axis=1))
        assert rms_m[0] == pytest.approx(rms_m[1], abs=1e-3)
    spacings_rad = [_spacings_rad(record)[late] for record in (guarded, unguarded)]
    assert spacings_rad[0] == pytest.approx(spacings_rad[1], abs=1e-3)


def _spacings_rad(record: FlightRecord) -> Vector:
    offsets = places_m(record) - record.target_position_m[:, None]
    turns = np.sort(np.arctan2(offsets[..., 1], offsets[..., 0]), axis=1)
    return np.diff(turns, axis=1, append=turns[:, :1] + 2.0 * np.pi)
