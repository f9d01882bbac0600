"""The LMPC against its cost written out as a rollout, minimised by least squares and by SLSQP."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
import osqp
import pytest
from scipy.optimize import minimize

from agents.control.lmpc import Bounds, Lmpc, QpStatus, StateBound
from agents.control.lmpc_cost import condensed
from estimation.state import Vector
from tests.support.solver import UNSOLVED

HORIZON, STEP_S = 6, 0.5
FREE = 1e20
CONSTRAINED = (2, 3)


@dataclass(frozen=True)
class Problem:
    """One LMPC problem with what defines it, and its cost and states computed step by step."""

    transition: Vector
    input_gain: Vector
    control_horizon: int
    state_weight: Vector
    increment_weight: Vector
    state: Vector
    reference: Vector
    previous: Vector

    def lmpc(self) -> Lmpc:
        programme = condensed(
            self.transition,
            self.input_gain,
            horizon=HORIZON,
            control_horizon=self.control_horizon,
            state_weight=self.state_weight,
            increment_weight=self.increment_weight,
            constrained_states=CONSTRAINED,
        )
        return Lmpc(programme, STEP_S)

    def states(self, decision: Vector) -> Vector:
        inputs, state, states = decision.reshape(self.control_horizon, 2), self.state, []
        for step in range(HORIZON):
            state = self.transition @ state + self.input_gain @ inputs[min(step, self.control_horizon - 1)]
            states.append(state)
        return np.array(states)

    def residuals(self, decision: Vector) -> Vector:
        """The cost is the sum of their squares."""
        inputs = np.vstack([self.previous, decision.reshape(self.control_horizon, 2)])
        tracking = (self.states(decision) - self.reference) @ np.linalg.cholesky(self.state_weight)
        return np.concatenate([tracking.ravel(), (np.diff(inputs, axis=0) * np.sqrt(self.increment_weight)).ravel()])

    def cost(self, decision: Vector) -> float:
        return float(np.sum(self.residuals(decision) ** 2))

    def jacobian(self, function: Callable[[Vector], Vector]) -> Vector:
        """Of a function affine in the decision: its values at the corners, exactly."""
        size = 2 * self.control_horizon
        origin = function(np.zeros(size)).ravel()
        return np.column_stack([function(corner).ravel() - origin for corner in np.eye(size)])

    def unbounded_optimum(self) -> Vector:
        size = 2 * self.control_horizon
        solution = np.linalg.lstsq(self.jacobian(self.residuals), -self.residuals(np.zeros(size)), rcond=None)[0]
        return np.asarray(solution, dtype=np.float64)

    def bounded_optimum(self, bounds: Bounds) -> Vector:
        size = 2 * self.control_horizon
        jacobian, offset = self.jacobian(self.residuals), self.residuals(np.zeros(size))
        slope = self.jacobian(self.speeds)
        least, most = at_samples(bounds)
        result = minimize(
            lambda u: np.sum((jacobian @ u + offset) ** 2),
            np.zeros(size),
            jac=lambda u: 2.0 * jacobian.T @ (jacobian @ u + offset),
            bounds=bounds.inputs,
            constraints=[
                {
                    "type": "ineq",
                    "fun": lambda u: most.ravel() - self.speeds(u).ravel(),
                    "jac": lambda u: -slope,
                },
                {
                    "type": "ineq",
                    "fun": lambda u: self.speeds(u).ravel() - least.ravel(),
                    "jac": lambda u: slope,
                },
            ],
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert result.success
        return np.asarray(result.x, dtype=np.float64)

    def speeds(self, decision: Vector) -> Vector:
        return self.states(decision)[:, CONSTRAINED]


def problem(seed: int, control_horizon: int) -> Problem:
    random = np.random.default_rng(seed)
    root = random.standard_normal((4, 4))
    # A damped, coupled pair of axes: nothing in the builder may rely on symmetry.
    transition = np.eye(4) + 0.3 * np.block([[np.zeros((2, 2)), np.eye(2)], [-0.5 * np.eye(2), -0.6 * np.eye(2)]])
    return Problem(
        transition + 0.02 * random.standard_normal((4, 4)),
        np.vstack([np.eye(2) * 0.05, np.eye(2) * 0.3]) + 0.01 * random.standard_normal((4, 2)),
        control_horizon,
        root @ root.T + 0.5 * np.eye(4),
        random.uniform(0.2, 2.0, 2),
        2.0 * random.standard_normal(4),
        random.standard_normal((HORIZON, 4)),
        random.standard_normal(2),
    )


def at_samples(bounds: Bounds) -> tuple[Vector, Vector]:
    """Return the least and the most of the constrained states (HORIZON, 2)."""
    times_s = STEP_S * np.arange(1, HORIZON + 1)
    least = np.column_stack([each.least + each.least_rate * times_s for each in bounds.states])
    return least, np.column_stack([each.most + each.most_rate * times_s for each in bounds.states])


def limits_of(control_horizon: int, input_max: float = FREE, *states: StateBound) -> Bounds:
    return Bounds([(-input_max, input_max)] * 2 * control_horizon, states or [StateBound(-FREE, FREE)] * 2)


def bounds(control_horizon: int, input_max: float = FREE, state_max: float = FREE, opening: float = 0.0) -> Bounds:
    return limits_of(control_horizon, input_max, *[StateBound(-state_max, state_max, -opening, opening)] * 2)


def test_without_bounds_the_plan_is_the_least_squares_solution(subtests: pytest.Subtests) -> None:
    for control_horizon in [1, 4]:
        for seed in range(2):
            with subtests.test(control_horizon=control_horizon, seed=seed):
                given = problem(seed, control_horizon)
                plan = given.lmpc().solve(given.state, given.reference, given.previous, bounds(control_horizon))
                optimum = given.unbounded_optimum()
                assert plan.status is QpStatus.INTERIOR
                assert plan.inputs.ravel() == pytest.approx(optimum, abs=1e-8)
                assert plan.first_input == pytest.approx(optimum[:2], abs=1e-8)


def test_on_the_bounds_the_plan_is_what_slsqp_finds(subtests: pytest.Subtests) -> None:
    limit_rows = ((0.5, FREE, 0.0), (FREE, 2.5, 0.0), (3.0, 3.0, 0.0), (FREE, 2.0, -0.4))
    for control_horizon, (input_max, state_max, opening), seed in product((1, 4), limit_rows, range(3)):
        with subtests.test(control_horizon=control_horizon, input_max=input_max, state_max=state_max, seed=seed):
            given = problem(seed, control_horizon)
            outside = 1.05 * np.abs(given.state[2:]).max()
            limits = bounds(control_horizon, input_max, max(state_max, outside), opening)
            unbounded = given.unbounded_optimum()
            slow_enough = (np.abs(given.speeds(unbounded)) <= at_samples(limits)[1]).all()
            inside = (np.abs(unbounded) <= input_max).all() and slow_enough
            plan = given.lmpc().solve(given.state, given.reference, given.previous, limits)
            assert plan.status is (QpStatus.INTERIOR if inside else QpStatus.BOUNDED)
            optimum = given.bounded_optimum(limits)
            assert plan.first_input == pytest.approx(optimum[:2], abs=1e-5)
            assert given.states(plan.inputs.ravel()) == pytest.approx(given.states(optimum), abs=1e-5)
            assert (np.abs(plan.inputs) <= input_max).all()


def test_osqp_begins_at_the_optimum_and_takes_one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    setup = osqp.OSQP.setup
    monkeypatch.setattr("osqp.OSQP.setup", lambda *given, **settings: setup(*given, **settings | {"max_iter": 1}))
    for seed in range(5):
        given = problem(seed, 2)
        lmpc = given.lmpc()
        for limits in (bounds(2, 0.2), bounds(2, 0.5, 1.0), crossed(), out_of_reach()):
            plan = lmpc.solve(given.state, given.reference, given.previous, limits)
            assert plan.status is QpStatus.BOUNDED


def test_osqp_finds_the_plan_also_where_no_active_set_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    given, limits = problem(3, 2), bounds(2, 0.5)
    found = given.lmpc().solve(given.state, given.reference, given.previous, limits)
    monkeypatch.setattr("agents.control.lmpc._CHANGES_MAX", 0)
    alone = given.lmpc().solve(given.state, given.reference, given.previous, limits)
    assert found.status is alone.status is QpStatus.BOUNDED
    assert alone.first_input == pytest.approx(found.first_input, abs=2e-3)


def crossed() -> Bounds:
    return bounds(2, 0.5, -1.0)


def out_of_reach() -> Bounds:
    return limits_of(2, 0.5, StateBound(50.0, 60.0), StateBound(50.0, 60.0))


@pytest.mark.parametrize("impossible", [crossed(), out_of_reach()], ids=["crossed", "out of reach"])
def test_states_that_cannot_be_kept_still_leave_a_plan_within_the_inputs_bounds(impossible: Bounds) -> None:
    given = problem(1, 2)
    lmpc = given.lmpc()
    plan = lmpc.solve(given.state, given.reference, given.previous, impossible)
    assert plan.status is QpStatus.BOUNDED
    assert np.abs(plan.first_input).max() <= 0.5
    again = lmpc.solve(given.state, given.reference, given.previous, bounds(2))
    assert again.status is QpStatus.INTERIOR


def test_a_solver_that_fails_falls_back_to_the_optimum_cut_to_the_inputs_bounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = problem(1, 2)
    lmpc = given.lmpc()
    monkeypatch.setattr("osqp.OSQP.solve", lambda *_, **__: UNSOLVED)
    plan = lmpc.solve(given.state, given.reference, given.previous, out_of_reach())
    assert plan.status is QpStatus.FALLBACK
    assert plan.first_input == pytest.approx(np.clip(given.unbounded_optimum()[:2], -0.5, 0.5))
