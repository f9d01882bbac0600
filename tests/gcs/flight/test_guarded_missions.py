"""Whole missions under guard, each with its control: what happens when the guard is switched off."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.state import Vector
from gcs.flight.simulated import fly_simulated
from gcs.metrics.record import FlightRecord
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.experiments.random_missions import random_flight
from tests.gcs.flight.test_missions_simulated import apart_m, places_m, section

pytestmark = pytest.mark.slow

CROSSING_S = 64.0
ARRIVED_S = 60.0


def fly(mission: Mission, duration_s: float, **safety: Any) -> FlightRecord:
    return fly_simulated(section("safety", **safety)(mission), 0, duration_s, lambda _: None)


def test_a_random_mission_keeps_separation_fence_and_reach() -> None:
    flight = random_flight(111)
    assert flight.holds, flight
    assert flight.interventions > 0


# Four through one point


def slots_m(mission: Mission) -> Vector:
    return np.array([vehicle.section.slot_m for vehicle in mission.vehicles])


def test_four_swap_through_one_point_and_arrive() -> None:
    mission = load_mission("crossing")
    record = fly(mission, duration_s=CROSSING_S)
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
