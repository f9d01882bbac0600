"""The way of an aim from tick to tick: bounded for every plan, and not for what keeps vehicles apart."""

from collections.abc import Callable
from itertools import pairwise
from math import dist, hypot

import numpy as np
import pytest

from agents.control.plan import Plan
from agents.inputs import Message, TacticEvent
from agents.setpoint import SlewLimit
from agents.settings.config import AgentConfig
from agents.tactics import Event, Tactic
from agents.team.messages import MemberState
from estimation.plant.model import exact_step
from estimation.state import Sighting
from tests.agents.setpoint.test_feedforward import seen
from tests.agents.test_core import PERIOD_S, Pilot, setpoint_of

Maker = Callable[..., AgentConfig]
FAST_M_S = 6.0


def plan(x: float, y: float) -> Plan:
    place_m = np.array([x, y])
    return Plan(place_m, place_m - 0.5, np.zeros(2))


def test_an_aim_moves_by_one_bound_a_tick_and_the_undisturbed_one_with_it(make_config: Maker) -> None:
    increment = SlewLimit(make_config(safety={"setpoint_speed_max_m_s": FAST_M_S}))
    increment.sent(np.array([1.0, 2.0]))
    places = []
    for _ in range(4):
        bounded = increment.bounded(Tactic.HOLD, plan(2.0, 2.9), seen())
        assert bounded.undisturbed_aim_m == pytest.approx(bounded.aim_m - 0.5)
        increment.sent(bounded.aim_m)
        places.append(bounded.aim_m)
    away_m = hypot(1.0, 0.9)
    for tick, place in enumerate(places[:2], start=1):
        share = tick * FAST_M_S * PERIOD_S / away_m
        assert place == pytest.approx([1.0 + share, 2.0 + 0.9 * share])
    assert [place.tolist() for place in places[2:]] == [[2.0, 2.9]] * 2


@pytest.mark.parametrize("speed_m_s", [0.0, 4.0])
def test_the_first_aim_and_that_after_a_jump_hardly_change_the_velocity(speed_m_s: float, make_config: Maker) -> None:
    config = make_config(safety={"setpoint_speed_max_m_s": FAST_M_S})
    increment, flying = SlewLimit(config), seen((1.0, 2.0), (speed_m_s, 0.0), (0.3, 0.0))
    for _ in range(2):
        bounded = increment.bounded(Tactic.FORMATION, plan(50.0, 50.0), flying)
        after = exact_step(config.plant, PERIOD_S).advance(flying.acting_motion, bounded.aim_m, flying.disturbance)
        gained_m_s = hypot(*(after - flying.acting_motion)[2:])
        assert 0.0 < gained_m_s < 1.01 * config.plant.x.a0_per_s2 * FAST_M_S * PERIOD_S * PERIOD_S
        increment.sent(bounded.aim_m + 9.0)
        increment.restart()


@pytest.mark.parametrize("tactic", [Tactic.EXCITE, Tactic.LAND, Tactic.PILOT_OVERRIDE])
def test_identification_steps_and_setpoints_without_effect_are_not_limited(tactic: Tactic, make_config: Maker) -> None:
    increment = SlewLimit(make_config())
    increment.sent(np.zeros(2))
    assert increment.bounded(tactic, plan(9.0, 9.0), seen()).aim_m.tolist() == [9.0, 9.0]


def test_a_target_that_jumps_moves_no_setpoint_far_but_another_vehicle_does(make_config: Maker) -> None:
    config = make_config(
        safety={"setpoint_speed_max_m_s": FAST_M_S, "separation_m": 3.0}, encirclement={"smoothing_time_s": 0.0}
    )
    pilot, places = Pilot(config, motion=(10.0, 0.0, 0.0, 0.0)), []
    for tick in range(200):
        # It comes ever nearer for 10 s, and is then 8 m to the side.
        pilot.core.take(Sighting(tick * PERIOD_S, 2, (0.0, 8.0 * (tick >= 100)), (0.01, 0.0, 0.01), 0.8, 0.2))
        places += [setpoint_of(output) for output in pilot.fly((tick + 1) * PERIOD_S)]
    moved_m = [dist(*each) for each in pairwise(places[100:])]
    assert FAST_M_S * PERIOD_S - 1e-9 < max(moved_m) <= FAST_M_S * PERIOD_S + 1e-9
    x, y, x_rate, y_rate = pilot.motion.tolist()
    ahead = MemberState(
        3, pilot.now_s, "hold", (x + 1.5, y), (x_rate - 1.5, y_rate), (x, y), (0.0, 0.0), altitude_m=8.0
    )
    pilot.core.take(Message(pilot.now_s, ahead))
    output = pilot.fly(pilot.now_s + PERIOD_S)[-1]
    assert dist(setpoint_of(output), places[-1]) > 2.0 * FAST_M_S * PERIOD_S


def test_a_vehicle_that_is_held_is_not_stopped_by_a_jump(make_config: Maker) -> None:
    pilot = Pilot(make_config(formation={"speed_m_s": 2.0}, safety={"setpoint_speed_max_m_s": FAST_M_S}))
    last = setpoint_of(pilot.fly(20.0)[-1])
    here = pilot.motion.copy()
    assert last[0] - here[0] > 2.0
    pilot.core.take(TacticEvent(Event.HOLD))
    held = [setpoint_of(output) for output in pilot.fly(22.0)]
    assert max(dist(*each) for each in pairwise([last, *held])) <= FAST_M_S * PERIOD_S + 1e-9
    assert held[-1] == pytest.approx(here[:2], abs=0.05)
