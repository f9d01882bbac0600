"""The simulated target and the sensors that see it."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from estimation.state import Sighting
from gcs.mission.file import load_mission
from gcs.mission.simulation import target_sensor
from sitl.world import Leg, SensorModel, SimulatedSensor, TargetMotion
from tests.gcs.mission.test_rings import SEVERAL, STACK
from tests.support.mission_text import Content, parsed, put

TARGET = TargetMotion((35.0, -5.0), (0.1, -0.2))
IDEAL = SensorModel(range_m=15.0, rate_hz=5.0, noise_m=0.0, importance=0.8, threat=0.2)
NOISY = SensorModel(range_m=inf, rate_hz=10.0, noise_m=0.3, importance=0.8, threat=0.2)


def look(sensor: SimulatedSensor, seconds: float, rate_hz: float = 10.0) -> list[Sighting]:
    """What a sensor beside the target's start sees, asked at every tick of a loop."""
    ticks = range(round(seconds * rate_hz))
    return [one for tick in ticks for one in sensor.sight(tick / rate_hz, (35.0, -5.0))]


@pytest.mark.parametrize(("distance", "seen"), [(14.99, True), (15.01, False)])
def test_a_sensor_has_a_range(distance: float, seen: bool) -> None:
    sensor = SimulatedSensor(1, IDEAL, TARGET, 0.0, seed=0)
    x, y = np.array([35.0, -5.0]) + distance * np.array([0.6, -0.8])
    assert bool(sensor.sight(0.0, (x, y))) is seen


def test_a_sensor_measures_at_its_rate_with_any_call_rate(subtests: pytest.Subtests) -> None:
    for rate_hz, period_s in ((5.0, 0.2), (10.0, 0.1), (2.0, 0.5), (50.0, 0.1)):
        with subtests.test(rate_hz=rate_hz, period_s=period_s):
            model = SensorModel(inf, rate_hz, 0.0, 0.8, 0.2)
            times_s = [one.time_s for one in look(SimulatedSensor(1, model, TARGET, 0.0, seed=0), 100.0)]
            assert np.diff(times_s) == pytest.approx(period_s)


def test_noise_is_white_with_the_stated_covariance() -> None:
    seen = look(SimulatedSensor(1, NOISY, TargetMotion((35.0, -5.0), (0.0, 0.0)), 0.0, seed=3), 400.0)
    errors = np.array([one.position_m for one in seen]) - [35.0, -5.0]
    assert len(errors) == 4000
    assert errors.mean(axis=0) == pytest.approx(0.0, abs=4.0 * 0.3 / 4000**0.5)
    assert np.cov(errors.T) == pytest.approx(np.eye(2) * 0.09, abs=0.09 * 4.0 * (2.0 / 4000) ** 0.5)
    assert np.corrcoef(errors[1:, 0], errors[:-1, 0])[0, 1] == pytest.approx(0.0, abs=4.0 / 4000**0.5)
    assert {one.covariance_m2 for one in seen} == {(0.09, 0.0, 0.09)}


FIELD = TargetMotion(
    (0.0, 0.0), legs=(Leg((10.0, 0.0), 2.0), Leg((10.0, 6.0), 1.0, 4.0), Leg((0.0, 0.0), 11.661903789690601)), rounds=2
)


def test_a_target_goes_along_its_legs_pauses_and_goes_around_again(subtests: pytest.Subtests) -> None:
    for time_s, place, velocity in (
        (-1.0, (0.0, 0.0), (2.0, 0.0)),
        (2.5, (5.0, 0.0), (2.0, 0.0)),
        (8.0, (10.0, 3.0), (0.0, 1.0)),
        (13.0, (10.0, 6.0), (0.0, 0.0)),
        (15.5, (5.0, 3.0), (-10.0, -6.0)),
        (18.5, (5.0, 0.0), (2.0, 0.0)),
        (1000.0, (0.0, 0.0), (0.0, 0.0)),
    ):
        with subtests.test(time_s=time_s, place=place, velocity=velocity):
            assert FIELD.position_m(time_s) == pytest.approx(place)
            assert FIELD.velocity_at_m_s(time_s) == pytest.approx(velocity)


