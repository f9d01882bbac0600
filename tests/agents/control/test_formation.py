"""Formation flight: the error dynamics against two plants, the closed loop on a plant that is not the planner's."""

from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from agents.control.formation import FormationPlanner, Predecessor, leader_of, mission_line, predecessor_of
from agents.settings.config import AgentConfig
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import Vector

PLANT = Plant(PlantAxis(0.80, 0.87), PlantAxis(0.60, 1.10))
WIND = np.array([0.15, -0.1])
PERIOD_S = 0.1
STILL = np.zeros(2)

positions = st.lists(st.floats(-200.0, 200.0), min_size=2, max_size=2).map(np.array)
motions = st.tuples(positions, positions).map(lambda pair: np.concatenate([pair[0], pair[1] / 40.0]))


def test_the_error_of_two_vehicles_obeys_the_plant_under_the_difference_of_their_setpoints() -> None:
    # (1), (2), lost in the paper's text: two vehicles flown apart by matrix exponentials, and their difference.
    random = np.random.default_rng(2)
    flow = np.zeros((6, 6))
    flow[:2, 2:4] = np.eye(2)
    flow[2:4, :2], flow[2:4, 2:4] = -np.diag(PLANT.a0_per_s2), -np.diag(PLANT.a1_per_s)
    flow[2:4, 4:] = np.diag(PLANT.a0_per_s2)
    first, second = random.standard_normal((2, 4))
    error = second - first
    for _ in range(8):
        first_setpoint, second_setpoint = random.standard_normal((2, 2))
        error = exact_step(PLANT, 0.5).advance(error, second_setpoint - first_setpoint, STILL)
        first = (expm(flow * 0.5) @ np.concatenate([first, first_setpoint]))[:4]
        second = (expm(flow * 0.5) @ np.concatenate([second, second_setpoint]))[:4]
        assert error == pytest.approx(second - first, abs=1e-12)


def test_the_mission_line_is_a_flight_that_the_plant_can_really_fly() -> None:
    # Under a ramp the plant trails its setpoint for good: the integral over many short steps must stay on the line.
    step_s, start = 0.001, (3.0, -2.0)
    motion = mission_line(PLANT, start, 0.7, 10.0).motion
    for tick in range(2000):
        setpoint = mission_line(PLANT, start, 0.7, 10.0 + (tick + 0.5) * step_s).aim_m
        motion = exact_step(PLANT, step_s).advance(motion, setpoint, STILL)
    assert motion == pytest.approx([3.0 + 0.7 * 12.0, -2.0, 0.7, 0.0], abs=1e-6)


def test_a_vehicle_far_from_its_slot_comes_about_as_fast_as_it_may(make_config: Callable[..., AgentConfig]) -> None:
    config = make_config(formation={"speed_max_m_s": 1.5})
    planner, motion, speeds = FormationPlanner(config), np.array([-40.0, 30.0, 0.0, 0.0]), []
    for _ in range(600):
        plan = planner.plan(motion, STILL, Predecessor(np.zeros(4), STILL), (0.0, 5.0))
        motion = exact_step(config.plant, PERIOD_S).advance(motion, plan.aim_m, STILL)
        speeds.append(np.abs(motion[2:]).max())
    # Between the samples of the prediction, and while braking, a sixth more is seen.
    assert 1.2 < max(speeds) < 1.5 * 1.2
    assert motion == pytest.approx([0.0, 5.0, 0.0, 0.0], abs=0.02)


@given(motion=motions, other=motions, ahead=positions)
def test_the_undisturbed_setpoint_never_leads_by_more_than_allowed(
    make_config: Callable[..., AgentConfig], motion: Vector, other: Vector, ahead: Vector
) -> None:
    config = make_config()
    plan = FormationPlanner(config).plan(motion, STILL, Predecessor(other, other[:2] + ahead), (0.0, 5.0))
    lead = np.abs(plan.undisturbed_aim_m - motion[:2]).max()
    assert lead <= config.safety.setpoint_lead_max_m + 1e-6


def test_wind_shifts_the_setpoint_but_not_what_followers_are_told(make_config: Callable[..., AgentConfig]) -> None:
    line, motion = mission_line(PLANT, (0.0, 0.0), 0.2, 5.0), np.array([1.1, 0.2, 0.1, 0.0])
    calm = FormationPlanner(make_config(plant=PLANT)).plan(motion, STILL, line, (0.0, 0.0))
    windy = FormationPlanner(make_config(plant=PLANT)).plan(motion, WIND, line, (0.0, 0.0))
    assert (windy.undisturbed_aim_m == calm.undisturbed_aim_m).all()
    assert calm.aim_m - windy.aim_m == pytest.approx([0.15 / 0.80, -0.1 / 0.60])


def test_each_axis_is_planned_by_its_own_plant(make_config: Callable[..., AgentConfig]) -> None:
    motion, other = np.array([1.1, 0.2, 0.1, -0.3]), np.array([0.4, -4.0, 0.2, 0.1])
    swap = [1, 0, 3, 2]
    there = FormationPlanner(make_config(plant=PLANT))
    back = FormationPlanner(make_config(plant=Plant(PLANT.y, PLANT.x)))
    one = there.plan(motion, WIND, Predecessor(other, other[:2]), (1.0, 5.0))
    mirrored = back.plan(motion[swap], WIND[::-1], Predecessor(other[swap], other[1::-1]), (5.0, 1.0))
    assert one.aim_m == pytest.approx(mirrored.aim_m[::-1], abs=1e-4)
    assert one.aim_m[0] - 0.15 / 0.80 != pytest.approx(one.aim_m[1], abs=1e-2)


@pytest.mark.parametrize(
    ("flying", "leader", "predecessors"),
    [
        (frozenset({1, 2, 3, 4, 5}), 3, {1: 2, 2: 3, 3: None, 4: 3, 5: 4}),
        (frozenset({1, 2, 4, 5}), 2, {1: 2, 2: None, 4: 2, 5: 4}),
        (frozenset({1, 4, 5}), 4, {1: 4, 4: None, 5: 4}),
        (frozenset({1, 3, 5}), 3, {1: 3, 3: None, 5: 3}),
        (frozenset({1, 5}), 1, {1: None, 5: 1}),
        (frozenset({5}), 5, {5: None}),
    ],
)
def test_succession(flying: frozenset[int], leader: int, predecessors: dict[int, int | None]) -> None:
    slots = (1, 2, 3, 4, 5)
    assert leader_of(flying, slots, 3) == leader
    assert {vehicle: predecessor_of(vehicle, flying, slots, 3) for vehicle in flying} == predecessors


@pytest.mark.parametrize("slots", list(permutations((7, 8, 9, 200))))
def test_whatever_the_line_everybody_follows_the_same_leader(slots: tuple[int, ...]) -> None:
    for size in range(1, len(slots) + 1):
        flying = frozenset(slots[-size:])
        leader = leader_of(flying, slots, 8)
        for vehicle in flying:
            hops, seen = vehicle, 0
            while (before := predecessor_of(hops, flying, slots, 8)) is not None:
                hops, seen = before, seen + 1
                assert seen < size
            assert hops == leader
