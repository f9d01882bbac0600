"""The simulated target and the sensors that see it."""

from math import inf

import numpy as np
import pytest

from estimation.state import Sighting
from sitl.world import SensorModel, SimulatedSensor, TargetMotion

TARGET = TargetMotion((35.0, -5.0), (0.1, -0.2))
IDEAL = SensorModel(range_m=15.0, rate_hz=5.0, noise_m=0.0, importance=0.8, threat=0.2)
NOISY = SensorModel(range_m=inf, rate_hz=10.0, noise_m=0.3, importance=0.8, threat=0.2)


def look(sensor: SimulatedSensor, seconds: float, rate_hz: float = 10.0) -> list[Sighting]:
    """What a sensor beside the target's start sees, asked at every tick of a loop."""
    ticks = range(round(seconds * rate_hz))
    seen = [sensor.sight(tick / rate_hz, (35.0, -5.0)) for tick in ticks]
    return [one for one in seen if one is not None]


@pytest.mark.parametrize(("time_s", "place"), [(-3.0, (35.0, -5.0)), (0.0, (35.0, -5.0)), (10.0, (36.0, -7.0))])
def test_the_target_sets_out_when_the_mission_does(time_s: float, place: tuple[float, float]) -> None:
    assert TARGET.position_m(time_s) == pytest.approx(place)


def test_an_ideal_sensor_sees_the_truth_and_knows_that_it_is_not_quite() -> None:
    sensor = SimulatedSensor(2, IDEAL, TARGET, start_s=100.0, seed=0)
    assert sensor.sight(110.0, (30.0, 0.0)) == Sighting(110.0, 2, (36.0, -7.0), (1e-4, 0.0, 1e-4), 0.8, 0.2)


@pytest.mark.parametrize(("distance", "seen"), [(14.99, True), (15.01, False)])
def test_a_sensor_sees_as_far_as_it_does(distance: float, seen: bool) -> None:
    sensor = SimulatedSensor(1, IDEAL, TARGET, 0.0, seed=0)
    x, y = np.array([35.0, -5.0]) + distance * np.array([0.6, -0.8])
    assert (sensor.sight(0.0, (x, y)) is not None) is seen


@pytest.mark.parametrize(("rate_hz", "period_s"), [(5.0, 0.2), (10.0, 0.1), (2.0, 0.5), (50.0, 0.1)])
def test_a_sensor_looks_at_its_rate_however_often_it_is_asked(rate_hz: float, period_s: float) -> None:
    model = SensorModel(inf, rate_hz, 0.0, 0.8, 0.2)
    times_s = [one.time_s for one in look(SimulatedSensor(1, model, TARGET, 0.0, seed=0), 100.0)]
    assert np.diff(times_s) == pytest.approx(period_s)


def test_noise_is_white_of_the_size_stated_and_the_covariance_says_so() -> None:
    seen = look(SimulatedSensor(1, NOISY, TargetMotion((35.0, -5.0), (0.0, 0.0)), 0.0, seed=3), 400.0)
    errors = np.array([one.position_m for one in seen]) - [35.0, -5.0]
    assert len(errors) == 4000
    assert errors.mean(axis=0) == pytest.approx(0.0, abs=4.0 * 0.3 / 4000**0.5)
    assert np.cov(errors.T) == pytest.approx(np.eye(2) * 0.09, abs=0.09 * 4.0 * (2.0 / 4000) ** 0.5)
    assert np.corrcoef(errors[1:, 0], errors[:-1, 0])[0, 1] == pytest.approx(0.0, abs=4.0 / 4000**0.5)
    assert {one.covariance_m2 for one in seen} == {(0.09, 0.0, 0.09)}


def test_seeds_and_sensors_have_noise_of_their_own_and_the_same_one_again() -> None:
    flights = [
        look(SimulatedSensor(sensor, NOISY, TARGET, 0.0, seed), 2.0)
        for sensor, seed in ((1, 7), (1, 7), (2, 7), (1, 8))
    ]
    assert flights[0] == flights[1]
    assert flights[0][0].position_m not in {flights[2][0].position_m, flights[3][0].position_m}