def test_a_path_has_all_its_corners_with_any_number_of_points() -> None:
    path = FIELD.path_m(20.0, 2)
    assert {place for _, place in path} >= {(10.0, 0.0), (10.0, 6.0)}
    assert [time_s for time_s, _ in path] == sorted(time_s for time_s, _ in path)
    assert TargetMotion((1.0, 2.0)).path_m(600.0, 200) == [(0.0, (1.0, 2.0))]


def test_a_late_sensor_states_the_time_of_measurement() -> None:
    late = replace(IDEAL, delay_s=0.3, range_m=inf)
    sensor = SimulatedSensor(1, late, TARGET, 0.0, seed=0)
    told = [(tick / 10.0, one) for tick in range(20) for one in sensor.sight(tick / 10.0, (35.0, -5.0))]
    assert [now_s - one.time_s for now_s, one in told] == pytest.approx([0.3] * len(told))
    assert len(told) == 9
    assert told[4][1].position_m == pytest.approx(TARGET.position_m(told[4][1].time_s))


def test_a_sensor_may_be_blind_for_a_while() -> None:
    blind = replace(IDEAL, blind_s=((2.0, 4.0), (6.0, 7.0)))
    times_s = [one.time_s for one in look(SimulatedSensor(1, blind, TARGET, 0.0, seed=0), 10.0)]
    assert not [time_s for time_s in times_s if 2.0 <= time_s < 4.0 or 6.0 <= time_s < 7.0]
    assert len(times_s) == 50 - 15


def test_outliers_have_the_given_share_and_distance() -> None:
    wild = replace(NOISY, outlier_share=0.05, outlier_m=30.0)
    seen = look(SimulatedSensor(1, wild, TargetMotion((35.0, -5.0)), 0.0, seed=0), 400.0)
    off = np.linalg.norm(np.array([one.position_m for one in seen]) - [35.0, -5.0], axis=1)
    assert np.mean(off > 5.0) == pytest.approx(0.05, abs=4.0 * (0.05 * 0.95 / 4000) ** 0.5)
    assert off[off > 5.0] == pytest.approx(30.0, abs=5.0 * 0.3)


@pytest.mark.parametrize(("source", "seen"), [("simulated", 50), ("external", 0)])
def test_a_target_that_others_see_is_seen_by_no_simulated_sensor(source: str, seen: int) -> None:
    mission = load_mission("case3-turns")
    other = replace(mission, target=mission.target.model_copy(update={"source": source}))
    sensor = target_sensor(other, 2, 0.0, 0)
    assert len([1 for tick in range(100) if sensor.sight(tick / 10.0, other.target.start_m)]) == seen


def sighted(content: Content, vehicle_id: int = 2, seconds: float = 20.0) -> list[tuple[Sighting, ...]]:
    """What a vehicle's sensor sees between the targets of a mission of several rings, at every tick."""
    sensor = target_sensor(parsed(content), vehicle_id, 0.0, 3)
    return [sensor.sight(tick / 10.0, (40.0, 0.0)) for tick in range(round(10.0 * seconds))]


def test_a_sensor_sees_every_target_and_names_it() -> None:
    seen = sighted(SEVERAL)
    due = [each for each in seen if each]
    assert {tuple(one.target for one in each) for each in due} == {("north", "south")}
    assert len(due) == 80  # at 4 Hz
    assert {(one.sensor_id, one.importance, one.threat) for north, _ in due for one in (north,)} == {(2, 0.9, 0.1)}
    assert {one.threat for _, one in due} == {0.3}
    north_m = np.array([one.position_m for one, _ in due]) - [40.0, 20.0]
    assert north_m.std() == pytest.approx(0.2, rel=0.2)
    assert [one.position_m for _, one in due] == [(40.0 + 0.1 * one.time_s, -20.0) for _, one in due]


