"""The remaining flight time of a battery against the time of the way home, by hand and on the plant."""

from collections.abc import Callable
from dataclasses import replace
from math import hypot, inf

import numpy as np
import pytest

from agents.safety.endurance import Endurance, WayHome, return_duration_s
from agents.safety.routes import passing_room_m
from agents.settings.config import AgentConfig
from agents.settings.sections import ChoreographySettings, NoFlySection
from estimation.plant.model import exact_step

Maker = Callable[..., AgentConfig]


@pytest.fixture
def config(make_config: Maker) -> AgentConfig:
    """Return a vehicle of three that flies home at 2 m/s, on the lowest layer, 11 m high."""
    choreography = ChoreographySettings(layer_m=3.0, landing="return", landing_order=(3,))
    return make_config(vehicle_id=3, choreography=choreography, home_m=(0.0, 0.0), layers_from_m=8.0, altitude_m=8.0)


def test_the_way_home_is_rising_flying_and_landing_by_hand(config: AgentConfig) -> None:
    rising_s, landing_s = 3.0 + 3 * 3.0 / 0.5, 11.0 / 0.5
    assert return_duration_s(config, (), (60.0, -80.0), 8.0, (0.0, 0.0)) == pytest.approx(
        rising_s + 100.0 / 2.0 + landing_s
    )
    higher_s = return_duration_s(config, (), (60.0, -80.0), 21.0, (0.0, 0.0))
    assert higher_s == pytest.approx(rising_s + 100.0 / 2.0 + 21.0 / 0.5)


def test_a_head_wind_lowers_the_speed_as_on_the_plant(config: AgentConfig) -> None:
    """Fly the plant home, its setpoint ahead by the lead, and time 100 m of it."""
    at_m = -60.0, 80.0
    back = -np.array(at_m) / 100.0
    head_wind = -0.5 * back
    lead_m = 2.0 * config.plant.x.a1_per_s / config.plant.x.a0_per_s2
    motion, step_s = np.array([*(-300.0 * back), 0.0, 0.0]), 0.01
    passed_s: list[float] = []
    for tick in range(60_000):
        away_m = -float(motion[:2] @ back)
        if away_m < (200.0, 100.0)[len(passed_s)]:
            passed_s.append(tick * step_s)
        if len(passed_s) == 2:
            break
        motion = exact_step(config.plant, step_s).advance(motion, motion[:2] + lead_m * back, head_wind)
    near_s, far_s = (
        return_duration_s(config, (), (n * at_m[0], n * at_m[1]), 8.0, tuple(head_wind)) for n in (1.0, 2.0)
    )
    assert far_s - near_s == pytest.approx(passed_s[1] - passed_s[0], rel=0.005)
    assert near_s > return_duration_s(config, (), at_m, 8.0, (0.0, 0.0)) + 10.0


def test_tail_and_cross_wind_give_no_gain_and_the_duration_is_bounded(config: AgentConfig) -> None:
    calm_s = return_duration_s(config, (), (100.0, 0.0), 8.0, (0.0, 0.0))
    assert return_duration_s(config, (), (100.0, 0.0), 8.0, (-0.5, 0.0)) == calm_s
    assert return_duration_s(config, (), (100.0, 0.0), 8.0, (0.0, 0.5)) == pytest.approx(calm_s)
    assert return_duration_s(config, (), (100.0, 0.0), 8.0, (50.0, 0.0)) == pytest.approx(calm_s - 50.0 + 100.0 / 0.4)


def test_the_way_around_a_zone_counts_not_the_straight_one(config: AgentConfig) -> None:
    """A wall across the straight way of 100 m: by hand around its corners, with the wind of each leg."""
    wall = NoFlySection(name="wall", polygon_m=((-51.0, -60.0), (-49.0, -60.0), (-49.0, 30.0), (-51.0, 30.0)))
    config = replace(config, safety=config.safety.model_copy(update={"no_fly": (wall,)}))
    way = WayHome(config).places_m((-100.0, 0.0))
    room_m = passing_room_m(config.formation.speed_max_m_s, config.safety)
    straight_s = return_duration_s(config, (), (-100.0, 0.0), 8.0, (0.0, 0.0))
    around_s = return_duration_s(config, way, (-100.0, 0.0), 8.0, (0.0, 0.0))
    corner_m = 2.0 * hypot(49.0, 30.0)
    longest_m = 2.0 * hypot(49.0 - room_m, 30.0 + 1.1 * room_m) + 2.0 * (1.0 + room_m)
    assert corner_m < 100.0 + 2.0 * (around_s - straight_s) < longest_m
    southwards_s = return_duration_s(config, way, (-100.0, 0.0), 8.0, (0.0, -0.3))
    assert southwards_s > around_s + 2.0, "it flies north against this wind; the straight way is across it"
    near = WayHome(config).places_m((-40.0, 0.0))
    assert return_duration_s(config, near, (-40.0, 0.0), 8.0, (0.0, 0.0)) == pytest.approx(straight_s - 30.0)


def test_without_a_home_it_lands_where_it_is(make_config: Maker) -> None:
    assert return_duration_s(make_config(home_m=None), (), (500.0, 0.0), 10.0, (1.0, 0.0)) == 20.0


def discharged(endurance: Endurance, until_s: int, percent_per_s: float, *, stops_s: float = inf) -> None:
    """Report whole percents every two seconds, as an autopilot does."""
    for time_s in range(0, until_s + 1, 2):
        left = 90.0 - percent_per_s * min(float(time_s), stops_s)
        endurance.see(float(time_s), round(left) / 100.0, None)


@pytest.mark.parametrize("percent_per_s", [0.1, 0.5])
def test_the_rate_of_discharge_gives_the_time_until_the_charge_is_critical(percent_per_s: float) -> None:
    endurance = Endurance(0.1)
    discharged(endurance, 120, percent_per_s)
    expected_s = (90.0 - 10.0) / percent_per_s - 120.0
    assert endurance.left_s(120.0) == pytest.approx(expected_s, rel=0.1)


def test_the_flight_time_is_unknown_in_the_first_minute_and_for_a_constant_charge() -> None:
    early, steady = Endurance(0.1), Endurance(0.1)
    discharged(early, 58, 0.5)
    assert early.left_s(58.0) == inf
    # A simulator's battery that falls, and then stays as it is.
    discharged(steady, 160, 0.5, stops_s=80.0)
    assert steady.left_s(80.0) < 100.0 + 10.0
    assert steady.left_s(160.0) == inf
    assert Endurance(0.1).left_s(0.0) == inf


def test_a_voltage_that_recovers_begins_anew() -> None:
    endurance = Endurance(0.1)
    discharged(endurance, 120, 0.5)
    endurance.see(121.0, 0.5, None)
    assert endurance.left_s(121.0) == inf


def test_the_autopilots_own_time_counts_as_far_as_the_critical_charge() -> None:
    endurance = Endurance(0.1)
    endurance.see(0.0, 0.5, 400.0)
    assert endurance.left_s(0.0) == pytest.approx(320.0)
    endurance.see(1.0, 0.1, 40.0)
    assert endurance.left_s(1.0) == 0.0
