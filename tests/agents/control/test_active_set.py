"""The active set against the conditions of Karush, Kuhn and Tucker: only the optimum of a convex problem meets them."""

import numpy as np
import pytest

from agents.control.lmpc import ActiveSet, BoundedCost
from estimation.state import Vector

FREE = 1e20
SIZE, SAMPLES = 4, 12


def steep() -> Vector:
    """A Hessian (4, 4) whose eigenvalues are far apart."""
    root = np.random.default_rng(0).standard_normal((SIZE, SIZE)) * [1.0, 0.3, 3.0, 10.0]
    return np.asarray(root @ root.T + 0.01 * np.eye(SIZE))


def nearly_parallel() -> Vector:
    """Inputs, then rows (16, 4) that turn by a few degrees from one to the next, two of them alike."""
    turns = np.linspace(0.0, 0.6, SAMPLES - 1)
    fan = np.column_stack([np.cos(turns), np.sin(turns), 0.2 * turns, 0.1 * turns**2])
    return np.vstack([np.eye(SIZE), fan, 2.0 * fan[-1:]])


def assert_optimal(hessian: Vector, rows: Vector, given: tuple[Vector, Vector, Vector], active_set: ActiveSet) -> int:
    """Check the four conditions, and return how many bounds are active."""
    gradient, lower, upper = given
    found = active_set.optimum(gradient, lower, upper)
    assert found is not None
    optimum, multipliers = found
    values = rows @ optimum
    slope = np.abs(gradient).max()
    assert hessian @ optimum + gradient + rows.T @ multipliers == pytest.approx(0.0, abs=1e-8 * slope)
    assert (values <= upper + 1e-7).all()
    assert (values >= lower - 1e-7).all()
    assert values[multipliers > 0.0] == pytest.approx(upper[multipliers > 0.0], abs=1e-7)
    assert values[multipliers < 0.0] == pytest.approx(lower[multipliers < 0.0], abs=1e-7)
    return int(np.count_nonzero(multipliers))


def bounds_about_zero(random: np.random.Generator) -> tuple[Vector, Vector]:
    """Bounds (16,) on each side of zero, which is so inside; some are free."""
    lower, upper = random.uniform(0.01, 1.0, (2, SIZE + SAMPLES)) * [[-1.0], [1.0]]
    lower[random.random(lower.size) < 0.2] = -FREE
    upper[random.random(upper.size) < 0.2] = FREE
    return lower, upper


def test_what_is_found_is_optimal_wherever_the_search_began(subtests: pytest.Subtests) -> None:
    hessian, rows = steep(), nearly_parallel()
    random, kept, counts = np.random.default_rng(1), ActiveSet(BoundedCost(hessian, rows)), []
    for draw in range(200):
        with subtests.test(draw=draw):
            given = (random.standard_normal(SIZE) * 10.0 ** random.uniform(-2.0, 2.0), *bounds_about_zero(random))
            counts.append(assert_optimal(hessian, rows, given, kept))
            assert assert_optimal(hessian, rows, given, ActiveSet(BoundedCost(hessian, rows))) == counts[-1]
    assert set(counts) == {0, 1, 2, 3, 4}


def test_bounds_that_depend_on_each_other_are_met_together() -> None:
    hessian, rows = steep(), nearly_parallel()
    lower, upper = np.full(len(rows), -FREE), np.full(len(rows), FREE)
    upper[SIZE:] = 0.0  # all meet in the origin, and the last two are one bound
    gradient = -(hessian @ np.ones(SIZE))
    active_set = ActiveSet(BoundedCost(hessian, rows))
    assert_optimal(hessian, rows, (gradient, lower, upper), active_set)
    upper[-1] = -1.0  # and now the last one rules
    assert_optimal(hessian, rows, (gradient, lower, upper), active_set)


def test_the_search_begins_at_the_active_set_found_last_and_ends_when_it_takes_too_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hessian, rows = steep(), nearly_parallel()
    lower, upper = np.full(len(rows), -1.0), np.full(len(rows), 1.0)
    given = (-20.0 * np.ones(SIZE), lower, upper)
    active_set = ActiveSet(BoundedCost(hessian, rows))
    assert assert_optimal(hessian, rows, given, active_set) > 1
    monkeypatch.setattr("agents.control.lmpc._CHANGES_MAX", 1)
    assert_optimal(hessian, rows, given, active_set)
    assert ActiveSet(BoundedCost(hessian, rows)).optimum(*given) is None