def test_each_target_has_its_range_its_delay_and_its_stream_of_random_numbers() -> None:
    noisy = put(put(SEVERAL, ("targets", 1, "sensor"), {"noise_m": 0.2}), ("targets", 1, "velocity_m_s"), [0.0, 0.0])
    off_m = np.array([[one.position_m for one in each] for each in sighted(noisy, seconds=100.0) if each])
    off_m -= np.array([[40.0, 20.0], [40.0, -20.0]])
    assert off_m[:, 1].std() == pytest.approx(0.2, rel=0.1)
    assert abs(np.corrcoef(off_m[:, 0].ravel(), off_m[:, 1].ravel())[0, 1]) < 4.0 / off_m[:, 0].size ** 0.5
    near = put(SEVERAL, ("targets", 1, "sensor"), {"range_m": 19.0})
    assert {one.target for each in sighted(near) for one in each} == {"north"}
    late = sighted(put(SEVERAL, ("targets", 1, "sensor"), {"delay_s": 1.0}))
    ages_s = {(one.target, round(tick / 10.0 - one.time_s, 6)) for tick, each in enumerate(late) for one in each}
    assert ages_s == {("north", 0.0), ("south", 1.0)}


def test_what_a_vehicle_changes_of_its_sensor_holds_for_all_targets() -> None:
    changed = put(SEVERAL, ("vehicles", 1, "sensor"), {"rate_hz": 2.0})
    assert [len([each for each in sighted(changed, vehicle_id) if each]) for vehicle_id in (1, 2)] == [80, 40]


def test_the_first_target_is_seen_as_if_it_were_alone() -> None:
    alone = target_sensor(parsed(SEVERAL).of_ring(1), 2, 0.0, 3)
    first = [each[0] for each in sighted(SEVERAL) if each]
    single = [one for tick in range(200) for one in alone.sight(tick / 10.0, (40.0, 0.0))]
    assert [one.position_m for one in first] == [one.position_m for one in single]
    assert {one.target for one in single} == {None}


def test_sightings_of_one_target_and_of_sensors_that_do_not_tell_them_apart_have_no_name() -> None:
    anonymous = put(put(SEVERAL, ("target", "sensor", "names"), False), ("vehicles", 0, "sensor"), {"names": True})
    assert {one.target for each in sighted(anonymous, 1) for one in each} == {"north", "south"}
    assert {len(each) for each in sighted(anonymous)} == {0, 2}
    for content in (anonymous, put(STACK, ("target", "sensor", "range_m"), 60.0)):
        assert {one.target for each in sighted(content) for one in each} == {None}


def test_a_target_that_is_reported_from_outside_is_not_simulated_beside_one_that_is() -> None:
    external = put(SEVERAL, ("targets", 0, "source"), "external")
    assert {one.target for each in sighted(external) for one in each} == {"south"}


def test_a_sensor_reports_the_importance_and_the_threat_of_the_time() -> None:
    model = SensorModel(50.0, 5.0, 0.0, 0.8, 0.2, changes=((10.0, 0.3, 0.1), (20.0, 0.9, 0.6)))
    sensor = SimulatedSensor(1, model, TargetMotion((0.0, 0.0)), 100.0, 0)
    seen = [each for tick in range(300) for each in sensor.sight(100.0 + tick * 0.1, (1.0, 1.0))]
    values = {round(each.time_s - 100.0, 1): (each.importance, each.threat) for each in seen}
    assert (values[0.0], values[9.8], values[10.0], values[19.8], values[20.0], values[29.8]) == (
        (0.8, 0.2),
        (0.8, 0.2),
        (0.3, 0.1),
        (0.3, 0.1),
        (0.9, 0.6),
        (0.9, 0.6),
    )
