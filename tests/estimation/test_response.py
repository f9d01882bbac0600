"""The closed-form response against the step that everybody else flies by, and against a solver."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from estimation.identification.response import InputHold, response_of, steps_of
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import Vector

CASES = [(0.8, 0.87), (1.5, 1.9), (0.25, 1.0), (0.2, 1.5), (1.0, 2.0)]
"""Underdamped, nearly so, critically damped, overdamped, critically damped."""


def test_the_response_to_held_setpoints_on_the_grid_equals_the_exact_step(subtests: pytest.Subtests) -> None:
    for a0, a1 in CASES:
        with subtests.test(a0=a0, a1=a1):
            random = np.random.default_rng(1)
            setpoint_m = random.normal(size=80).repeat(3)
            axis = PlantAxis(a0, a1)
            step = exact_step(Plant(axis, axis), 0.1)
            state, positions = np.array([setpoint_m[0], 0.0, 0.0, 0.0]), []
            for setpoint in setpoint_m:
                positions.append(state[0])
                state = step.advance(state, np.array([setpoint, 0.0]), np.zeros(2))
            steps = steps_of(np.linspace(0.0, 23.9, 240), setpoint_m, InputHold.HELD)
            assert response_of(a0, a1).forced(steps, 0.0, 0.0, 0.1, 240) == pytest.approx(np.array(positions), abs=1e-7)


@pytest.mark.parametrize(
    ("between", "lag_s", "lead_s"),
    [(InputHold.HELD, 0.15, 0.0), (InputHold.MIDWAY, 0.0, 0.4), (InputHold.LINEAR, 0.0, 0.0)],
)
def test_the_response_to_setpoints_at_any_time_equals_a_solvers(
    between: InputHold, lag_s: float, lead_s: float
) -> None:
    random = np.random.default_rng(2)
    time_s = np.cumsum(random.uniform(0.1, 0.9, 12)) - 1.0
    setpoint_m = random.normal(size=12)
    delay_s, begin_s = 0.23, 0.5

    def setpoint(t: float) -> float:
        t -= delay_s
        if between is InputHold.LINEAR:
            return float(np.interp(t, time_s, setpoint_m))
        at_s = time_s[1:] if between is InputHold.HELD else (time_s[1:] + time_s[:-1]) / 2.0
        return float(setpoint_m[np.searchsorted(at_s, t, side="right")])

    a0, a1 = 1.4, 1.1

    def slope(t: float, state: Vector) -> list[float]:
        # The lead acts on the output: x = z + lead z', z the plant's answer without it.
        force = a0 * (setpoint(t) - state[0]) - a1 * state[1]
        if lag_s:
            return [state[1], state[2], (force - state[2]) / lag_s]
        return [state[1], force]

    grid_s = begin_s + np.arange(60) * 0.1
    rest = [setpoint(begin_s)] + [0.0] * (2 if lag_s else 1)
    solved = solve_ivp(slope, (begin_s, grid_s[-1]), rest, t_eval=grid_s, max_step=2e-3, rtol=1e-8, atol=1e-10)
    response = response_of(a0, a1, lag_s, lead_s)
    found = response.forced(steps_of(time_s, setpoint_m, between), delay_s, begin_s, 0.1, 60)
    assert found == pytest.approx(solved.y[0] + lead_s * solved.y[1], abs=2e-3)


def test_free_motion_spans_that_of_the_exact_step(subtests: pytest.Subtests) -> None:
    for a0, a1 in CASES:
        with subtests.test(a0=a0, a1=a1):
            axis = PlantAxis(a0, a1)
            step = exact_step(Plant(axis, axis), 0.1)
            state, positions = np.array([0.7, 0.0, -0.4, 0.0]), []
            for _ in range(100):
                positions.append(state[0])
                state = step.advance(state, np.zeros(2), np.zeros(2))
            basis = response_of(a0, a1).free(np.linspace(0.0, 9.9, 100))
            coefficients, *_ = np.linalg.lstsq(basis, np.array(positions), rcond=None)
            assert basis @ coefficients == pytest.approx(np.array(positions), abs=1e-7)


def test_a_jump_between_samples_and_a_ramp_are_distinguished() -> None:
    """Sampled: stood at 0, jumped to 2 and stood, then rose steadily by 1 a second; simulated as it was."""
    time_s = np.linspace(0.0, 8.0, 41)
    setpoint_m = np.where(time_s < 1.9, 0.0, 2.0) + np.maximum(time_s - 5.0, 0.0)
    response = response_of(1.4, 1.1)
    grid_s = np.linspace(0.0, 7.9, 80)
    found = response.forced(steps_of(time_s, setpoint_m, InputHold.MIXED), 0.0, 0.0, 0.1, 80)
    jump, ramp = response.step(np.maximum(grid_s - 1.9, 0.0)), np.maximum(grid_s - 5.0, 0.0)
    solved = solve_ivp(
        lambda t, state: [state[1], 1.4 * (max(t - 5.0, 0.0) - state[0]) - 1.1 * state[1]],
        (0.0, 8.0),
        [0.0, 0.0],
        t_eval=grid_s,
        max_step=0.01,
    )
    assert ramp.max() > 2.0
    assert found == pytest.approx(2.0 * jump + solved.y[0], abs=2e-3)
