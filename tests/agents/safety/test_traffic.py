"""Aircraft outside the team: which are known, which are of the team, and that a vehicle keeps clear of the others."""

from collections.abc import Callable
from math import hypot

import numpy as np
import pytest

from agents.safety.guard import Guard
from agents.safety.traffic import AGED_S, KnownTraffic
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.team.messages import TRAFFIC_MAX, Aircraft, MemberState
from estimation.plant.model import exact_step
from estimation.state import OwnEstimate, Vector
from tests.support.estimates import own_spread

Maker = Callable[..., AgentConfig]
KEPT_M = 20.0
NEAR = {"safety": {"traffic_distance_m": KEPT_M, "traffic_height_m": 30.0}}
TICK_S = 0.1


def at(time_s: float, motion: Vector | None = None) -> Situation:
    """A vehicle at a height of 8 m; at rest at the origin by default."""
    moves = np.zeros(4) if motion is None else motion
    mean = np.concatenate([moves, np.zeros(2)])
    own = OwnEstimate(time_s, mean, own_spread(0.01))
    return Situation(time_s, time_s + TICK_S, own, moves + 0.0, np.zeros(2), None, None, None, height_m=8.0)


def aircraft(
    label: str = "HB-ABC",
    time_s: float = 100.0,
    x: float = 50.0,
    x_rate: float = 0.0,
    y: float = 0.0,
    altitude_m: float | None = 10.0,
) -> Aircraft:
    return Aircraft(label, time_s, (x, y), (x_rate, 0.0), altitude_m)


def heard(config: AgentConfig, *reports: Aircraft, now_s: float = 100.0) -> KnownTraffic:
    traffic = KnownTraffic(config)
    traffic.receive(reports)
    traffic.update(at(now_s), ())
    return traffic


def test_the_newest_report_counts_for_ten_seconds_whoever_sent_it(make_config: Maker) -> None:
    traffic = heard(make_config(**NEAR), aircraft(x=50.0))
    traffic.hear([aircraft(time_s=104.0, x=60.0), aircraft("DRONE-1", 104.0, x=-40.0)])
    traffic.hear([aircraft(time_s=102.0, x=55.0)])
    traffic.update(at(105.0), ())
    assert {each.label: each.position_m[0] for each in traffic.others} == {"HB-ABC": 60.0, "DRONE-1": -40.0}
    traffic.update(at(104.0 + AGED_S - 0.1), ())
    assert len(traffic.others) == 2
    traffic.update(at(104.0 + AGED_S + 0.1), ())
    assert not traffic.others


def test_no_number_of_aircraft_fills_the_memory_and_only_those_heard_here_are_passed_on(make_config: Maker) -> None:
    traffic = heard(make_config(**NEAR), aircraft("HEARD"))
    traffic.hear([aircraft(f"A{k}") for k in range(1000)])
    traffic.update(at(100.0), ())
    assert len(traffic.others) <= 2 * TRAFFIC_MAX
    assert [each.label for each in traffic.shared(100.0)] == ["HEARD"], "peers pass on their own"
    assert traffic.shared(100.5) == ()
    assert [each.label for each in traffic.shared(101.0)] == ["HEARD"]


def test_a_transmitter_of_the_team_is_no_traffic_but_one_that_comes_near_is(make_config: Maker) -> None:
    mate = MemberState(3, 100.0, "hold", (40.0, 3.0), (0.0, 0.0), (40.0, 3.0), (0.0, 0.0), altitude_m=8.0)
    traffic = KnownTraffic(make_config(**NEAR))
    traffic.receive([aircraft("OWN", x=4.0), aircraft("MATE", x=42.0), aircraft("COMES", x=90.0, x_rate=-10.0)])
    traffic.update(at(100.0), (mate,))
    assert [each.label for each in traffic.others] == ["COMES"]
    traffic.receive([aircraft("OWN", 108.5, x=4.0), aircraft("COMES", 108.5, x=5.0, x_rate=-10.0)])
    traffic.update(at(108.5), (mate,))
    assert [each.label for each in traffic.others] == ["COMES"]
    assert "COMES 5 m away, +2 m in height" in traffic.near(at(108.5))


def test_what_is_far_above_or_not_asked_for_is_no_alert_and_an_unknown_height_is_any(make_config: Maker) -> None:
    low, high, unknown = (aircraft(x=15.1, altitude_m=each) for each in (37.0, 39.0, None))
    for config, each, alerts in (
        (make_config(**NEAR), low, True),
        (make_config(**NEAR), high, False),
        (make_config(**NEAR), unknown, True),
        (make_config(), low, False),
    ):
        traffic = heard(config, each)
        assert bool(traffic.near(at(100.0))) is alerts
        assert bool(traffic.bodies(at(100.0))) is alerts
    assert heard(make_config(), low).others, "it is shown nevertheless"


def flown_m(config: AgentConfig, start_x_m: float, x_rate: float, passes_m: float, *, reports: bool) -> list[float]:
    """The distances from an aircraft that flies by at a distance, of a vehicle that would hover: a closed loop."""
    traffic, guard, step = KnownTraffic(config), Guard(config), exact_step(config.plant, TICK_S)
    motion, distances_m = np.zeros(4), list[float]()
    for tick in range(600):
        now_s = 100.0 + tick * TICK_S
        x = start_x_m + x_rate * tick * TICK_S
        distances_m.append(hypot(x - motion[0], passes_m - motion[1]))
        if tick % 10 == 0 and reports:
            traffic.receive([aircraft(time_s=now_s, x=x, x_rate=x_rate, y=passes_m)])
        situation = at(now_s, motion)
        traffic.update(situation, ())
        guarded = guard.check(situation, np.zeros(2), [], traffic.bodies(situation))
        motion = step.advance(motion, guarded.aim_m, np.zeros(2))
        if config.safety.fence_m:
            assert max(map(abs, motion[:2])) < 10.2, "no aircraft leads it over the fence"
    return distances_m


@pytest.mark.parametrize(("x_rate", "passes_m"), [(-3.0, 0.0), (-3.0, 8.0), (-2.0, -5.0)])
def test_a_vehicle_that_hovers_gives_way_to_one_that_does_not(
    make_config: Maker, x_rate: float, passes_m: float
) -> None:
    config = make_config(**NEAR)
    assert min(flown_m(config, 70.0, x_rate, passes_m, reports=False)) < 9.0
    assert min(flown_m(config, 70.0, x_rate, passes_m, reports=True)) > 0.98 * KEPT_M


def test_within_a_fence_it_goes_as_far_as_that_allows(make_config: Maker) -> None:
    box = ((-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0))
    config = make_config(safety={"traffic_distance_m": KEPT_M, "fence_m": box})
    kept_m, unkept_m = (min(flown_m(config, 70.0, -3.0, 4.0, reports=each)) for each in (True, False))
    assert kept_m > unkept_m + 5.0
