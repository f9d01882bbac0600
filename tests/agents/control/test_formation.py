"""Formation flight: the error dynamics against two plants, the closed loop on a plant that is not the planner's."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
        (frozenset({1, 5}), 1, {1: None, 5: 1}),
        (frozenset({5}), 5, {5: None}),
    ],
)
def test_succession(flying: frozenset[int], leader: int, predecessors: dict[int, int | None]) -> None:
    slots = (1, 2, 3, 4, 5)
    assert leader_of(flying, slots, 3) == leader
    assert {vehicle: predecessor_of(vehicle, flying, slots, 3) for vehicle in flying} == predecessors
