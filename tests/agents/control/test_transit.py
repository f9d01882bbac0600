"""The way from one ring to another: flown by the plant under the aims, past rings that are in the way."""

from collections.abc import Callable
from dataclasses import replace
from math import cos, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.control.transit import FAR_SHARE, Disc, Transit, heading_rad
from agents.ring.joining import ASIDE
from agents.settings.config import AgentConfig, RingConfig
from agents.situation.situation import Situation
from estimation.plant.model import exact_step
from estimation.state import OwnEstimate, TargetEstimate
from tests.support.estimates import own_spread, target_spread

Maker = Callable[..., AgentConfig]
STEP_M, TICK_S = 0.05, 0.1
angles = st.floats(-pi, pi)


@given(
    place=st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)),
    discs=st.lists(
        st.builds(
            lambda a, d, r: Disc((d * cos(a), d * sin(a)), r), angles, st.floats(45.0, 80.0), st.floats(1.0, 20.0)
        ),
        max_size=2,
    ),
)
def test_the_way_enters_no_disc_from_outside_and_ends_at_the_goal(
    place: tuple[float, float], discs: list[Disc]
) -> None:
    (x, y), goal = place, (0.0, 0.0)
    if len(discs) == 2 and hypot(
        discs[0].centre_m[0] - discs[1].centre_m[0], discs[0].centre_m[1] - discs[1].centre_m[1]
    ) < (discs[0].radius_m + discs[1].radius_m + 1.0):
        discs = discs[:1]
    left = [each for each in discs if hypot(x - each.centre_m[0], y - each.centre_m[1]) > each.radius_m]
    for _ in range(round(400.0 / STEP_M)):
        if hypot(x, y) < 2.0 * STEP_M:
            return
        direction_rad, _ = heading_rad((x, y), goal, discs)
        x, y = x + STEP_M * cos(direction_rad), y + STEP_M * sin(direction_rad)
        for each in discs:
            away_m = hypot(x - each.centre_m[0], y - each.centre_m[1])
            assert each not in left or away_m > each.radius_m - 2.0 * STEP_M
            if away_m > each.radius_m and each not in left:
                left.append(each)
    raise AssertionError(f"the way from {place} around {discs} does not end")


@pytest.mark.parametrize("start", [(10.0, 0.0), (-10.0, 0.5), (0.0, 10.0), (3.0, -2.0)])
@pytest.mark.parametrize("beyond_m", [-30.0, 20.0])
def test_a_vehicle_leaves_its_ring_and_flies_to_within_reach_of_the_next(
    make_config: Maker, start: tuple[float, float], beyond_m: float
) -> None:
    """The plant of the profile, under the aims: around its own target, at the ring's speed and acceleration at most."""
    whole = make_config(vehicle_id=1, slots=(1, 2))
    radius_m, clear_m = whole.encirclement.radius_m, whole.encirclement.radius_m + ASIDE * whole.safety.separation_m
    near_m = FAR_SHARE * whole.encirclement.far_m
    rings = tuple(RingConfig(name, name, 2, whole.encirclement) for name in ("here", "there"))
    config = replace(whole, rings=rings, targets=("here", "there")).on_ring(1)
    transit, there_m = Transit(config), np.array((clear_m + near_m + beyond_m, 0.0, 0.0, 0.0))
    motion, left = np.array([*start, 0.0, 0.0]) * np.array([radius_m / 10.0, radius_m / 10.0, 1.0, 1.0]), False
    step, speeds_m_s, paths, outwards_m = exact_step(config.plant, TICK_S), [], [], hypot(motion[0], motion[1])
    for tick in range(1200):
        own = OwnEstimate(tick * TICK_S, np.array([*motion, 0.0, 0.0]), own_spread(0.1, 0.1))
        target = TargetEstimate(tick * TICK_S, there_m, target_spread(), 0.0, 0.9, 0.1)
        situation = Situation(
            tick * TICK_S,
            tick * TICK_S,
            own,
            motion,
            np.zeros(2),
            target,
            None,
            there_m,
            acting_others={"here": np.zeros(4)},
        )
        plan = transit.plan(situation)
        assert plan is not None
        if transit.arrived:
            break
        motion = step.transition @ motion + step.input_gain @ plan.aim_m
        away_m = hypot(motion[0], motion[1])
        left = left or away_m > clear_m
        assert not left or away_m > clear_m - 1.0
        assert left or away_m > outwards_m - 0.5  # it does not cross the ring that it leaves
        outwards_m = max(outwards_m, away_m)
        speeds_m_s.append(hypot(motion[2], motion[3]))
        paths.append(motion[:2].copy())
    assert transit.arrived
    assert hypot(*(motion[:2] - there_m[:2])) < near_m
    way = np.linspace(motion[:2], there_m[:2], 100)
    assert np.hypot(*way.T).min() > min(clear_m, hypot(motion[0], motion[1])) - 0.1  # nothing is in its way
    if not speeds_m_s:
        return  # it was there already
    assert max(speeds_m_s) <= config.encirclement.speed_max_m_s
    changes = np.diff(np.array(paths), 2, axis=0) / TICK_S**2
    assert np.hypot(*changes.T).max(initial=0.0) <= config.encirclement.acceleration_max_m_s2


def test_peers_can_predict_the_acceleration_of_a_vehicle_in_a_wind(make_config: Maker) -> None:
    """The plant without the wind answers the published aim as the plant in the wind answers the sent one."""
    config, goal_m, wind = make_config(vehicle_id=1), np.array((60.0, 20.0, 0.0, 0.0)), np.array((0.5, -0.3))
    motion = np.array((3.0, -4.0, 1.5, 0.4))
    own = OwnEstimate(0.0, np.array([*motion, *wind]), own_spread(0.1, 0.1))
    target = TargetEstimate(0.0, goal_m, target_spread(), 0.0, 0.9, 0.1)
    plan = Transit(config).plan(Situation(0.0, 0.0, own, motion, wind, target, None, goal_m))
    assert plan is not None
    step = exact_step(config.plant, 0.01)
    predicted = step.advance(motion, plan.undisturbed_aim_m, np.zeros(2))
    assert predicted == pytest.approx(step.advance(motion, plan.aim_m, wind), abs=1e-9)


def test_without_its_target_there_is_no_way(make_config: Maker) -> None:
    config = make_config(vehicle_id=1)
    own = OwnEstimate(0.0, np.zeros(6), own_spread(0.1, 0.1))
    situation = Situation(0.0, 0.0, own, np.zeros(4), np.zeros(2), None, None, None)
    assert Transit(config).plan(situation) is None
