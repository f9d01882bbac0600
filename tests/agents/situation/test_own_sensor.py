"""Whose sightings of the target are used by a vehicle that sees it itself."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from agents.settings.config import AgentConfig
from agents.situation.own_sensor import OwnSensor
from estimation.state import Sighting

OWN, PEER, OUTSIDE = 3, 1, 1000


def sighting(sensor_id: int, time_s: float, x: float, sigma_m: float = 0.3) -> Sighting:
    return Sighting(time_s, sensor_id, (x, 0.0), (sigma_m**2, 0.0, sigma_m**2), 0.8, 0.2)


@pytest.fixture
def sensor(make_config: Callable[..., AgentConfig]) -> OwnSensor:
    return OwnSensor(make_config(vehicle_id=OWN))


def accepted(sensor: OwnSensor, source: int, off_m: float, from_s: float, to_s: float, *, sees: bool = True) -> int:
    """Return how many of a source's sightings are used, that come with the own ones at 5 Hz."""
    count = 0
    for tick in range(round(from_s * 5.0), round(to_s * 5.0)):
        if sees:
            assert sensor.accepts(sighting(OWN, tick / 5.0, 10.0))
        count += sensor.accepts(sighting(source, tick / 5.0, 10.0 + off_m))
    return count


@pytest.mark.parametrize("source", [PEER, OUTSIDE])
def test_who_contradicts_the_own_sensor_is_refused_until_it_sees_nothing_any_more(
    sensor: OwnSensor, source: int
) -> None:
    assert accepted(sensor, source, 12.0, 0.0, 10.0) == 2, "a single one may be an outlier"
    assert set(sensor.contradictions(10.0)) == {source}
    assert accepted(sensor, source, 12.0, 12.0, 14.0, sees=False) == 10
    assert set(sensor.contradictions(20.0)) == set()


def test_who_agrees_is_used_and_so_is_an_outlier_now_and_then(sensor: OwnSensor) -> None:
    for start_s in range(20):
        assert accepted(sensor, PEER, 1.5, start_s, start_s + 0.8) == 4
        assert accepted(sensor, PEER, 12.0, start_s + 0.8, start_s + 1.0) == 1
    assert not sensor.contradictions(20.0)


def test_a_sensor_with_a_large_covariance_does_not_contradict(sensor: OwnSensor) -> None:
    for tick in range(20):
        sensor.accepts(sighting(OWN, tick / 5.0, 10.0))
        assert sensor.accepts(sighting(PEER, tick / 5.0, 22.0, sigma_m=4.0))


def test_the_team_sees_the_target_by_its_own_sensors_alone(sensor: OwnSensor) -> None:
    sensor.accepts(sighting(OUTSIDE, 5.0, 10.0))
    assert sensor.team_saw_s == -float("inf")
    sensor.accepts(sighting(PEER, 6.0, 10.0))
    assert sensor.team_saw_s == 6.0


@pytest.mark.parametrize(("observers", "period_s"), [(1, 0.2), (3, 0.2), (6, 0.2), (12, 0.4), (30, 1.0)])
def test_a_team_sends_thirty_sightings_a_second_however_many_see_the_target(
    sensor: OwnSensor, observers: int, period_s: float
) -> None:
    sent_s = []
    for tick in range(100):
        now_s = tick / 10.0
        if tick % 2 == 0:
            for sensor_id in (OWN, *range(10, 9 + observers)):
                sensor.accepts(sighting(sensor_id, now_s, 10.0))
        for due in sensor.due(now_s):
            assert due.sensor_id == OWN
            sent_s.append(due.time_s)
    assert [later - earlier for earlier, later in pairwise(sent_s)] == pytest.approx([period_s] * (len(sent_s) - 1))


def test_sources_outside_of_the_team_do_not_slow_its_sightings_down(sensor: OwnSensor) -> None:
    for source in range(1000, 1300):
        sensor.accepts(sighting(source, 5.0, 10.0))
    for time_s in (5.0, 5.2, 5.4):
        sensor.accepts(sighting(OWN, time_s, 10.0))
        assert sensor.due(time_s)


def test_a_sighting_is_sent_once(sensor: OwnSensor) -> None:
    sensor.accepts(sighting(OWN, 5.0, 10.0))
    assert sensor.due(5.0)
    assert not sensor.due(9.0)
