"""The mixed team in closed loop: each vehicle with its own profile, true plants 15 % off, plain and shaped."""

from dataclasses import replace

import pytest

from estimation.plant.model import Plant, PlantAxis
from estimation.settings import OwnFilterSettings
from gcs.flight.simulated import fly_simulated
from gcs.metrics.metrics import evaluate
from gcs.metrics.references import formation_reference, ring_reference, verdict_tolerances
from gcs.metrics.result import FlightResult
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission

pytestmark = pytest.mark.slow

OFF = ((1.15, 0.85), (0.85, 1.15), (1.15, 1.15))
"""Shares of a0 and a1 of the vehicles' true plants."""
SHAPED = {"speed_max_m_s": 5.0, "acceleration_max_m_s2": 2.5, "jerk_max_m_s3": 5.0}


def perturbed(mission: Mission) -> Mission:
    def true(plant: Plant, a0: float, a1: float) -> Plant:
        x, y = (PlantAxis(axis.a0_per_s2 * a0, axis.a1_per_s * a1) for axis in (plant.x, plant.y))
        return replace(plant, x=x, y=y)

    pairs = zip(mission.vehicles, OFF, strict=True)
    return replace(mission, vehicles=tuple(replace(each, true_plant=true(each.plant, *off)) for each, off in pairs))


def flown(mission: Mission, duration_s: float) -> FlightResult:
    record = fly_simulated(mission, 0, duration_s, lambda _: None)
    return evaluate(record, ring_reference(mission), formation_reference(mission), verdict_tolerances(mission))


@pytest.mark.parametrize("bounds", [{}, SHAPED], ids=["plain", "shaped"])
def test_the_mixed_team_keeps_its_ring_on_plants_off_their_profiles(bounds: dict[str, float]) -> None:
    mission = perturbed(load_mission("mixed-team"))
    result = flown(replace(mission, simulation=mission.simulation.model_copy(update=bounds)), 200.0)
    verdicts = result.verdicts
    assert (verdicts.c1, verdicts.c2, verdicts.c3, verdicts.separation) == (True, True, True, True)
    for vehicle in result.vehicles:
        assert vehicle.radius_error_rms_m is not None
        assert vehicle.radius_error_rms_m < 0.05


def test_a_wandering_estimate_disturbs_px4s_vehicles_less_with_their_profiles_filter() -> None:
    """Vehicles 1 and 3 are PX4's, whose estimate wanders; the defaults of the filter follow it."""
    mission = load_mission("mixed-team")
    mission = replace(mission, simulation=mission.simulation.model_copy(update={"wander_m": 0.3}))
    plain = tuple(replace(each, own_filter=OwnFilterSettings()) for each in mission.vehicles)
    own, defaults = flown(mission, 100.0), flown(replace(mission, vehicles=plain), 100.0)
    for index in (0, 2):
        before, after = defaults.vehicles[index].radius_error_rms_m, own.vehicles[index].radius_error_rms_m
        assert before is not None
        assert after is not None
        assert after < 0.8 * before
