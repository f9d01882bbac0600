"""The mixed team in closed loop: each vehicle with its own profile, true plants 15 % off and shaped."""

from dataclasses import replace

import pytest

from estimation.settings import OwnFilterSettings
from gcs.mission.file import load_mission
from tests.gcs.flight.test_missions_simulated import flown, plants, section

pytestmark = pytest.mark.slow

OFF = plants((1.15, 0.85, 0.0), (0.85, 1.15, 0.0), (1.15, 1.15, 0.0))
SHAPED = {"speed_max_m_s": 5.0, "acceleration_max_m_s2": 2.5, "jerk_max_m_s3": 5.0}


def test_the_mixed_team_keeps_its_ring_on_plants_off_their_profiles() -> None:
    result = flown(OFF(section("simulation", **SHAPED)(load_mission("mixed-team"))), duration_s=100.0).result
    verdicts = result.verdicts
    assert (verdicts.c1, verdicts.c2, verdicts.c3, verdicts.separation) == (True, True, True, True)
    for vehicle in result.vehicles:
        assert vehicle.radius_error_rms_m is not None
        assert vehicle.radius_error_rms_m < 0.05


def test_a_wandering_estimate_disturbs_px4s_vehicles_less_with_their_profiles_filter() -> None:
    """Vehicles 1 and 3 are PX4's, whose estimate wanders; the defaults of the filter follow it."""
    mission = section("simulation", wander_m=0.3)(load_mission("mixed-team"))
    plain = tuple(replace(each, own_filter=OwnFilterSettings()) for each in mission.vehicles)
    own, defaults = (flown(each, duration_s=60.0).result for each in (mission, replace(mission, vehicles=plain)))
    for index in (0, 2):
        before, after = defaults.vehicles[index].radius_error_rms_m, own.vehicles[index].radius_error_rms_m
        assert before is not None
        assert after is not None
        assert after < 0.8 * before
