"""The estimates of several targets: each by its own filter, of which the vehicle follows one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from agents.settings.config import AgentConfig, RingConfig
from agents.situation.targets import TargetEstimates
from estimation.filters.target import TargetFilter
from estimation.state import Sighting

Maker = Callable[..., AgentConfig]


def sighting(time_s: float, x: float, y: float, target: str | None, sensor: int = 1) -> Sighting:
    return Sighting(time_s, sensor, (x, y), (0.04, 0.0, 0.04), 0.9, 0.1, target=target)


def two(config: AgentConfig) -> AgentConfig:
    rings = tuple(RingConfig(name, name, 2, config.encirclement) for name in ("north", "south"))
    return replace(config, rings=rings, targets=("north", "south"))


def test_each_target_is_estimated_as_if_it_were_the_only_one(make_config: Maker) -> None:
    config, random = two(make_config(vehicle_id=1)), np.random.default_rng(1)
    whole, alone = TargetEstimates(config), {name: TargetFilter(config.target_filter) for name in config.targets}
    for tick in range(100):
        now_s = tick * 0.2
        seen = [
            sighting(now_s, now_s + random.normal(0.0, 0.2), 20.0 + random.normal(0.0, 0.2), "north"),
            sighting(now_s, 40.0 + random.normal(0.0, 0.2), -20.0 + random.normal(0.0, 0.2), "south"),
        ]
        whole.sight(seen)
        for each in seen:
            alone[each.target or ""].sight(each)
        followed = whole.estimate(now_s)
        for name, other in alone.items():
            expected = other.estimate(now_s)
            assert expected is not None
            assert np.array_equal(whole.estimates[name].mean, expected.mean)
        assert followed is whole.estimates["north"]
    assert whole.position_m("south") is not None
    assert whole.sighted_s == alone["north"].sighted_s
    whole.follow("south")
    south = whole.estimate(19.8)
    assert south is not None
    assert abs(south.mean[1] + 20.0) < 0.5


def test_a_change_of_the_followed_target_is_no_jump(make_config: Maker) -> None:
    config = two(make_config(vehicle_id=1))
    whole = TargetEstimates(config)
    for tick in range(200):
        now_s, jumped = tick * 0.2, tick >= 100
        whole.sight([sighting(now_s, 0.0, 20.0, "north"), sighting(now_s, 500.0 * jumped, -20.0, "south")])
        whole.estimate(now_s)
    before = whole.resets
    assert before == 0
    whole.follow("south")
    assert whole.resets == before
    for tick in range(200, 300):
        whole.sight([sighting(tick * 0.2, -500.0, -20.0, "south")])
    assert whole.resets > before


def test_a_mission_of_one_target_has_one_filter(make_config: Maker) -> None:
    config = make_config(vehicle_id=1)
    whole, alone = TargetEstimates(config), TargetFilter(config.target_filter)
    assert whole.estimate(0.0) is None
    assert not whole.estimates
    for tick in range(20):
        whole.sight([sighting(tick * 0.2, 1.0, 2.0, None)])
        alone.sight(sighting(tick * 0.2, 1.0, 2.0, None))
    found, expected = whole.estimate(4.0), alone.estimate(4.0)
    assert found is not None
    assert expected is not None
    assert np.array_equal(found.mean, expected.mean)
    assert (whole.sighted_s, whole.resets) == (alone.sighted_s, alone.resets)


def test_sightings_without_a_name_are_associated_from_the_first_of_them_on(make_config: Maker) -> None:
    """Two targets 40 m apart: what is seen near one is of that one."""
    config, random = two(make_config(vehicle_id=1)), np.random.default_rng(2)
    whole = TargetEstimates(config)
    for tick in range(200):
        now_s, named = tick * 0.2, tick < 50
        x, y = 0.5 * now_s, 20.0 + random.normal(0.0, 0.2)
        whole.sight(
            [
                sighting(now_s, x, y, "north" if named else None),
                sighting(now_s, 40.0, -20.0, "south" if named else None),
            ]
        )
        followed, resets = whole.estimate(now_s), whole.resets
        assert resets == 0
        if tick > 5:
            assert followed is not None
            assert abs(followed.mean[0] - 0.5 * now_s) < 1.0
            assert abs(followed.mean[1] - 20.0) < 1.0
    assert sorted(whole.estimates) == ["north", "south"]
    assert whole.sighted_s == 199 * 0.2
