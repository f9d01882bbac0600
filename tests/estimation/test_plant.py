"""The plant's exact step against the matrix exponential and numerical integration."""

from math import inf, nan, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import Vector

pytestmark = pytest.mark.filterwarnings("error")

UNDERDAMPED, OVERDAMPED, CRITICAL = PlantAxis(0.80, 0.87), PlantAxis(0.20, 2.0), PlantAxis(1.0, 2.0)
PLANTS = [
    Plant(UNDERDAMPED, UNDERDAMPED),
    Plant(OVERDAMPED, CRITICAL),
    Plant(CRITICAL, UNDERDAMPED),
    Plant(PlantAxis(0.5, 2.0 * sqrt(0.5) * (1.0 + 1e-13)), PlantAxis(0.5, 2.0 * sqrt(0.5) * (1.0 - 1e-9))),
    Plant(PlantAxis(4.0, 0.01), PlantAxis(0.01, 4.0)),
]


def continuous(plant: Plant) -> Vector:
    """The plant as one linear system in [x y x' y' X_d Y_d w_x w_y], inputs constant: (8, 8)."""
    system = np.zeros((8, 8))
    system[0, 2] = system[1, 3] = 1.0
    for row, axis in ((2, plant.x), (3, plant.y)):
        system[row, row - 2], system[row, row] = -axis.a0_per_s2, -axis.a1_per_s
        system[row, row + 2], system[row, row + 4] = axis.a0_per_s2, 1.0
    return system


def test_exact_step_is_the_matrix_exponential(subtests: pytest.Subtests) -> None:
    for plant in PLANTS:
        for step_s in [0.0, 1e-4, 0.1, 0.5, 3.0, 200.0]:
            with subtests.test(plant=plant, step_s=step_s):
                truth = expm(continuous(plant) * step_s)[:4]
                step = exact_step(plant, step_s)
                assert step.transition == pytest.approx(truth[:, :4], abs=1e-9)
                assert step.input_gain == pytest.approx(truth[:, 4:6], abs=1e-9)
                assert step.disturbance_gain == pytest.approx(truth[:, 6:], abs=1e-9)


@pytest.mark.parametrize("plant", PLANTS)
def test_a_feed_forward_velocity_acts_as_its_aim(plant: Plant) -> None:
    """x'' = a0 (X_d - x) + a1 (g V_d - x') + w, integrated as it is written."""
    fed = Plant(plant.x, plant.y, 0.0, 0.8)
    start = np.array([1.0, -2.0, 0.7, 0.3])
    setpoint, velocity, disturbance = np.array([4.0, -1.0]), np.array([-0.4, 0.6]), np.array([0.3, -0.2])

    def derivative(_: float, state: Vector) -> Vector:
        pull = plant.a0_per_s2 * (setpoint - state[:2]) + plant.a1_per_s * (0.8 * velocity - state[2:])
        return np.concatenate([state[2:], pull + disturbance])

    truth = solve_ivp(derivative, (0.0, 1.7), start, rtol=1e-11, atol=1e-12).y[:, -1]
    aim = fed.aim_m(setpoint.tolist(), velocity.tolist())
    assert exact_step(fed, 1.7).advance(start, aim, disturbance) == pytest.approx(truth, abs=1e-8)
    assert fed.aim_m(setpoint.tolist(), ()) == pytest.approx(setpoint)
    assert plant.aim_m(setpoint.tolist(), velocity.tolist()) == pytest.approx(setpoint)


@given(st.floats(0.01, 5.0), st.floats(0.01, 5.0), st.floats(0.001, 3.0), st.floats(0.001, 3.0))
def test_two_steps_are_one_long_step(a0: float, a1: float, first_s: float, second_s: float) -> None:
    plant = Plant(PlantAxis(a0, a1), UNDERDAMPED)
    motion, held = np.array([1.0, 2.0, -0.5, 0.3]), (np.array([3.0, -1.0]), np.array([0.2, 0.1]))
    middle = exact_step(plant, first_s).advance(motion, *held)
    long = exact_step(plant, first_s + second_s).advance(motion, *held)
    assert exact_step(plant, second_s).advance(middle, *held) == pytest.approx(long, abs=1e-9)


def test_a_plant_that_cannot_be_is_refused(subtests: pytest.Subtests) -> None:
    for a0, a1, delay_s, gain, why in (
        (0.0, 1.0, 0.0, 0.0, "must be positive"),
        (1.0, inf, 0.0, 0.0, "must be positive"),
        (1.0, 1.0, 1.01, 0.0, "between 0 and 1 s"),
        (1.0, 1.0, 0.0, nan, "feedforward"),
    ):
        with subtests.test(why=why), pytest.raises(ValueError, match=why):
            Plant(PlantAxis(a0, a1), UNDERDAMPED, delay_s, gain)
